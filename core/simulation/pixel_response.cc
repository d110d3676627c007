// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/pixel_response.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/numerics/math.h"

namespace evpose {
namespace {

// The light changes linearly between two pictures, but its logarithm does not. It is divided into pieces of at most
// this change, over which the logarithm differs from a straight line by less than 0.003, 1 % of a usual threshold.
constexpr double kMaxLogStep = 0.15;
// Difference of output and input, in logarithm, of a settled pixel: 0.4 % of a usual threshold.
constexpr double kSettled = 1e-3;
// Accuracy of the time of a crossing, microseconds. Times are rounded to whole microseconds later.
constexpr double kTimeToleranceUs = 1e-4;
// Bisection halves the interval in each iteration: 60 reduce any step of a recording to the tolerance.
constexpr int kMaxSolverIterations = 60;

}  // namespace

double DeterministicLog(double x) {
  const uint64_t bits = std::bit_cast<uint64_t>(x);
  int exponent = static_cast<int>(bits >> 52) - 1023;
  double mantissa = std::bit_cast<double>((bits & 0x000fffffffffffffULL) | 0x3ff0000000000000ULL);  // [1, 2)
  if (mantissa > std::numbers::sqrt2) {
    mantissa *= 0.5;
    ++exponent;
  }
  // log m = 2 artanh(s), s = (m - 1) / (m + 1), |s| <= 0.172.
  const double s = (mantissa - 1.0) / (mantissa + 1.0);
  const double s2 = s * s;
  const double series =
      1.0 + s2 * (1.0 / 3 + s2 * (1.0 / 5 + s2 * (1.0 / 7 + s2 * (1.0 / 9 + s2 * (1.0 / 11 + s2 * (1.0 / 13))))));
  return exponent * std::numbers::ln2 + 2.0 * s * series;
}

// A time interval in which the input (logarithm of light) is linear in time.
struct PixelResponse::Piece {
  double begin_us;
  double length_us;
  double input;   // input at the beginning
  double slope;   // change of the input per microsecond
  double tau_us;  // time constant of the low pass

  // Returns the output at t, given the output `output0` at t0; times count from the beginning of the piece. `decay` is
  // e^(-(t - t0) / tau_us).
  double OutputAt(double t, double t0, double output0, double decay) const {
    if (tau_us <= 0.0) return input + slope * t;
    const double away = output0 - (input + slope * (t0 - tau_us));
    return input + slope * (t - tau_us) + away * decay;
  }
  double OutputAt(double t, double t0, double output0) const {
    return OutputAt(t, t0, output0, tau_us <= 0.0 ? 0.0 : DeterministicExp(-(t - t0) / tau_us));
  }
};

namespace {

// f(u) = level + slope u + decay e^(-u / tau), u >= 0.
struct Course {
  double level;
  double slope;
  double decay;
  double tau;

  double At(double u) const {
    return decay == 0.0 ? level + slope * u : level + slope * u + decay * DeterministicExp(-u / tau);
  }

  // Returns the position of the extremum; infinity if there is none. There is at most one.
  double Turn() const {
    const double ratio = decay == 0.0 ? 0.0 : slope * tau / decay;  // = e^(-u / tau) at the turn
    if (ratio <= 1e-300 || ratio >= 1.0) return std::numeric_limits<double>::infinity();
    return -tau * DeterministicLog(ratio);
  }

