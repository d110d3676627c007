// SPDX-License-Identifier: Apache-2.0
#include "core/detection/moving_edges_testing.h"

#include <algorithm>
#include <cmath>

namespace evpose::testing {

ImageSegment MovingEdge::At(double t_s) const {
  const double t = std::min(t_s, stops_at_s);
  const Eigen::Vector2d middle = 0.5 * (p1_px + p2_px) + t * velocity_px_per_s, half = 0.5 * (p2_px - p1_px);
  const double sine = std::sin(turn_rad_per_s * t), cosine = std::cos(turn_rad_per_s * t);
  const Eigen::Vector2d turned(cosine * half.x() - sine * half.y(), sine * half.x() + cosine * half.y());
  return {middle - turned, middle + turned};
}

std::vector<PixelEvent> MakeEdgeEvents(const std::vector<MovingEdge>& edges, const EdgeEventOptions& options) {
  Random random(options.seed);
  std::vector<PixelEvent> events;
  const auto add = [&](double t_s, const Eigen::Vector2d& point, uint8_t polarity) {
    events.push_back({options.t_begin_us + static_cast<int64_t>(1e6 * t_s), static_cast<float>(point.x()),
                      static_cast<float>(point.y()), polarity});
  };
  for (const MovingEdge& edge : edges) {
    // An event at a random place and time is kept with a probability proportional to the edge's speed there, so that
    // the density is constant over the swept area.
    const double length = (edge.p2_px - edge.p1_px).norm();
    const double fastest = edge.velocity_px_per_s.norm() + std::abs(edge.turn_rad_per_s) * 0.5 * length;
    const double moving_s = std::min(options.duration_s, edge.stops_at_s);
    const uint32_t tries = random.Poisson(options.events_per_px2 * length * fastest * moving_s);
    for (uint32_t k = 0; k < tries; ++k) {
      const double t = random.Uniform(0.0, moving_s), share = random.Uniform();
      const ImageSegment now = edge.At(t);
      const Eigen::Vector2d along = (now.p2_px - now.p1_px) / length, normal(-along.y(), along.x());
      const double speed = normal.dot(edge.velocity_px_per_s) + edge.turn_rad_per_s * (share - 0.5) * length;
      if (random.Uniform() * fastest > std::abs(speed)) continue;
      add(t, now.p1_px + share * (now.p2_px - now.p1_px) + options.noise_px * random.Normal() * normal, edge.polarity);
    }
  }
  const uint32_t clutter = random.Poisson(options.clutter_per_px2 * options.width_px * options.height_px);
  for (uint32_t k = 0; k < clutter; ++k) {
    const double t = random.Uniform(0.0, options.duration_s);
    const Eigen::Vector2d pixel{random.Uniform(0.0, options.width_px - 1.0),
                                random.Uniform(0.0, options.height_px - 1.0)};
    add(t, pixel, static_cast<uint8_t>(random.UniformInt(2)));
  }
  std::stable_sort(events.begin(), events.end(),
                   [](const PixelEvent& a, const PixelEvent& b) { return a.t_us < b.t_us; });
  return events;
}

}  // namespace evpose::testing
