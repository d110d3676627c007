// SPDX-License-Identifier: Apache-2.0

// One pixel of an event camera over one straight piece of its input: exact times of its events.
#pragma once

#include <cstdint>
#include <vector>

namespace evpose {

inline constexpr double kNotHeld = -1.0;

struct PixelState {
  float input = 0.0f;   // logarithm of the light at t_us
  float output = 0.0f;  // the low pass's, at t_us
  float memory = 0.0f;  // memorised level at t_us; the leak lowers it
  float threshold_on = 0.0f;
  float threshold_off = 0.0f;
  uint32_t t_us = 0;                // the state is that at this time
  double held_until_us = kNotHeld;  // refractory until then; memorises its level at that moment
};

// A crossing of a threshold.
struct Crossing {
  double t_us;
  bool on;
};

class PixelResponse {
 public:
  // bandwidth_hz 0: no low pass. leak_per_us: fall of the memorised level per microsecond.
  PixelResponse(double bandwidth_hz, double dark_bandwidth_ratio, double dark_light, double refractory_us,
                double leak_per_us);

  double LogLight(float light) const;

  // Advances the pixel to `t_us` while its light changes evenly from light_from (at state.t_us) to light_to; appends
  // the crossings in order of time.
  void Advance(PixelState& state, float light_from, float light_to, uint32_t t_us, std::vector<Crossing>& crossings);

  // The input does not change and the output has reached it: nothing but the leak moves until the input does.
  bool IsSettled(const PixelState& state) const;

  // Advances a settled pixel: the leak alone acts, without reaching the threshold.
  void Rest(PixelState& state, uint32_t t_us) const;

  // When a settled pixel's leak will reach its ON threshold, microseconds; infinity without leak.
  double NextLeakUs(const PixelState& state) const;

 private:
  struct Piece;
  void AdvancePiece(PixelState& state, const Piece& piece, std::vector<Crossing>& crossings);
  double Decay(const Piece& piece);
  double LogLightOnce(float light);
  double TimeConstantUs(float light) const;

  double time_constant_us_;  // in light 1; 0: no low pass
  double dark_bandwidth_ratio_;
  double dark_light_;
  double refractory_us_;
  double leak_per_us_;
  double last_exponent_ = 0.0;  // what Decay and LogLightOnce answered last
  double last_decay_ = 1.0;
  float last_light_ = -1.0f;
  double last_log_;
};

// Natural logarithm, the same bits on every machine; x positive and normal; within 1e-12.
double DeterministicLog(double x);

}  // namespace evpose
