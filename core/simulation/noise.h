// SPDX-License-Identifier: Apache-2.0

// Events that no edge causes.
#pragma once

#include <cstdint>
#include <functional>
#include <queue>
#include <utility>
#include <vector>

#include "core/numerics/random.h"

namespace evpose {

struct NoiseEvent {
  uint32_t pixel;
  double t_us;
  bool on;
};

// Poisson processes over all pixels at once: the cost follows the number of events, not of pixels.
class NoiseSource {
 public:
  NoiseSource(uint32_t num_pixels, double shot_noise_hz, double hot_pixel_ratio, double hot_pixel_hz, uint64_t seed);

  // Candidates for shot noise in [begin, end), at the rate of the dark. `accept_share` of a pixel in [0, 1] thins them.
  void AddShotNoise(double begin_us, double end_us, const std::function<double(uint32_t pixel)>& accept_share,
                    std::vector<NoiseEvent>& events);
  void AddHotPixels(double begin_us, double end_us, std::vector<NoiseEvent>& events);
  // About `mean` events anywhere, of either polarity.
  void AddUniform(double begin_us, double end_us, double mean, std::vector<NoiseEvent>& events);

 private:
  uint32_t num_pixels_;
  double shot_noise_hz_;
  std::vector<uint32_t> hot_pixels_;
  std::vector<double> hot_rate_sums_hz_;  // running sum over hot_pixels_
  Random random_;
};

// When which pixel at rest is due for an event by leakage. A pixel has one valid entry at most.
class LeakSchedule {
 public:
  explicit LeakSchedule(uint32_t num_pixels);

  // The pixel is due at t_us, unless an earlier time stands already (at which it is asked again).
  void Add(uint32_t pixel, double t_us);
  // Takes the earliest pixel that is due before t_us; false when there is none.
  bool TakeDue(double t_us, uint32_t& pixel);

 private:
  using Entry = std::pair<double, uint32_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<Entry>> queue_;
  std::vector<double> due_us_;  // per pixel; infinity: none
};

}  // namespace evpose