  // Returns the u in [low, high] with f(u) = target. f must be monotone in this interval and reach the target. Newton's
  // method with bisection.
  double Solve(double low, double high, double target) const {
    if (decay == 0.0) return std::clamp((target - level) / slope, low, high);
    const bool rising = At(high) > At(low);
    double u = 0.5 * (low + high);
    for (int i = 0; i < kMaxSolverIterations && high - low > kTimeToleranceUs; ++i) {
      const double e = decay * DeterministicExp(-u / tau);
      const double f = level + slope * u + e - target;
      ((f > 0.0) == rising ? high : low) = u;
      const double step = f / (slope - e / tau);
      const double newton = u - step;
      if (std::abs(step) < kTimeToleranceUs && newton > low && newton < high) return newton;
      u = newton > low && newton < high ? newton : 0.5 * (low + high);
    }
    return u;
  }
};

constexpr double kNever = std::numeric_limits<double>::infinity();

// Returns the first u in [0, end] at which f reaches `on` from below or -off from above; kNever if there is none.
double FirstCrossing(const Course& f, double end, double on, double off, double f_end) {
  const double turn = f.Turn();
  double low = 0.0;
  if (turn < end) {
    const double f_turn = f.At(turn);
    if (f_turn >= on) return f.Solve(0.0, turn, on);
    if (f_turn <= -off) return f.Solve(0.0, turn, -off);
    low = turn;
  }
  if (f_end >= on) return f.Solve(low, end, on);
  if (f_end <= -off) return f.Solve(low, end, -off);
  return kNever;
}

}  // namespace

PixelResponse::PixelResponse(double bandwidth_hz, double dark_bandwidth_ratio, double dark_light, double refractory_us,
                             double leak_per_us)
    : time_constant_us_(bandwidth_hz > 0.0 ? 1e6 / (2.0 * std::numbers::pi * bandwidth_hz) : 0.0),
      dark_bandwidth_ratio_(dark_bandwidth_ratio),
      dark_light_(dark_light),
      refractory_us_(refractory_us),
      leak_per_us_(leak_per_us),
      last_log_(LogLight(last_light_)) {}

// Neighbouring pixels of one face have the same light, so that the last result is often valid again.
double PixelResponse::Decay(const Piece& piece) {
  if (piece.tau_us <= 0.0) return 0.0;
  const double exponent = -piece.length_us / piece.tau_us;
  if (exponent != last_exponent_) {
    last_exponent_ = exponent;
    last_decay_ = DeterministicExp(exponent);
  }
  return last_decay_;
}

double PixelResponse::LogLightOnce(float light) {
  if (light != last_light_) {
    last_light_ = light;
    last_log_ = LogLight(light);
  }
  return last_log_;
}

double PixelResponse::LogLight(float light) const {
  // The rounding of sums of coverage can yield light down to -1e-7.
  return DeterministicLog(std::max<double>(light, 0.0) + dark_light_);
}

double PixelResponse::TimeConstantUs(float light) const {
  const double share = dark_bandwidth_ratio_ + (1.0 - dark_bandwidth_ratio_) * std::clamp<double>(light, 0.0, 1.0);
  return time_constant_us_ / share;
}

void PixelResponse::Advance(PixelState& state, float light_from, float light_to, uint32_t t_us,
                            std::vector<Crossing>& crossings) {
  const double begin_us = state.t_us;
  const double length_us = t_us - begin_us;
  const double input_from = state.input;
  const double input_to = LogLightOnce(light_to);
  const double change = input_to - input_from;
  const int pieces = 1 + static_cast<int>(std::abs(change) / kMaxLogStep);
  Piece piece = {begin_us, length_us, input_from, change / length_us, TimeConstantUs(light_to)};
  if (pieces > 1) {
    // Pieces of equal change of the logarithm: the light at their ends is a geometric series, and the times follow from
    // the linear change of the light.
    const double ratio = DeterministicExp(change / pieces);
    const double from = std::max<double>(light_from, 0.0) + dark_light_;
    const double us_per_light = length_us / (static_cast<double>(light_to) - light_from);
    double light = from;
    for (int i = 1; i < pieces; ++i) {
      light *= ratio;
      const double end_us = begin_us + std::clamp((light - from) * us_per_light, 0.0, length_us);
      piece.length_us = end_us - piece.begin_us;
      if (piece.length_us <= 0.0) continue;
      piece.slope = change / pieces / piece.length_us;
      piece.tau_us = TimeConstantUs(static_cast<float>(light));
      AdvancePiece(state, piece, crossings);
      piece.begin_us = end_us;
      piece.input = input_from + change * i / pieces;
    }
    piece.length_us = t_us - piece.begin_us;
    piece.slope = (input_to - piece.input) / piece.length_us;
    piece.tau_us = TimeConstantUs(light_to);
  }
  if (piece.length_us > 0.0) AdvancePiece(state, piece, crossings);
  state.input = static_cast<float>(input_to);
  state.t_us = t_us;
}

void PixelResponse::AdvancePiece(PixelState& state, const Piece& piece, std::vector<Crossing>& crossings) {
  double t = 0.0;  // time since the beginning of the piece
  double output = state.output;
  double memory = state.memory;
  const double end_output = piece.OutputAt(piece.length_us, 0.0, output, Decay(piece));
  const double end_input = piece.input + piece.slope * piece.length_us;
  // The output of a low pass stays in the range of its initial output and its input.
  const double highest = std::max({output, piece.input, end_input});
  const double lowest = std::min({output, piece.input, end_input});
  while (true) {
    if (state.held_until_us >= 0.0) {
      const double held = std::max(t, state.held_until_us - piece.begin_us);
      if (held >= piece.length_us) break;
      output = memory = piece.OutputAt(held, t, output);
      t = held;
      state.held_until_us = kNotHeld;
    }
    const double left = piece.length_us - t;
    if (highest - memory + leak_per_us_ * left < state.threshold_on && lowest - memory > -state.threshold_off) {
      memory -= leak_per_us_ * left;
      break;
    }
    // The further course of output - memory, including the leak.
    const double steady = piece.input + piece.slope * (t - piece.tau_us);
    Course course = {steady - memory, piece.slope + leak_per_us_, output - steady, piece.tau_us};
    if (piece.tau_us <= 0.0) course = {output - memory, piece.slope + leak_per_us_, 0.0, 0.0};
    const double f_end = end_output - memory + leak_per_us_ * left;
    const double crossing = FirstCrossing(course, left, state.threshold_on, state.threshold_off, f_end);
    if (crossing == kNever) {
      memory -= leak_per_us_ * left;
      break;
    }
    const bool is_on = course.At(crossing) > 0.0;
    t += crossing;
    output = piece.OutputAt(t, t - crossing, output);
    crossings.push_back({piece.begin_us + t, is_on});
    state.held_until_us = piece.begin_us + t + refractory_us_;
  }
  state.output = static_cast<float>(end_output);
  state.memory = static_cast<float>(memory);
}

bool PixelResponse::IsSettled(const PixelState& state) const {
  return std::abs(state.output - state.input) < kSettled && state.held_until_us < 0.0;
}

void PixelResponse::Rest(PixelState& state, uint32_t t_us) const {
  state.memory -= static_cast<float>(leak_per_us_ * (t_us - state.t_us));
  state.t_us = t_us;
}

double PixelResponse::NextLeakUs(const PixelState& state) const {
  if (leak_per_us_ <= 0.0) return kNever;
  const double missing = state.threshold_on - (state.output - state.memory);
  return state.t_us + std::max(0.0, missing) / leak_per_us_;
}

}  // namespace evpose
