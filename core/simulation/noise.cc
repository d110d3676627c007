// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/noise.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace evpose {

NoiseSource::NoiseSource(uint32_t num_pixels, double shot_noise_hz, double hot_pixel_ratio, double hot_pixel_hz,
                         uint64_t seed)
    : num_pixels_(num_pixels), shot_noise_hz_(shot_noise_hz), random_(seed) {
  const auto num_hot = static_cast<uint32_t>(std::llround(hot_pixel_ratio * num_pixels));
  double sum_hz = 0.0;
  for (uint32_t i = 0; i < num_hot; ++i) {
    hot_pixels_.push_back(static_cast<uint32_t>(random_.UniformInt(num_pixels)));
    sum_hz += hot_pixel_hz * random_.Uniform(0.5, 1.5);  // the rates of hot pixels differ; their mean is hot_pixel_hz
    hot_rate_sums_hz_.push_back(sum_hz);
  }
}

void NoiseSource::AddShotNoise(double begin_us, double end_us,
                               const std::function<double(uint32_t pixel)>& accept_share,
                               std::vector<NoiseEvent>& events) {
  const uint32_t candidates = random_.Poisson(shot_noise_hz_ * num_pixels_ * (end_us - begin_us) * 1e-6);
  for (uint32_t i = 0; i < candidates; ++i) {
    const auto pixel = static_cast<uint32_t>(random_.UniformInt(num_pixels_));
    const double t_us = random_.Uniform(begin_us, end_us);
    const bool is_on = random_.Uniform() < 0.5;
    if (random_.Uniform() < accept_share(pixel)) events.push_back({pixel, t_us, is_on});
  }
}

void NoiseSource::AddHotPixels(double begin_us, double end_us, std::vector<NoiseEvent>& events) {
  if (hot_pixels_.empty()) return;
  const double total_hz = hot_rate_sums_hz_.back();
  const uint32_t number = random_.Poisson(total_hz * (end_us - begin_us) * 1e-6);
  for (uint32_t i = 0; i < number; ++i) {
    const double place = random_.Uniform(0.0, total_hz);
    const auto found = std::upper_bound(hot_rate_sums_hz_.begin(), hot_rate_sums_hz_.end(), place);
    const size_t index = std::min<size_t>(found - hot_rate_sums_hz_.begin(), hot_pixels_.size() - 1);
    events.push_back({hot_pixels_[index], random_.Uniform(begin_us, end_us), true});
  }
}

void NoiseSource::AddUniform(double begin_us, double end_us, double mean, std::vector<NoiseEvent>& events) {
  const uint32_t number = random_.Poisson(mean);
  for (uint32_t i = 0; i < number; ++i) {
    const auto pixel = static_cast<uint32_t>(random_.UniformInt(num_pixels_));
    const double t_us = random_.Uniform(begin_us, end_us);
    events.push_back({pixel, t_us, random_.Uniform() < 0.5});
  }
}

LeakSchedule::LeakSchedule(uint32_t num_pixels) : due_us_(num_pixels, std::numeric_limits<double>::infinity()) {}

void LeakSchedule::Add(uint32_t pixel, double t_us) {
  if (t_us >= due_us_[pixel]) return;
  due_us_[pixel] = t_us;
  queue_.push({t_us, pixel});
}

bool LeakSchedule::TakeDue(double t_us, uint32_t& pixel) {
  while (!queue_.empty() && queue_.top().first < t_us) {
    const Entry entry = queue_.top();
    queue_.pop();
    if (due_us_[entry.second] != entry.first) continue;  // replaced by an earlier entry of this pixel
    due_us_[entry.second] = std::numeric_limits<double>::infinity();
    pixel = entry.second;
    return true;
  }
  return false;
}

}  // namespace evpose
