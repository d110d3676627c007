// SPDX-License-Identifier: Apache-2.0

// Which events may belong to which lines (core/association/README.md, section 2): lines as the image shows them, and a
// grid of tiles that knows the lines near each.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/motion_prior.h"
#include "core/geometry/projected_line.h"
#include "core/models/visibility.h"
#include "core/numerics/prefetch.h"
#include "core/windows/pixel_history.h"

namespace evpose {

// A visible part of a model line, object frame, metres.
struct TrackedLine {
  int model_line = 0;  // index into ObjectModel::lines
  Eigen::Vector3d p1;
  Eigen::Vector3d p2;
  // How wide the narrowest of its faces can look, pixels: seen edge on, its two edges cannot be told apart.
  double narrowest_face_px = std::numeric_limits<double>::infinity();

  // `model_line` is for the reader to check. The face is of the view, not of the line.
  static void VisitState(auto& archive, auto& self) {
    auto& [model_line, p1, p2, narrowest_face_px] = self;
    archive(model_line, Finite(p1), Finite(p2));
  }
};

// Its image, moving: d = (a + tau a_dot) . b, tau in seconds from the state's time.
struct ImageLine {
  Eigen::Vector3d a = Eigen::Vector3d::Zero();
  // The same, displaced to where its events are expected (edge_bias.h); equal to a unless corrected.
  Eigen::Vector3d a_expected = Eigen::Vector3d::Zero();
  Eigen::Vector3d a_dot = Eigen::Vector3d::Zero();
  Eigen::Matrix<double, 3, 6> jacobian = Eigen::Matrix<double, 3, 6>::Zero();
  Eigen::Matrix<double, 3, 6> a_dot_jacobian = Eigen::Matrix<double, 3, 6>::Zero();  // of a_dot, by the pose
  Eigen::Vector2d p1_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d direction = Eigen::Vector2d::Zero();  // unit, from p1 to p2
  double length_px = 0.0;                               // 0: not in view; no event is near it

  bool in_view() const { return length_px > 0.0; }
  // Undistorted pixel at a fraction of the length.
  Eigen::Vector2d PointAt(double fraction) const { return p1_px + fraction * length_px * direction; }
  // Pixels from p1 along the line to where an undistorted pixel projects onto it.
  double AlongPx(double u_px, double v_px) const {
    return (u_px - p1_px.x()) * direction.x() + (v_px - p1_px.y()) * direction.y();
  }
};

// One image line per tracked line, in order, but for a_dot_jacobian.
void ProjectLines(const CameraModel& camera, const MotionState& state, absl::Span<const TrackedLine> lines,
                  std::vector<ImageLine>& image_lines);

// Fills in a_dot_jacobian, of `image_lines` as ProjectLines made them with the same arguments.
void ProjectVelocityJacobians(const CameraModel& camera, const MotionState& state, absl::Span<const TrackedLine> lines,
                              absl::Span<ImageLine> image_lines);

// Bearing of an undistorted pixel.
Eigen::Vector3d BearingOf(const CameraModel& camera, const Eigen::Vector2d& pixel);

// Velocity across the line at a fraction of its length, pixels per second along its normal.
double NormalSpeedPxPerS(const CameraModel& camera, const ImageLine& line, double fraction);

// Standard deviation, in pixels, of the least certain line's middle under the state's pose covariance.
double PredictedSpreadPx(const CameraModel& camera, const MotionState& state, absl::Span<const ImageLine> lines);

// An event as the estimators see it.
struct Observation {
  double bx = 0.0;  // undistorted bearing (bx, by, 1)
  double by = 0.0;
  double u_px = 0.0;  // undistorted pixel
  double v_px = 0.0;
  double tau_s = 0.0;  // from mid-window
  // The lines that it may belong to, by index.
  static constexpr int kMaxLines = 6;
  std::array<uint16_t, kMaxLines> lines = {};
  uint8_t num_lines = 0;
  uint8_t polarity = 0;
  PreviousPolarity previous = PreviousPolarity::kUnknown;
  // How much other objects claim it: the density of their events here, 1/px, where that of the own nearest line
  // integrates to one across the line (competitors.h). 0: there are no others.
  float competing = 0.0f;

  absl::Span<const uint16_t> Lines() const { return absl::MakeConstSpan(lines.data(), num_lines); }
  // Probability that the pixel's previous event had the other polarity; 0.5 if the previous event is unknown.
  double TurnRatio() const {
    constexpr double kRatio[] = {0.5, 0.0, 1.0};  // by PreviousPolarity
    return kRatio[static_cast<int>(previous)];
  }
};

// An event as an observation at `t_us`, without its lines; nullopt when it lies outside the sensor.
std::optional<Observation> Observe(const CameraModel& camera, const UndistortionTable& undistortion,
                                   const WindowEvent& event, int64_t t_us);

// Tiles of 8 x 8 undistorted pixels, each with the lines that pass within reach.
class TileGrid {
 public:
  static constexpr int kTilePx = 8;
  static constexpr int kSlots = Observation::kMaxLines;  // lines kept per tile: those nearest to its centre

