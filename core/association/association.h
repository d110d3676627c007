// SPDX-License-Identifier: Apache-2.0

// Association of events with lines (core/association/README.md, section 2): moving image lines, a grid of image tiles
// with the lines near each tile, and the lines nearest to an event. A line is a straight line of the model, or one of
// the elements that approximate a curve or a contour (section 5).
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <deque>
#include <limits>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/motion_prior.h"
#include "core/geometry/projected_line.h"
#include "core/geometry/undistortion_table.h"
#include "core/mesh/types/edge_curve.h"
#include "core/models/visibility.h"
#include "core/windows/pixel_history.h"

namespace evpose {

// A visible part of a model line, or an edge element: object frame, metres.
struct TrackedLine {
  // Number of the edge curve by which statistics over time are stored: ModelEdges::CurveOf() of the index in
  // ObjectModel::lines or of EdgeElement::curve.
  int curve = 0;
  Eigen::Vector3d p1;
  Eigen::Vector3d p2;
  // Upper bound of the image width of the narrowest adjacent face, pixels. The two edges of a face that is seen nearly
  // edge-on cannot be distinguished. Infinite for a line without flat faces.
  double narrowest_face_px = std::numeric_limits<double>::infinity();
  // Part of a curve or contour, or one of the straight lines of a model that has many: it is short, and its estimation
  // costs less. The elements of a curve are consecutive, and the normals of their images point to the same side of it.
  bool is_element = false;
  EdgeKind kind = EdgeKind::kCrease;
  float prior_contrast = 1.0f;  // EdgeElement::prior_contrast
  // The elements that continue the curve at p1 and at p2, indices into the same list; -1: the curve ends there.
  int previous = -1;
  int next = -1;
  // An element that stands for an arc: the sagitta of the arc as a vector, from the middle of its chord to the arc. The
  // line from p1 to p2 is the chord, moved to the mean of the arc; README, equation (11). Zero: a straight element.
  Eigen::Vector3d sagitta = Eigen::Vector3d::Zero();

  // The reader must check the ranges of `curve`, `previous` and `next`. The face width depends on the view and is not
  // part of the state.
  static void VisitState(auto& archive, auto& self) {
    auto& [curve, p1, p2, narrowest_face_px, is_element, kind, prior_contrast, previous, next, sagitta] = self;
    archive(curve, Finite(p1), Finite(p2), is_element, AtMost(kind, EdgeKind::kContour),
            InRange(prior_contrast, 0.0f, 1.0f), previous, next, Finite(sagitta));
  }
};

// Calls `visit(first, end)` for each edge curve: a straight line alone, or the elements [first, end) of one curve.
template <typename Visit>
void ForEachCurve(absl::Span<const TrackedLine> lines, const Visit& visit) {
  for (size_t first = 0; first < lines.size();) {
    size_t end = first + 1;
    while (lines[first].is_element && end < lines.size() && lines[end].is_element &&
           lines[end].curve == lines[first].curve) {
      ++end;
    }
    visit(first, end);
    first = end;
  }
}

// The moving image of a TrackedLine. The signed distance of bearing b from it is d = (a + tau a_dot) . b pixels, where
// tau is the time in seconds since the time of the state; from that of an arc it is d - ArcOffsetAt().
struct ImageLine {
  Eigen::Vector3d a = Eigen::Vector3d::Zero();
  // The same line displaced by the edge bias, to the expected position of its events (core/estimation/edge_bias.h);
  // equal to a until the correction is applied.
  Eigen::Vector3d a_expected = Eigen::Vector3d::Zero();
  Eigen::Vector3d a_dot = Eigen::Vector3d::Zero();
  Eigen::Vector2d p1_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d direction = Eigen::Vector2d::Zero();  // unit, from p1 to p2
  double length_px = 0.0;                               // 0 if the line is not in view; no event is then near it
  // The following members, up to is_element, differ from their defaults for elements only.
  double along_dot_px_per_s = 0.0;  // velocity of the element along itself
  double sagitta_px = 0.0;          // sagitta of an arc in the direction of the gradient of d
  // The slope of the border to the element that continues at p1 and at p2 (README, equation (9)), and whether one does.
  std::array<double, 2> border = {0.0, 0.0};
  std::array<bool, 2> is_joined = {false, false};
  float prior_contrast = 1.0f;
  bool is_element = false;
  // The matrix is the last member, so that the members that are read for each event take three cache lines.
  Eigen::Matrix<double, 3, 6> jacobian = Eigen::Matrix<double, 3, 6>::Zero();        // d a / d xi of the pose
  Eigen::Matrix<double, 3, 6> a_dot_jacobian = Eigen::Matrix<double, 3, 6>::Zero();  // d a_dot / d xi of the pose

