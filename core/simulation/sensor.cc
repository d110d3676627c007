// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/sensor.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

// A pixel is advanced if its light has changed by more than this share since its last advance: 0.4 % of a threshold.
constexpr float kLightTolerance = 1e-3f;
// Smallest threshold relative to the nominal one, with any mismatch: keeps thresholds positive.
constexpr float kSmallestThresholdShare = 0.3f;
// Decrease of the rate of shot noise from the dark to light 1, as a share (SensorOptions::shot_noise_hz).
constexpr double kShotNoiseFallInLight = 0.75;
constexpr int kBlock = 16;  // pixels per block, a multiple of the lanes of vector instructions

// Packs an event so that the order of the numbers is the order of time, row, polarity, column.
uint64_t Pack(int64_t t_in_step_us, uint32_t x, uint32_t y, bool is_on, bool is_noise) {
  return (static_cast<uint64_t>(t_in_step_us) << 30) | (static_cast<uint64_t>(y) << 16) |
         (static_cast<uint64_t>(is_on) << 15) | (static_cast<uint64_t>(x) << 1) | static_cast<uint64_t>(is_noise);
}

PixelState RandomPixel(const SensorOptions& options, double input, Random& random) {
  PixelState state;
  const auto threshold = [&](double nominal) {
    const double factor = 1.0 + options.threshold_mismatch_ratio * random.Normal();
    return static_cast<float>(nominal * std::max<double>(factor, kSmallestThresholdShare));
  };
  state.threshold_on = threshold(options.threshold_on);
  state.threshold_off = threshold(options.threshold_off);
  state.input = state.output = static_cast<float>(input);
  state.memory = state.output - static_cast<float>(random.Uniform(-state.threshold_off, state.threshold_on));
  return state;
}

}  // namespace

absl::Status SensorOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.threshold_on", threshold_on, 0.01, 5.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.threshold_off", threshold_off, 0.01, 5.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.threshold_mismatch_ratio", threshold_mismatch_ratio, 0.0, 0.5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.dark_light", dark_light, 1e-4, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.bandwidth_hz", bandwidth_hz, 0.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.dark_bandwidth_ratio", dark_bandwidth_ratio, 0.01, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.refractory_us", refractory_us, 0.0, 1e5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.leak_hz", leak_hz, 0.0, 1e3));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.shot_noise_hz", shot_noise_hz, 0.0, 1e3));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.hot_pixel_ratio", hot_pixel_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.hot_pixel_hz", hot_pixel_hz, 0.0, 1e5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.noise_ratio", noise_ratio, 0.0, 0.9));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.flood_hz", flood_hz, 0.0, 1e8));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SensorOptions.flood_period_s", flood_period_s, 1e-3, 1e4));
  return CheckRange("SensorOptions.flood_s", flood_s, 0.0, 0.5 * flood_period_s);
}

