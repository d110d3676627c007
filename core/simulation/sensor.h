// SPDX-License-Identifier: Apache-2.0

// The pixels of an event camera: light to events.
//
// Each pixel (the usual model, Lichtsteiner et al. 2008; v2e, Hu et al. 2021): the logarithm of its light passes a
// first-order low pass (the photoreceptor); when that has moved away from a memorised level by the pixel's ON or OFF
// threshold the pixel sends an event, is held for the refractory time, and memorises the level it has then.
//
// What follows from it, and is not corrected: the logarithm puts ON events ahead of an edge's true place and OFF events
// behind it by the same distance (bright things look larger, core/estimation/README.md, section 3), 0.13 px for the
// square pixel alone and 0.23 px with the default lens; the low pass makes both late by about its time constant 1 / (2
// pi bandwidth), 53 us by default in full light. With infinite bandwidth and equal thresholds the mean of the two is
// the edge: no bias.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "core/events/event.h"
#include "core/simulation/noise.h"
#include "core/simulation/pixel_response.h"
#include "core/simulation/rasterizer.h"

namespace evpose {

struct SensorOptions {
  // Contrast thresholds, natural logarithm of light: 0.28 is a factor of 1.32, an EVK4 at its default biases (25 to
  // 30 % contrast). Equal by default, so that a bright and a dark edge send the same number of events.
  double threshold_on = 0.28;
  double threshold_off = 0.28;
  double threshold_mismatch_ratio = 0.03;  // standard deviation between pixels, as a share: fixed-pattern noise

  double dark_light = 0.01;      // added to the light (white is 1): leakage current; keeps the logarithm finite
  double bandwidth_hz = 3000.0;  // -3 dB of the photoreceptor in light 1; 0: infinite. An EVK4 indoors: some kHz
  // The bandwidth grows with the light, between this share of bandwidth_hz in the dark and all of it in light 1.
  // 1: it does not depend on the light.
  double dark_bandwidth_ratio = 0.5;
  double refractory_us = 150.0;  // an EVK4's default is of this order

  // Noise of the sensor itself, per pixel. Together about 0.04 Hz x 921600 pixels = 4e4 events/s at the defaults.
  double leak_hz = 0.01;          // ON events of a pixel at rest: its memory leaks
  double shot_noise_hz = 0.03;    // in the dark; half ON, half OFF, at random times; a quarter of it in light 1
  double hot_pixel_ratio = 1e-5;  // share of pixels that fire by themselves: 9 on an EVK4
  double hot_pixel_hz = 200.0;    // mean rate of such a pixel; ON events
  // Raises noise to this share of all events, with further events anywhere at random times, at a rate that follows the
  // signal's; the noise above counts towards it. 0: only the noise above.
  double noise_ratio = 0.0;
  // Floods, as of a flash or of interference: for flood_s in every flood_period_s, from the middle of the period on,
  // events anywhere on the sensor, this many per second. 0: none. An EVK4's interface carries some 1e8 at the most.
  double flood_hz = 0.0;
  double flood_s = 0.05;
  double flood_period_s = 1.0;

  absl::Status Validate() const;
};

struct SensorCounts {
  uint64_t events = 0;
  uint64_t noise_events = 0;  // of them, from leak, shot noise, hot pixels, noise_ratio and floods
};

// Between two pictures each pixel's light is a straight line; its logarithm is followed in pieces of at most 0.15,
// straight in turn, over which the low pass is solved exactly. Times are found to a thousandth of a microsecond and
// rounded down to whole ones.
class EventSensor {
 public:
  // `options` must be valid. The pixels have looked at `picture` for long; their memories stand anywhere between their
  // thresholds. Times are in microseconds since then, below 2^31.
  EventSensor(const SensorOptions& options, SensorGeometry geometry, const std::vector<float>& picture, uint64_t seed);

  // The light has become `picture` at `t_us`, changing evenly since the last call, at pixels of `changed` only. Appends
  // the events of that step, in order of time, row, polarity, column.
  void Advance(int64_t t_us, const std::vector<float>& picture, const PixelRect& changed, std::vector<Event>& events);

  const SensorCounts& counts() const { return counts_; }

 private:
  void FindChanged(const std::vector<float>& picture, const PixelRect& changed);
  void AdvancePixel(uint32_t pixel, float light);
  void AdvanceLeak();
  void AddNoise();
  // Of the flood: events expected in [begin_us, end_us).
  double FloodMean(double begin_us, double end_us) const;
  void Emit(uint32_t pixel, double t_us, bool on, bool is_noise);
  void TakeEvents(std::vector<Event>& events);

  SensorOptions options_;
  SensorGeometry geometry_;
  PixelResponse response_;
  NoiseSource noise_;
  std::vector<PixelState> pixels_;
  std::vector<float> light_;  // what each pixel was last advanced with
  std::vector<int64_t> last_event_us_;
  std::vector<uint32_t> changed_;       // pixels whose light changed in this step
  std::vector<uint32_t> unsettled_;     // pixels whose low pass still moves, or that are held
  std::vector<uint32_t> still_moving_;  // the same after the last step
  std::vector<Crossing> crossings_;
  std::vector<NoiseEvent> noise_events_;
  LeakSchedule leaks_;
  std::vector<uint64_t> pending_;  // this step's events, packed so that numbers sort as events do
  int64_t t_us_ = 0;
  int64_t step_begin_us_ = 0;
  uint64_t pending_signal_ = 0;
  SensorCounts counts_;
};

}  // namespace evpose