  bool in_view() const { return length_px > 0.0; }
  // Returns the undistorted pixel at a fraction of the length.
  Eigen::Vector2d PointAt(double fraction) const { return p1_px + fraction * length_px * direction; }
  // Returns the coordinate along the line, pixels from p1, of the projection of an undistorted pixel onto it.
  double AlongPx(double u_px, double v_px) const {
    return (u_px - p1_px.x()) * direction.x() + (v_px - p1_px.y()) * direction.y();
  }
  // Returns the distance of the arc from the line at a coordinate along the line, README, equation (11).
  double ArcOffsetAt(double along_px) const {
    // Events beyond the ends may belong to the neighbours; far beyond, the parabola is not the curve.
    constexpr double kFarthest2 = 2.25;  // square of the position 1.5, which is a quarter of the length beyond an end
    const double position = 2.0 * along_px / length_px - 1.0;
    return sagitta_px * (1.0 / 3.0 - std::min(position * position, kFarthest2));
  }
  // Returns whether a point at this coordinate along the line and this distance from it lies between the ends, or at
  // most margin_px beyond an end at which no element continues, or joined_margin_px beyond a border.
  bool Spans(double along_px, double distance_px, double margin_px, double joined_margin_px) const {
    const double begin_px = along_px + border[0] * distance_px;
    const double end_px = along_px + border[1] * distance_px;
    return begin_px >= -(is_joined[0] ? joined_margin_px : margin_px) &&
           end_px <= length_px + (is_joined[1] ? joined_margin_px : margin_px);
  }
};

// Calls `visit(first, end)` for each straight line and for each arc. An arc consists of successive elements of a curve;
// the direction of their images changes by at most 45 degrees. A longer arc restricts a pose more than one line does.
// `lines` are the images of `tracked`.
template <typename Visit>
void ForEachArc(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines, const Visit& visit) {
  constexpr double kLeastCosine = 0.7071;  // of 45 degrees
  ForEachCurve(tracked, [&](size_t first, size_t end) {
    size_t begin = first;
    for (size_t k = first + 1; k < end; ++k) {
      if (lines[k].direction.dot(lines[begin].direction) >= kLeastCosine) continue;
      visit(begin, k);
      begin = k;
    }
    visit(begin, end);
  });
}

// Computes one image line per tracked line, in the same order, without a_dot_jacobian. Lines behind the camera have
// length 0. TrackedLine::previous and next must be valid.
void ProjectLines(const CameraModel& camera, const MotionState& state, absl::Span<const TrackedLine> lines,
                  std::vector<ImageLine>& image_lines);

// Moves `image_lines` by a small change of the state (Plus() in core/geometry/motion_prior.h). Lines are displaced
// across themselves to first order, README, equation (10): their positions along themselves and their Jacobians stay.
void MoveLines(const Vector12d& change, absl::Span<ImageLine> image_lines);

// Computes a_dot_jacobian of the `image_lines` that ProjectLines() returned for the same arguments; that of elements
// stays zero (core/estimation/README.md, section 7).
void ProjectVelocityJacobians(const CameraModel& camera, const MotionState& state, absl::Span<const TrackedLine> lines,
                              absl::Span<ImageLine> image_lines);

// Returns the normal velocity of the line at a fraction of its length, px/s, positive along the gradient of d.
double NormalSpeedPxPerS(const CameraModel& camera, const ImageLine& line, double fraction);

// Returns the largest standard deviation, pixels, of the middle of a line across itself, under the pose covariance of
// the state.
double PredictedSpreadPx(const CameraModel& camera, const MotionState& state, absl::Span<const ImageLine> lines);

// An event in undistorted coordinates, with the lines that may have produced it: the input of the estimators.
struct Observation {
  double bx = 0.0;  // undistorted bearing (bx, by, 1)
  double by = 0.0;
  double u_px = 0.0;  // undistorted pixel
  double v_px = 0.0;
  double tau_s = 0.0;  // time since the middle of the window
  // Indices of the candidate lines. Six bound the memory; in a tile with more lines those nearest to its centre stay,
  // but an element with a low prior contrast counts as farther away.
  static constexpr int kMaxLines = 6;
  std::array<uint16_t, kMaxLines> lines = {};
  uint8_t num_lines = 0;
  uint8_t polarity = 0;
  PreviousPolarity previous = PreviousPolarity::kUnknown;
  // Density of the events of other objects at this event, 1/px, relative to the event rate of the object's own nearest
  // line, so that the density of this line integrates to one across it (other_objects.h). 0 without other objects.
  float others_per_px = 0.0f;

