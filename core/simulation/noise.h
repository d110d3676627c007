// SPDX-License-Identifier: Apache-2.0

// Noise events, which no edge causes.
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
  bool is_on;
};

// Poisson processes over all pixels at once. The time is proportional to the number of events and does not depend on
// the number of pixels.
class NoiseSource {
 public:
  NoiseSource(uint32_t num_pixels, double shot_noise_hz, double hot_pixel_ratio, double hot_pixel_hz, uint64_t seed);

  // Appends events of shot noise in [begin, end), unordered. `accept_share` returns the rate of a pixel in its present
  // light relative to that in the dark, in [0, 1].
  void AddShotNoise(double begin_us, double end_us, const std::function<double(uint32_t pixel)>& accept_share,
                    std::vector<NoiseEvent>& events);
  void AddHotPixels(double begin_us, double end_us, std::vector<NoiseEvent>& events);
  // Appends events at random pixels, with random polarities; their expected number is `mean`.
  void AddUniform(double begin_us, double end_us, double mean, std::vector<NoiseEvent>& events);

 private:
  uint32_t num_pixels_;
  double shot_noise_hz_;
  std::vector<uint32_t> hot_pixels_;
  std::vector<double> hot_rate_sums_hz_;  // running sum over hot_pixels_
  Random random_;
};

// The times of the next leak events of the settled pixels. A pixel has at most one valid entry.
class LeakSchedule {
 public:
  explicit LeakSchedule(uint32_t num_pixels);

  // Schedules the pixel at t_us, unless an earlier time is scheduled already; it is then examined at that time.
  void Add(uint32_t pixel, double t_us);
  // Removes the earliest pixel that is scheduled before t_us. Returns false if there is none.
  bool TakeDue(double t_us, uint32_t& pixel);

 private:
  using Entry = std::pair<double, uint32_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<Entry>> queue_;
  std::vector<double> due_us_;  // by pixel; infinity if the pixel is not scheduled
};

}  // namespace evpose
