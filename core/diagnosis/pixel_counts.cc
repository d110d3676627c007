// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/pixel_counts.h"

#include <algorithm>
#include <cmath>

#include "core/numerics/connected_cells.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Pixels around a pixel with which it is compared: a square of 5 x 5.
constexpr int kHotRadius = 2;
// Expected noise events in a dead area: a working one in which nothing moves would have some. Noise depends on the
// light, by a factor of four and more, hence the margin.
constexpr double kMinExpectedNoise = 100.0;

// Whether a Poisson count of this mean reaches `count` with less than `probability`: a bound by Chernoff.
bool IsImprobable(double count, double mean, double probability) {
  if (count <= mean) return false;
  const double exponent = count * std::log(count / std::max(mean, 1e-9)) - (count - mean);
  return exponent > -std::log(probability);
}

}  // namespace

PixelCounts::PixelCounts(SensorGeometry geometry)
    : geometry_(geometry),
      counts_(static_cast<size_t>(geometry.width_px) * static_cast<size_t>(geometry.height_px), 0) {}

void PixelCounts::Add(absl::Span<const Event> events) {
  for (const Event& event : events) {
    uint32_t& count = counts_[static_cast<size_t>(event.y) * static_cast<size_t>(geometry_.width_px) + event.x];
    count += count < UINT32_MAX;
  }
  num_events_ += events.size();
}

std::vector<PixelCounts::HotPixel> PixelCounts::FindHot(const DiagnosisOptions& options) const {
  std::vector<HotPixel> hot;
  if (num_events_ == 0) return hot;
  const double mean = static_cast<double>(num_events_) / static_cast<double>(counts_.size());
  const double probability = options.false_alarm_probability / static_cast<double>(counts_.size());
  std::vector<uint32_t> around;
  for (int y = 0; y < geometry_.height_px; ++y) {
    for (int x = 0; x < geometry_.width_px; ++x) {
      const uint32_t count = At(x, y);
      if (count < 8 || count < mean) continue;
      around.clear();
      for (int v = std::max(0, y - kHotRadius); v <= std::min(geometry_.height_px - 1, y + kHotRadius); ++v) {
        for (int u = std::max(0, x - kHotRadius); u <= std::min(geometry_.width_px - 1, x + kHotRadius); ++u) {
          if (u != x || v != y) around.push_back(At(u, v));
        }
      }
      // The upper quartile, because an edge covers a part of the surroundings only.
      const double usual = options.hot_ratio * UpperQuantile(around, 0.75) + 1.0;
      if (IsImprobable(count, usual, probability)) hot.push_back({x, y, count});
    }
  }
  std::stable_sort(hot.begin(), hot.end(), [](const HotPixel& a, const HotPixel& b) { return a.events > b.events; });
  return hot;
}

double PixelCounts::BusyShare() const {
  const auto is_busy = [](uint32_t count) { return count >= kMinRimEvents; };
  return static_cast<double>(std::count_if(counts_.begin(), counts_.end(), is_busy)) /
         static_cast<double>(counts_.size());
}

std::vector<PixelCounts::DeadArea> PixelCounts::FindDead(double noise_per_pixel,
                                                         const DiagnosisOptions& options) const {
  std::vector<bool> is_silent(counts_.size());
  for (size_t i = 0; i < counts_.size(); ++i) is_silent[i] = counts_[i] == 0;
  std::vector<DeadArea> areas;
  const auto width = static_cast<size_t>(geometry_.width_px);
  for (const std::vector<size_t>& cells : ConnectedCells(geometry_.width_px, geometry_.height_px, is_silent)) {
    const auto pixels = static_cast<double>(cells.size());
    if (noise_per_pixel * pixels < kMinExpectedNoise) continue;
    if (pixels < options.dead_share.advice * static_cast<double>(counts_.size())) continue;
    DeadArea area{geometry_.width_px, geometry_.height_px, -1, -1, cells.size()};
    std::vector<uint32_t> rim;
    for (const size_t cell : cells) {
      const int x = static_cast<int>(cell % width), y = static_cast<int>(cell / width);
      area.x_min = std::min(area.x_min, x), area.x_max = std::max(area.x_max, x);
      area.y_min = std::min(area.y_min, y), area.y_max = std::max(area.y_max, y);
      if (x > 0 && At(x - 1, y) > 0) rim.push_back(At(x - 1, y));
      if (y > 0 && At(x, y - 1) > 0) rim.push_back(At(x, y - 1));
      if (x + 1 < geometry_.width_px && At(x + 1, y) > 0) rim.push_back(At(x + 1, y));
      if (y + 1 < geometry_.height_px && At(x, y + 1) > 0) rim.push_back(At(x, y + 1));
    }
    if (!rim.empty() && UpperMedian(rim) >= kMinRimEvents) areas.push_back(area);
  }
  std::stable_sort(areas.begin(), areas.end(),
                   [](const DeadArea& a, const DeadArea& b) { return a.pixels > b.pixels; });
  return areas;
}

PixelCounts::Box PixelCounts::Extent() const {
  Box box;
  for (int y = 0; y < geometry_.height_px; ++y) {
    for (int x = 0; x < geometry_.width_px; ++x) {
      if (At(x, y) == 0) continue;
      if (box.x_max < 0) box = {x, y, x, y};
      box.x_min = std::min(box.x_min, x);
      box.x_max = std::max(box.x_max, x);
      box.y_max = y;
    }
  }
  return box;
}

}  // namespace evpose
