// SPDX-License-Identifier: Apache-2.0

// The response of one pixel of an event camera to light that changes linearly: exact times of its events
// (core/simulation/README.md, section 2).
#pragma once

#include <cstdint>
#include <vector>

namespace evpose {

inline constexpr double kNotHeld = -1.0;

// Natural logarithms of light.
struct PixelState {
  float input = 0.0f;   // logarithm of the light at t_us
  float output = 0.0f;  // output of the low pass at t_us
  float memory = 0.0f;  // memorised level at t_us; the leak lowers it
  float threshold_on = 0.0f;
  float threshold_off = 0.0f;
  uint32_t t_us = 0;                // time of this state
  double held_until_us = kNotHeld;  // end of the refractory time, at which the pixel memorises its output
};

// A crossing of the ON or OFF threshold.
struct Crossing {
  double t_us;
  bool is_on;
};

class PixelResponse {
 public:
  // The parameters are those of SensorOptions; a bandwidth of 0 disables the low pass. `leak_per_us` is the decrease of
  // the memorised level per microsecond.
  PixelResponse(double bandwidth_hz, double dark_bandwidth_ratio, double dark_light, double refractory_us,
                double leak_per_us);

  // Returns the logarithm of the light plus the dark light.
  double LogLight(float light) const;

  // Advances the pixel to `t_us`, while its light changes linearly from light_from (at state.t_us) to light_to. Appends
  // the crossings in order of time.
  void Advance(PixelState& state, float light_from, float light_to, uint32_t t_us, std::vector<Crossing>& crossings);

  // Returns whether the output has reached the input and the pixel is not refractory: until the light changes, only the
  // leak changes the state.
  bool IsSettled(const PixelState& state) const;

  // Advances a settled pixel: the leak alone acts, without reaching the threshold.
  void Rest(PixelState& state, uint32_t t_us) const;

  // Returns the time at which the leak of a settled pixel reaches its ON threshold, microseconds; infinity without
  // leak.
  double NextLeakUs(const PixelState& state) const;

 private:
  struct Piece;
  void AdvancePiece(PixelState& state, const Piece& piece, std::vector<Crossing>& crossings);
  double Decay(const Piece& piece);
  double LogLightOnce(float light);
  double TimeConstantUs(float light) const;

  double time_constant_us_;  // in light 1; 0 without low pass
  double dark_bandwidth_ratio_;
  double dark_light_;
  double refractory_us_;
  double leak_per_us_;
  double last_exponent_ = 0.0;  // last arguments and results of Decay() and LogLightOnce()
  double last_decay_ = 1.0;
  float last_light_ = -1.0f;
  double last_log_;
};

// Returns the natural logarithm with the same bits on every machine, with an error below 1e-12. `x` must be positive
// and normal.
double DeterministicLog(double x);

}  // namespace evpose
