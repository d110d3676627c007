// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/event_edges.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// Radius of the neighbourhood of a pixel, pixels: an edge that moves by 3 px passes through all of it.
constexpr int kPlaneReach = 2;
// Least ratio of the second smallest and the smallest variance of the events about a plane: of events without a
// direction, such as those of a hot pixel, both are equal. A larger ratio would reject edges in few events.
constexpr double kMinPlanarity = 3.0;
// Fastest edge, relative to the median speed of the stretch. The events of a flash are on a plane of constant time. A
// smaller limit would remove the far end of an object that turns about its near end.
constexpr double kMaxSpeedRatio = 5.0;

// Sums over events (u, v, s) of one polarity, s the time in units in which an edge of median speed moves by one pixel.
struct EventSums {
  double count = 0.0;
  Vector3d first = Vector3d::Zero();
  Matrix3d second = Matrix3d::Zero();

  void Add(const Vector3d& at) {
    count += 1.0;
    first += at;
    second += at * at.transpose();
  }
  void Add(const EventSums& other) {
    count += other.count;
    first += other.first;
    second += other.second;
  }
};

struct PixelSums {
  int u = 0;
  int v = 0;
  std::array<EventSums, 2> by_polarity;
};

// The pixels with events, and the index of each in a grid. Only tiles of the grid with events have memory, so that
// memory and time depend on the events and little on the size of the sensor.
class ActivePixels {
 public:
  explicit ActivePixels(SensorGeometry sensor)
      : width_(sensor.width_px + 2 * kPlaneReach),
        height_(sensor.height_px + 2 * kPlaneReach),
        columns_((width_ >> kTileBits) + 1),
        tile_of_(static_cast<size_t>(columns_) * ((height_ >> kTileBits) + 1), kEmptyTile),
        tiles_(1) {
    tiles_[kEmptyTile].fill(kNone);
  }

  void Add(const StretchEvent& event, double time_scale_px_per_s) {
    const int u = static_cast<int>(std::floor(event.u_px + 0.5f)), v = static_cast<int>(std::floor(event.v_px + 0.5f));
    // The border of the grid is empty, so that each pixel has all neighbours.
    if (u < 0 || v < 0 || u >= width_ - 2 * kPlaneReach || v >= height_ - 2 * kPlaneReach) return;
    uint32_t& tile = tile_of_[TileAt(u + kPlaneReach, v + kPlaneReach)];
    if (tile == kEmptyTile) {
      tile = static_cast<uint32_t>(tiles_.size());
      tiles_.emplace_back().fill(kNone);
    }
    uint16_t& index = tiles_[tile][PlaceInTile(u + kPlaneReach, v + kPlaneReach)];
    if (index == kNone) {
      if (pixels_.size() == kNone) return;
      index = static_cast<uint16_t>(pixels_.size());
      pixels_.push_back({u, v, {}});
    }
    pixels_[index].by_polarity[event.polarity].Add({event.u_px, event.v_px, time_scale_px_per_s * event.tau_s});
  }

  const std::vector<PixelSums>& pixels() const { return pixels_; }

  EventSums Around(const PixelSums& pixel, int polarity) const {
    EventSums sums;
    for (int dv = -kPlaneReach; dv <= kPlaneReach; ++dv) {
      const int v = pixel.v + kPlaneReach + dv;
      for (int u = pixel.u; u <= pixel.u + 2 * kPlaneReach; ++u) {
        const uint16_t index = tiles_[tile_of_[TileAt(u, v)]][PlaceInTile(u, v)];
        if (index != kNone) sums.Add(pixels_[index].by_polarity[polarity]);
      }
    }
    return sums;
  }

 private:
  static constexpr uint16_t kNone = std::numeric_limits<uint16_t>::max();
  static constexpr uint32_t kEmptyTile = 0;
  // Tiles of 8 x 8 pixels: only those with events take memory. Larger tiles contain more pixels without events, smaller
  // ones make the index of the tiles larger.
  static constexpr int kTileBits = 3;
  static constexpr int kTileMask = (1 << kTileBits) - 1;
  using Tile = std::array<uint16_t, size_t{1} << (2 * kTileBits)>;

  // `u` and `v` count from the border.
  size_t TileAt(int u, int v) const { return static_cast<size_t>(v >> kTileBits) * columns_ + (u >> kTileBits); }
  static size_t PlaceInTile(int u, int v) {
    return static_cast<size_t>(v & kTileMask) << kTileBits | static_cast<size_t>(u & kTileMask);
  }

  int width_;
  int height_;
  int columns_;                    // of tiles
  std::vector<uint32_t> tile_of_;  // index in tiles_
  std::vector<Tile> tiles_;        // the first one is empty
  std::vector<PixelSums> pixels_;
};