  absl::Span<const uint16_t> Lines() const { return absl::MakeConstSpan(lines.data(), num_lines); }
  // Returns the probability that the previous event of the pixel had the other polarity; 0.5 if it is unknown.
  double ReversalProbability() const {
    constexpr double kRatio[] = {0.5, 0.0, 1.0};  // by PreviousPolarity
    return kRatio[static_cast<int>(previous)];
  }
};

// Converts an event to an observation without candidate lines; tau_s counts from `t_us`. Returns nullopt for an event
// outside the sensor.
std::optional<Observation> Observe(const CameraModel& camera, const UndistortionTable& undistortion,
                                   const WindowEvent& event, int64_t t_us);

// Distance beyond a joint up to which events are candidates of an element, relative to the reach across it: half of the
// range in which the pose may still move the joint. A larger one would make every event a candidate of the whole chain.
inline constexpr double kJoinedReachRatio = 0.25;

// A grid of tiles of 8 x 8 undistorted pixels. Each tile lists the lines that pass within a given distance. Memory: 8
// bytes for each cell of 8 x 8 tiles, and 1.3 kB for each cell with lines.
class TileGrid {
 public:
  // Side of a tile, pixels: of the order of a gate's half width, so that tiles list few lines outside the gates.
  static constexpr int kTilePx = 8;
  static constexpr int kSlots = Observation::kMaxLines;  // lines per tile; those nearest to its centre are kept
  // Side of a cell, tiles: 64 px. An image of 640 x 480 pixels then has 70 whole cells, enough for a median.
  static constexpr int kCellTiles = 8;
  static constexpr uint32_t kTilesPerCell = kCellTiles * kCellTiles;

  explicit TileGrid(const CameraModel& camera);
  TileGrid(TileGrid&&) = default;  // not copied: cells_ and no_lines_ point into pages_

  // Replaces the lines of the grid. Each tile lists the lines within reach_px of one of its points, and some beyond.
  void Build(absl::Span<const ImageLine> lines, double reach_px);

  static constexpr uint32_t kNoTile = 0xffffffff;
  // Returns the index of the tile of an undistorted pixel; kNoTile outside the grid.
  uint32_t TileOf(double u_px, double v_px) const {
    const double x = (u_px + kMarginPx) / kTilePx;
    const double y = (v_px + kMarginPx) / kTilePx;
    if (!(x >= 0.0 && y >= 0.0 && x < columns_ && y < rows_)) return kNoTile;
    return NumberOf(static_cast<uint32_t>(x), static_cast<uint32_t>(y));
  }
  // Returns the index of the cell of a tile: cells are numbered row by row.
  static uint32_t CellOf(uint32_t tile) { return tile / kTilesPerCell; }
  bool has_lines(uint32_t tile) const { return At(tile).count != 0; }
  absl::Span<const uint16_t> Lines(uint32_t tile) const { return absl::MakeConstSpan(At(tile).lines, At(tile).count); }
  // Sets the candidate lines of the event to the lines of a tile.
  void GiveLines(uint32_t tile, Observation& event) const {
    std::copy_n(At(tile).lines, kSlots, event.lines.begin());
    event.num_lines = static_cast<uint8_t>(At(tile).count);
  }
  // Sets the candidate lines of the event to those of its own tile. Returns false, without lines, if the event lies
  // outside the grid.
  bool GiveLines(Observation& event) const;
  absl::Span<const uint32_t> tiles_with_lines() const { return touched_; }
  // The corner of tile 0 and of cell 0 lies at (-kMarginPx, -kMarginPx).
  int cell_columns() const { return cell_columns_; }
  size_t num_cells() const { return cells_.size(); }
  // Pixels by which the grid exceeds the sensor's rectangle on each side: undistortion moves pixels outwards. Events
  // that it moves farther have no tile and are not used.
  static constexpr double kMarginPx = 64.0;