EventSensor::EventSensor(const SensorOptions& options, SensorGeometry geometry, const std::vector<float>& picture,
                         uint64_t seed)
    : options_(options),
      geometry_(geometry),
      response_(options.bandwidth_hz, options.dark_bandwidth_ratio, options.dark_light, options.refractory_us,
                options.leak_hz * options.threshold_on * 1e-6),
      noise_(static_cast<uint32_t>(picture.size()), options.shot_noise_hz, options.hot_pixel_ratio,
             options.hot_pixel_hz, seed ^ 0x6e6f697365ULL),
      light_(picture),
      last_event_us_(picture.size(), -1'000'000'000),
      leaks_(static_cast<uint32_t>(picture.size())) {
  Random random(seed);
  pixels_.reserve(picture.size());
  for (uint32_t pixel = 0; pixel < picture.size(); ++pixel) {
    pixels_.push_back(RandomPixel(options, response_.LogLight(picture[pixel]), random));
    leaks_.Add(pixel, response_.NextLeakUs(pixels_.back()));
  }
}

void EventSensor::Advance(int64_t t_us, const std::vector<float>& picture, const PixelRect& changed,
                          std::vector<Event>& events) {
  step_begin_us_ = t_us_;
  t_us_ = t_us;
  pending_signal_ = 0;
  FindChanged(picture, changed);
  still_moving_.swap(unsettled_);
  unsettled_.clear();
  for (const uint32_t pixel : changed_) AdvancePixel(pixel, picture[pixel]);
  for (const uint32_t pixel : still_moving_) {
    if (pixels_[pixel].t_us != t_us_) AdvancePixel(pixel, light_[pixel]);
  }
  AdvanceLeak();
  AddNoise();
  AppendEvents(events);
}

void EventSensor::FindChanged(const std::vector<float>& picture, const PixelRect& changed) {
  changed_.clear();
  const auto dark = static_cast<float>(options_.dark_light);
  const auto differs = [&](size_t i) {
    return std::abs(picture[i] - light_[i]) > kLightTolerance * (light_[i] + dark);
  };
  for (int y = changed.y0; y < changed.y1; ++y) {
    const size_t row = static_cast<size_t>(y) * geometry_.width_px;
    const size_t end = row + changed.x1;
    size_t i = row + changed.x0;
    for (; i + kBlock <= end; i += kBlock) {
      // Most blocks have not changed: one test for all pixels of a block, which the compiler vectorises.
      int any = 0;
      for (int k = 0; k < kBlock; ++k) any |= static_cast<int>(differs(i + k));
      if (any == 0) continue;
      for (int k = 0; k < kBlock; ++k) {
        if (differs(i + k)) changed_.push_back(static_cast<uint32_t>(i + k));
      }
    }
    for (; i < end; ++i) {
      if (differs(i)) changed_.push_back(static_cast<uint32_t>(i));
    }
  }
}

void EventSensor::AdvancePixel(uint32_t pixel, float light) {
  PixelState& state = pixels_[pixel];
  if (state.t_us < step_begin_us_) response_.Rest(state, static_cast<uint32_t>(step_begin_us_));
  crossings_.clear();
  response_.Advance(state, light_[pixel], light, static_cast<uint32_t>(t_us_), crossings_);
  light_[pixel] = light;
  for (const Crossing& crossing : crossings_) Emit(pixel, crossing.t_us, crossing.is_on, /*is_noise=*/false);
  pending_signal_ += crossings_.size();
  if (response_.IsSettled(state)) {
    leaks_.Add(pixel, response_.NextLeakUs(state));
  } else {
    unsettled_.push_back(pixel);
  }
}

void EventSensor::AdvanceLeak() {
  uint32_t pixel = 0;
  while (leaks_.TakeDue(static_cast<double>(t_us_), pixel)) {
    PixelState& state = pixels_[pixel];
    if (!response_.IsSettled(state)) continue;  // scheduled again when it has settled
    const double due_us = response_.NextLeakUs(state);
    if (due_us < t_us_) {
      Emit(pixel, due_us, /*is_on=*/true, /*is_noise=*/true);
      response_.Rest(state, static_cast<uint32_t>(due_us));
      state.memory = state.output;
    }
    leaks_.Add(pixel, response_.NextLeakUs(state));
  }
}

void EventSensor::AddNoise() {
  const auto begin_us = static_cast<double>(step_begin_us_);
  const auto end_us = static_cast<double>(t_us_);
  const uint64_t leaked = pending_.size() - pending_signal_;
  noise_events_.clear();
  const auto accept = [this](uint32_t pixel) {
    return 1.0 - kShotNoiseFallInLight * std::clamp<double>(light_[pixel], 0.0, 1.0);
  };
  noise_.AddShotNoise(begin_us, end_us, accept, noise_events_);
  noise_.AddHotPixels(begin_us, end_us, noise_events_);
  const double share = options_.noise_ratio / (1.0 - options_.noise_ratio);
  const double missing =
      share * static_cast<double>(pending_signal_) - static_cast<double>(noise_events_.size() + leaked);
  if (missing > 0.0) noise_.AddUniform(begin_us, end_us, missing, noise_events_);
  const double flood = FloodMean(begin_us, end_us);
  if (flood > 0.0) noise_.AddUniform(begin_us, end_us, flood, noise_events_);
  for (const NoiseEvent& event : noise_events_) Emit(event.pixel, event.t_us, event.is_on, /*is_noise=*/true);
}

double EventSensor::FloodMean(double begin_us, double end_us) const {
  if (options_.flood_hz <= 0.0) return 0.0;
  const double period_us = options_.flood_period_s * 1e6;
  // Steps are much shorter than the intervals between floods, so that a step meets at most one flood.
  const double flood_begin_us = (std::floor(begin_us / period_us) + 0.5) * period_us;
  const double overlap_us =
      std::min(end_us, flood_begin_us + options_.flood_s * 1e6) - std::max(begin_us, flood_begin_us);
  return options_.flood_hz * std::max(overlap_us, 0.0) * 1e-6;
}

void EventSensor::Emit(uint32_t pixel, double t_us, bool is_on, bool is_noise) {
  const auto whole_us = static_cast<int64_t>(t_us);
  const int64_t in_step_us = std::clamp<int64_t>(whole_us, step_begin_us_, t_us_ - 1) - step_begin_us_;
  const auto width = static_cast<uint32_t>(geometry_.width_px);
  pending_.push_back(Pack(in_step_us, pixel % width, pixel / width, is_on, is_noise));
}

// A refractory pixel emits no event: noise and signal share its refractory time.
void EventSensor::AppendEvents(std::vector<Event>& events) {
  std::sort(pending_.begin(), pending_.end());
  const auto refractory_us = static_cast<int64_t>(options_.refractory_us);
  for (const uint64_t packed : pending_) {
    Event event;
    event.t_us = step_begin_us_ + static_cast<int64_t>(packed >> 30);
    event.y = static_cast<uint16_t>((packed >> 16) & 0x3fff);
    event.polarity = static_cast<uint8_t>((packed >> 15) & 1);
    event.x = static_cast<uint16_t>((packed >> 1) & 0x3fff);
    int64_t& last_us = last_event_us_[static_cast<size_t>(event.y) * geometry_.width_px + event.x];
    if (event.t_us - last_us < refractory_us) continue;
    last_us = event.t_us;
    events.push_back(event);
    ++counts_.events;
    counts_.noise_events += packed & 1;
  }
  pending_.clear();
}

}  // namespace evpose