struct EdgePlane {
  Vector3d mean;
  Vector2d normal;
  double slowness = 0.0;  // normal . (u, v) + slowness s is constant on the plane
  double variance = 0.0;  // variance of the events about it, px^2
};

// Returns the matrix of cofactors of a symmetric matrix. Its repeated squares converge, up to scale, to the projection
// onto the eigenvector of the smallest eigenvalue.
Matrix3d Cofactors(const Matrix3d& m) {
  Matrix3d out;
  out.row(0) = Vector3d(m.row(1)).cross(Vector3d(m.row(2)));
  out.row(1) = Vector3d(m.row(2)).cross(Vector3d(m.row(0)));
  out.row(2) = Vector3d(m.row(0)).cross(Vector3d(m.row(1)));
  return out;
}

// The plane through the events; nullopt if they have no direction.
std::optional<EdgePlane> FitPlane(const EventSums& sums) {
  EdgePlane plane;
  plane.mean = sums.first / sums.count;
  // Rounding to pixels has the variance 1 / 12 in each coordinate, and keeps the matrix regular.
  const Matrix3d covariance = sums.second / sums.count - plane.mean * plane.mean.transpose() +
                              Vector3d(1.0 / 12.0, 1.0 / 12.0, 1e-3).asDiagonal().toDenseMatrix();
  Matrix3d power = Cofactors(covariance);
  const double minors = power.trace();
  for (int i = 0; i < 3; ++i) {
    const double scale = power.trace();
    if (!(scale > 0.0)) return std::nullopt;
    power /= scale;
    power = power * power;
  }
  int column = 0;
  if (!(power.diagonal().maxCoeff(&column) > 0.0)) return std::nullopt;
  const Vector3d normal = power.col(column).normalized();
  plane.variance = normal.dot(covariance * normal);
  const double rest = covariance.trace() - plane.variance;  // sum of the other eigenvalues
  const double product = minors - plane.variance * rest;
  const double middle = 0.5 * (rest - std::sqrt(std::max(0.0, rest * rest - 4.0 * product)));
  if (!(middle > kMinPlanarity * plane.variance)) return std::nullopt;
  const double across = normal.head<2>().norm();
  if (!(across * kMaxSpeedRatio > std::abs(normal.z()))) return std::nullopt;
  plane.normal = normal.head<2>() / across;
  plane.slowness = normal.z() / across;
  return plane;
}

}  // namespace

absl::Status EventEdgeOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(stretch.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("EventEdgeOptions.max_scatter_px", max_scatter_px, 0.1, 10.0));
  return CheckRange("EventEdgeOptions.min_events", min_events, 3, 1000);
}

EventEdgeDetector::EventEdgeDetector(const EventEdgeOptions& options, SensorGeometry sensor)
    : options_(options), sensor_(sensor), selector_(options.stretch, sensor.width_px, sensor.height_px) {}

EventEdges EventEdgeDetector::Detect(absl::Span<const PixelEvent> events) {
  EventEdges edges;
  if (events.empty()) return edges;
  const EventStretch stretch = selector_.Select(events);
  edges.t_begin_us = stretch.t_begin_us;
  edges.t_end_us = stretch.t_end_us;
  edges.motion_px = 2.0 * stretch.half_duration_s() * stretch.speed_px_per_s;
  ActivePixels active(sensor_);
  for (size_t i = 0; i < stretch.events.size(); ++i) {
    YieldPoint(i);
    active.Add(stretch.events[i], stretch.time_scale_px_per_s);
  }
  const std::vector<PixelSums>& pixels = active.pixels();
  for (size_t i = 0; i < pixels.size(); ++i) {
    YieldPoint(i);
    for (int polarity = 0; polarity < 2; ++polarity) {
      const EventSums& own = pixels[i].by_polarity[polarity];
      if (own.count == 0.0) continue;
      const EventSums sums = active.Around(pixels[i], polarity);
      if (sums.count < options_.min_events) continue;
      const std::optional<EdgePlane> plane = FitPlane(sums);
      if (!plane || plane->variance > options_.max_scatter_px * options_.max_scatter_px) continue;
      // The events of the pixel, moved along the normal to where the plane is at the middle of the stretch.
      const Vector2d at = own.first.head<2>() / own.count;
      const double across = plane->normal.dot(plane->mean.head<2>() - at) + plane->slowness * plane->mean.z();
      edges.points.push_back({at + across * plane->normal, plane->normal,
                              -plane->slowness * stretch.time_scale_px_per_s * plane->normal,
                              static_cast<float>(own.count)});
    }
  }
  return edges;
}

}  // namespace evpose