 private:
  struct Tile {
    static constexpr uint32_t kNone = 0xffffffff;
    uint32_t distances = kNone;  // index into distances_px_
    uint16_t count = 0;
    uint16_t lines[kSlots] = {};
  };
  using Page = std::array<Tile, kTilesPerCell>;  // the tiles of a cell, row by row

  // Tiles are numbered cell by cell, and row by row within a cell.
  uint32_t NumberOf(uint32_t column, uint32_t row) const {
    return (row / kCellTiles * cell_columns_ + column / kCellTiles) * kTilesPerCell + row % kCellTiles * kCellTiles +
           column % kCellTiles;
  }
  const Tile& At(uint32_t tile) const { return (*cells_[tile / kTilesPerCell])[tile % kTilesPerCell]; }
  // Assigns a page to a cell. The cell must not have a page of its own.
  Page* UsePage(uint32_t cell);
  // Returns a tile to which a line is to be added.
  Tile& Touch(uint32_t tile);
  void EnterRow(int row, absl::Span<const ImageLine> lines, size_t index, double reach_px);
  // Enters a line into a full tile, in place of the line that is farthest from the tile's centre, if the new line is
  // nearer. For each tile side by which the prior contrast of an element is below one, it counts as one side farther.
  void Replace(absl::Span<const ImageLine> lines, size_t index, const Eigen::Vector2d& centre_px, Tile& tile);

  int columns_ = 0;
  int rows_ = 0;
  int cell_columns_ = 0;
  std::vector<Page*> cells_;  // no_lines_ for all cells without lines
  std::deque<Page> pages_;    // the first one is no_lines_; reused from one Build() to the next
  Page* no_lines_;            // the page that all cells without lines share; its tiles stay empty
  size_t num_pages_ = 1;      // pages in use
  std::vector<uint32_t> touched_;
  // Distances of the lines of the full tiles that a further line reached, for Replace().
  std::vector<std::array<double, kSlots>> distances_px_;
};

// The one or two lines nearest to an event, the nearest first, with signed distances.
struct NearLines {
  int count = 0;
  int line[2] = {0, 0};
  double distance_px[2] = {0.0, 0.0};
};

// Returns the coordinate along the line at the time of the event, pixels.
inline double AlongPx(const Observation& event, const ImageLine& line) {
  return line.AlongPx(event.u_px, event.v_px) - event.tau_s * line.along_dot_px_per_s;
}

// Returns the signed distance of an event from the expected position of a line's events at the time of the event.
inline double DistancePx(const Observation& event, const ImageLine& line) {
  const Eigen::Vector3d& a = line.a_expected;
  const double distance_px = a.x() * event.bx + a.y() * event.by + a.z() +
                             event.tau_s * (line.a_dot.x() * event.bx + line.a_dot.y() * event.by + line.a_dot.z());
  // The motion of the arc along itself within the window is part of a_dot.
  return line.sagitta_px == 0.0 ? distance_px : distance_px - line.ArcOffsetAt(line.AlongPx(event.u_px, event.v_px));
}

// Removes the candidate lines that are farther than reach_px from the event, across the line or beyond its ends, or
// kJoinedReachRatio times as far beyond an end at which another element continues.
void KeepLinesWithin(double reach_px, const ImageLine* lines, Observation& event);

// Returns the nearest two of the candidates that have the event in their gate: |d| <= gate_px, and at most
// end_margin_px beyond an end point. An event at a joint belongs to one of the two elements.
inline NearLines FindNearLines(const Observation& event, absl::Span<const uint16_t> candidates, const ImageLine* lines,
                               double gate_px, double end_margin_px) {
  NearLines near;
  double best[2] = {gate_px, gate_px};
  for (const uint16_t index : candidates) {
    const ImageLine& line = lines[index];
    const double d = DistancePx(event, line);
    const double distance = d < 0.0 ? -d : d;
    if (!(distance <= best[1])) continue;
    if (!line.Spans(AlongPx(event, line), d, end_margin_px, 0.0) || !line.in_view()) continue;
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
// The same for the event's own candidate lines.
inline NearLines FindNearLines(const Observation& event, const ImageLine* lines, double gate_px, double end_margin_px) {
  return FindNearLines(event, event.Lines(), lines, gate_px, end_margin_px);
}

}  // namespace evpose