  explicit TileGrid(const CameraModel& camera);

  // Enters the lines that come within reach_px of a tile.
  void Build(absl::Span<const ImageLine> lines, double reach_px);

  static constexpr uint32_t kNoTile = 0xffffffff;
  // The tile of an undistorted pixel; kNoTile outside the grid.
  uint32_t TileOf(double u_px, double v_px) const {
    const double x = (u_px + kMarginPx) / kTilePx;
    const double y = (v_px + kMarginPx) / kTilePx;
    if (!(x >= 0.0 && y >= 0.0 && x < columns_ && y < rows_)) return kNoTile;
    return static_cast<uint32_t>(y) * columns_ + static_cast<uint32_t>(x);
  }
  bool has_lines(uint32_t tile) const { return has_lines_[tile] != 0; }
  absl::Span<const uint16_t> Lines(uint32_t tile) const {
    return absl::MakeConstSpan(tiles_[tile].lines, tiles_[tile].count);
  }
  // Gives the event a tile's lines.
  void GiveLines(uint32_t tile, Observation& event) const {
    std::copy_n(tiles_[tile].lines, kSlots, event.lines.begin());
    event.num_lines = static_cast<uint8_t>(tiles_[tile].count);
  }
  // Its own tile's; false outside the grid.
  bool GiveLines(Observation& event) const;
  absl::Span<const uint32_t> tiles_with_lines() const { return touched_; }
  // Of tiles, row by row; the first one begins kMarginPx beyond the image's corner.
  int columns() const { return columns_; }
  int rows() const { return rows_; }
  // The undistorted image reaches beyond the sensor's rectangle.
  static constexpr double kMarginPx = 64.0;

 private:
  struct Tile {
    uint16_t count = 0;
    uint16_t lines[kSlots] = {};
  };
  void EnterRow(int row, absl::Span<const ImageLine> lines, size_t index, double reach_px);
  // Into a tile that is full: in the place of the line that is farthest from its centre, if that is farther.
  static void Replace(absl::Span<const ImageLine> lines, size_t index, const Eigen::Vector2d& centre_px, Tile& tile);

  int columns_ = 0;
  int rows_ = 0;
  std::vector<Tile> tiles_;
  std::vector<uint8_t> has_lines_;  // by tile: few bytes, asked about by every event
  std::vector<uint32_t> touched_;
};

// The tile that each pixel of the sensor lies in, undistorted: the same for every TileGrid of a camera.
class PixelTiles {
 public:
  PixelTiles(const CameraModel& camera, const UndistortionTable& undistortion);

  // TileGrid::kNoTile outside the grid. x and y inside the sensor.
  uint32_t At(int x, int y) const { return tiles_[static_cast<size_t>(y) * width_px_ + x]; }
  // At(x, y) is about to be asked for, if there is such a pixel.
  void Prefetch(int x, int y) const { PrefetchEntry(tiles_, static_cast<size_t>(y) * width_px_ + x); }

 private:
  int width_px_;
  std::vector<uint32_t> tiles_;
};

// The nearest two lines of an event, with signed distances.
struct NearLines {
  int count = 0;
  int line[2] = {0, 0};
  double distance_px[2] = {0.0, 0.0};
};

// Its signed distance from a line, at its own time.
inline double DistancePx(const Observation& event, const ImageLine& line) {
  const Eigen::Vector3d& a = line.a_expected;
  return a.x() * event.bx + a.y() * event.by + a.z() +
         event.tau_s * (line.a_dot.x() * event.bx + line.a_dot.y() * event.by + line.a_dot.z());
}

// Takes away the event's lines that are farther from it than reach_px.
void KeepLinesWithin(double reach_px, const ImageLine* lines, Observation& event);

// Of `candidates` those whose gate holds the event: |d| <= gate_px, and no farther than end_margin_px beyond an end
// point.
inline NearLines FindNearLines(const Observation& event, absl::Span<const uint16_t> candidates, const ImageLine* lines,
                               double gate_px, double end_margin_px) {
  NearLines near;
  double best[2] = {gate_px, gate_px};
  for (const uint16_t index : candidates) {
    const ImageLine& line = lines[index];
    const double d = DistancePx(event, line);
    const double distance = d < 0.0 ? -d : d;
    if (!(distance <= best[1])) continue;
    const double along = line.AlongPx(event.u_px, event.v_px);
    if (along < -end_margin_px || along > line.length_px + end_margin_px || !line.in_view()) continue;
    const int slot = distance <= best[0] ? 0 : 1;
    if (slot == 0) {
      near.line[1] = near.line[0];
      near.distance_px[1] = near.distance_px[0];
      best[1] = near.count > 0 ? best[0] : gate_px;
    }
    near.line[slot] = index;
    near.distance_px[slot] = d;
    best[slot] = distance;
    near.count = near.count < 2 ? near.count + 1 : 2;
  }
  return near;
}
// Of the event's own lines.
inline NearLines FindNearLines(const Observation& event, const ImageLine* lines, double gate_px, double end_margin_px) {
  return FindNearLines(event, event.Lines(), lines, gate_px, end_margin_px);
}

}  // namespace evpose
