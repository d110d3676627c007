// SPDX-License-Identifier: Apache-2.0

// The pixels of an event camera: converts light to events.
//
// Each pixel follows the usual model (Lichtsteiner et al. 2008; v2e, Hu et al. 2021): the logarithm of its light passes
// a first-order low pass (the photoreceptor). When the result differs from a memorised level by the pixel's ON or OFF
// threshold, the pixel emits an event, is inactive for the refractory time, and memorises its level at the end of that
// time.
//
// Two consequences are not corrected. The logarithm places ON events ahead of the true position of an edge and OFF
// events behind it by the same distance, so that bright areas appear larger (core/estimation/README.md, section 3):
// 0.13 px for the square pixel alone and 0.23 px with the default lens. The low pass delays both by about its time
// constant 1 / (2 pi bandwidth), 53 us by default in full light. With infinite bandwidth and equal thresholds, the mean
// of the two positions is unbiased.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "core/events/event.h"
#include "core/simulation/noise.h"
#include "core/simulation/pixel_response.h"
#include "core/simulation/rasterizer.h"

namespace evpose {

// The defaults model an EVK4 indoors. They are assumptions and not fitted to recordings of a sensor; the model and its
// sources are in core/simulation/README.md, section 2. sensor_test checks the numbers of events that follow from them;
// `evpose bench tracking` ("uncalibrated"), tests/bench/sensor_settings.py and tests/bench/consistency.py vary them.
struct SensorOptions {
  // Contrast thresholds, natural logarithm of light. 0.28 is a factor of 1.32, an EVK4 at its default biases (25 to 30
  // % contrast). They are equal by default, so that a bright and a dark edge emit the same number of events.
  double threshold_on = 0.28;
  double threshold_off = 0.28;
  double threshold_mismatch_ratio = 0.03;  // standard deviation between pixels, as a share: fixed-pattern noise

  double dark_light = 0.01;      // added to the light (white is 1): leakage current; keeps the logarithm finite
  double bandwidth_hz = 3000.0;  // -3 dB of the photoreceptor in light 1; 0: infinite. An EVK4 indoors has a few kHz
  // The bandwidth increases with the light, from this share of bandwidth_hz in the dark to all of it in light 1. 1: it
  // does not depend on the light.
  double dark_bandwidth_ratio = 0.5;
  double refractory_us = 150.0;  // the order of an EVK4's default

  // Noise of the sensor, per pixel: about 0.04 Hz x 921600 pixels = 4e4 events/s in total at the defaults.
  double leak_hz = 0.01;          // ON events of a pixel in constant light, because its memory leaks
  double shot_noise_hz = 0.03;    // in the dark; half ON, half OFF, at random times; a quarter of this in light 1
  double hot_pixel_ratio = 1e-5;  // share of pixels that emit events in constant light: 9 on an EVK4
  double hot_pixel_hz = 200.0;    // mean rate of such a pixel; ON events
  // Raises the noise to this share of all events by further events at random pixels and times, at a rate that follows
  // that of the signal; the noise above is included. 0: only the noise above.
  double noise_ratio = 0.0;
  // Floods, as of a flash or of interference: for flood_s in each flood_period_s, from the middle of the period on,
  // events at random pixels at this rate per second. 0: none. The interface of an EVK4 transfers about 1e8 events/s.
  double flood_hz = 0.0;
  // Seconds. Short against the period, so that the tracker has most of the time to recover, and longer than its
  // windows.
  double flood_s = 0.05;
  double flood_period_s = 1.0;

  absl::Status Validate() const;
};

struct SensorCounts {
  uint64_t events = 0;
  uint64_t noise_events = 0;  // events of leak, shot noise, hot pixels, noise_ratio and floods among them
};

// Between two pictures, the light of a pixel changes linearly; its logarithm is approximated by pieces of at most 0.15,
// each linear in turn, for which the low pass is solved exactly. Times are found to 1e-4 microseconds and rounded
// down to whole microseconds.
class EventSensor {
 public:
  // `options` must be valid. The pixels are settled on `picture`, and their memories are uniformly distributed between
  // their thresholds. Times are in microseconds since then, below 2^31.
  EventSensor(const SensorOptions& options, SensorGeometry geometry, const std::vector<float>& picture, uint64_t seed);

  // Advances the sensor to t_us. The light has changed linearly to `picture` since the previous call, only at pixels of
  // `changed`. Appends the events of the step in order of time, row, polarity, column.
  void Advance(int64_t t_us, const std::vector<float>& picture, const PixelRect& changed, std::vector<Event>& events);

  const SensorCounts& counts() const { return counts_; }

 private:
  void FindChanged(const std::vector<float>& picture, const PixelRect& changed);
  void AdvancePixel(uint32_t pixel, float light);
  void AdvanceLeak();
  void AddNoise();
  // Expected number of flood events in [begin_us, end_us).
  double FloodMean(double begin_us, double end_us) const;
  void Emit(uint32_t pixel, double t_us, bool is_on, bool is_noise);
  void AppendEvents(std::vector<Event>& events);

  SensorOptions options_;
  SensorGeometry geometry_;
  PixelResponse response_;
  NoiseSource noise_;
  std::vector<PixelState> pixels_;
  std::vector<float> light_;  // the light up to which each pixel was advanced
  std::vector<int64_t> last_event_us_;
  std::vector<uint32_t> changed_;       // pixels with a change of the light in this step
  std::vector<uint32_t> unsettled_;     // pixels with a low pass that has not settled, or in their refractory time
  std::vector<uint32_t> still_moving_;  // the same after the last step
  std::vector<Crossing> crossings_;
  std::vector<NoiseEvent> noise_events_;
  LeakSchedule leaks_;
  std::vector<uint64_t> pending_;  // events of this step, packed so that sorting numbers sorts events
  int64_t t_us_ = 0;
  int64_t step_begin_us_ = 0;
  uint64_t pending_signal_ = 0;
  SensorCounts counts_;
};

}  // namespace evpose
