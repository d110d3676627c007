// SPDX-License-Identifier: Apache-2.0
#include "core/association/association.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/base/yield_point.h"
#include "core/numerics/reusable_vector.h"

namespace evpose {
namespace {

// All points of a tile lie within half its diagonal, sqrt(2) / 2 of its side, of its centre.
constexpr double kHalfDiagonalPx = 0.7072 * TileGrid::kTilePx;

// Restricts [low, high] to the x with lower <= offset + slope x <= upper.
void Restrict(double offset, double slope, double lower, double upper, double& low, double& high) {
  constexpr double kFlat = 1e-9;  // below it, x changes the expression by less than 1e-5 px within an image
  if (std::abs(slope) < kFlat) {
    if (offset < lower || offset > upper) high = low - 1.0;
    return;
  }
  double first = (lower - offset) / slope;
  double last = (upper - offset) / slope;
  if (first > last) std::swap(first, last);
  low = std::max(low, first);
  high = std::min(high, last);
}

// Returns the slope of the border between an element and its neighbour, README, equation (9); nullopt if the image
// turns by more than 90 degrees between them, as at the ends of a circle that is seen edge-on.
std::optional<double> BorderSlope(const ImageLine& line, const ImageLine& neighbour) {
  const double cosine = line.direction.dot(neighbour.direction);
  if (!neighbour.in_view() || cosine <= 0.0) return std::nullopt;
  const Eigen::Vector2d normal(-line.direction.y(), line.direction.x());
  return normal.dot(neighbour.direction) / (1.0 + cosine);
}

// Computes what straight lines and elements have in common; `line` has its default values before.
void ProjectStraight(const CameraModel& camera, const MotionState& state, const TrackedLine& tracked, ImageLine& line) {
  const std::optional<ProjectedLine> projected = ProjectLine(camera, state.camera_from_object, tracked.p1, tracked.p2);
  if (!projected) return;
  const Eigen::Vector2d extent = projected->p2_px - projected->p1_px;
  const double length_px = extent.norm();
  if (!(length_px > 1e-6) || !std::isfinite(length_px)) return;  // pixels; a shorter line has no direction
  line.a = projected->a;
  line.a_expected = projected->a;
  line.jacobian = projected->jacobian;
  line.a_dot = projected->jacobian * state.twist;
  line.p1_px = projected->p1_px;
  line.direction = extent / length_px;
  line.length_px = length_px;
}

// The derivative of the motion of an element along itself, px, by the pose. `arm` is its middle relative to the origin
// of the object, `point` the same in the camera frame.
Vector6d AlongJacobian(const CameraModel& camera, const ImageLine& line, const Eigen::Vector3d& arm,
                       const Eigen::Vector3d& point) {
  Eigen::Vector3d gradient(line.direction.x() * camera.fx_px, line.direction.y() * camera.fy_px, 0.0);
  gradient.z() = -(gradient.x() * point.x() + gradient.y() * point.y()) / point.z();
  gradient /= point.z();
  Vector6d jacobian;
  jacobian << gradient, arm.cross(gradient);
  return jacobian;
}

// Bends an element to an arc, README, equations (11) and (12).
void ToArc(const CameraModel& camera, const MotionState& state, const Eigen::Vector3d& sagitta_object,
           const Eigen::Vector3d& point, const Vector6d& along_jacobian, ImageLine& line) {
  const Eigen::Vector3d sagitta = state.camera_from_object.rotation * sagitta_object;
  const Eigen::Vector2d focal_px(camera.fx_px, camera.fy_px);
  const Eigen::Vector2d image_px =
      focal_px.cwiseProduct(sagitta.head<2>() - sagitta.z() / point.z() * point.head<2>()) / point.z();
  line.sagitta_px = line.a.head<2>().cwiseQuotient(focal_px).dot(image_px);
  const Eigen::Vector2d along = 2.0 / line.length_px * line.direction;
  const Eigen::Vector3d position(along.x() * camera.fx_px, along.y() * camera.fy_px,
                                 along.dot(Eigen::Vector2d(camera.cx_px, camera.cy_px) - line.p1_px) - 1.0);
  line.jacobian -= 4.0 * line.sagitta_px / line.length_px * position * along_jacobian.transpose();
  line.a_dot = line.jacobian * state.twist;
}

// Sets what only elements have, after the images of all lines are known.
void JoinElements(const CameraModel& camera, const MotionState& state, absl::Span<const TrackedLine> lines,
                  absl::Span<ImageLine> image_lines) {
  for (size_t k = 0; k < lines.size(); ++k) {
    ImageLine& line = image_lines[k];
    if (!lines[k].is_element || !line.in_view()) continue;
    line.is_element = true;
    line.prior_contrast = lines[k].prior_contrast;
    const Eigen::Vector3d arm = state.camera_from_object.rotation * (0.5 * (lines[k].p1 + lines[k].p2));
    const Eigen::Vector3d point = arm + state.camera_from_object.translation_m;
    if (point.z() > 0.0) {
      const Vector6d along_jacobian = AlongJacobian(camera, line, arm, point);
      line.along_dot_px_per_s = along_jacobian.dot(state.twist);
      if (!lines[k].sagitta.isZero(0.0)) ToArc(camera, state, lines[k].sagitta, point, along_jacobian, line);
    }
    const std::array<int, 2> neighbours = {lines[k].previous, lines[k].next};
    for (int end = 0; end < 2; ++end) {
      if (neighbours[end] < 0) continue;
      const std::optional<double> slope = BorderSlope(line, image_lines[neighbours[end]]);
      line.is_joined[end] = slope.has_value();
      line.border[end] = slope.value_or(0.0);
    }
  }
}

}  // namespace

void ProjectLines(const CameraModel& camera, const MotionState& state, absl::Span<const TrackedLine> lines,
                  std::vector<ImageLine>& image_lines) {
  AssignDefaults(lines.size(), image_lines);
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    ProjectStraight(camera, state, lines[k], image_lines[k]);
  }
  JoinElements(camera, state, lines, absl::MakeSpan(image_lines));
}

void MoveLines(const Vector12d& change, absl::Span<ImageLine> image_lines) {
  const Vector6d pose_change = change.head<6>(), twist_change = change.tail<6>();
  for (size_t k = 0; k < image_lines.size(); ++k) {
    YieldPoint(k);
    ImageLine& line = image_lines[k];
    if (!line.in_view()) continue;
    line.a += line.jacobian * pose_change;
    line.a_expected = line.a;
    line.a_dot += line.jacobian * twist_change + line.a_dot_jacobian * pose_change;
  }
}

void ProjectVelocityJacobians(const CameraModel& camera, const MotionState& state, absl::Span<const TrackedLine> lines,
                              absl::Span<ImageLine> image_lines) {
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    if (!image_lines[k].in_view() || lines[k].is_element) continue;
    image_lines[k].a_dot_jacobian =
        LineVelocityJacobian(camera, state.camera_from_object, lines[k].p1, lines[k].p2, state.twist);
  }
}

double NormalSpeedPxPerS(const CameraModel& camera, const ImageLine& line, double fraction) {
  return -BearingOf(camera, line.PointAt(fraction)).dot(line.a_dot);
}

std::optional<Observation> Observe(const CameraModel& camera, const UndistortionTable& undistortion,
                                   const WindowEvent& event, int64_t t_us) {
  if (event.x >= camera.width_px || event.y >= camera.height_px) return std::nullopt;
  const Eigen::Vector2f& bearing = undistortion.Bearing(event.x, event.y);
  Observation observation;
  observation.bx = bearing.x();
  observation.by = bearing.y();
  observation.u_px = camera.fx_px * observation.bx + camera.cx_px;
  observation.v_px = camera.fy_px * observation.by + camera.cy_px;
  observation.tau_s = static_cast<double>(event.t_us - t_us) * 1e-6;
  observation.polarity = event.polarity != 0 ? 1 : 0;
  observation.previous = event.previous;
  return observation;
}

double PredictedSpreadPx(const CameraModel& camera, const MotionState& state, absl::Span<const ImageLine> lines) {
  const Matrix6d covariance = state.covariance.topLeftCorner<6, 6>();
  double largest = 0.0;
  for (const ImageLine& line : lines) {
    if (!line.in_view()) continue;
    const Vector6d row = line.jacobian.transpose() * BearingOf(camera, line.PointAt(0.5));
    largest = std::max(largest, row.dot(covariance * row));
  }
  return std::sqrt(largest);
}

void KeepLinesWithin(double reach_px, const ImageLine* lines, Observation& event) {
  uint8_t count = 0;
  for (const uint16_t index : event.Lines()) {
    const ImageLine& line = lines[index];
    const double distance_px = DistancePx(event, line);
    const bool is_near = std::abs(distance_px) <= reach_px &&
                         line.Spans(AlongPx(event, line), distance_px, reach_px, kJoinedReachRatio * reach_px);
    event.lines[count] = index;
    count += is_near ? 1 : 0;
  }
  event.num_lines = count;
}

TileGrid::TileGrid(const CameraModel& camera)
    : columns_(static_cast<int>((camera.width_px + 2 * kMarginPx) / kTilePx) + 1),
      rows_(static_cast<int>((camera.height_px + 2 * kMarginPx) / kTilePx) + 1),
      cell_columns_((columns_ + kCellTiles - 1) / kCellTiles),
      pages_(1),
      no_lines_(&pages_.front()) {
  const int cell_rows = (rows_ + kCellTiles - 1) / kCellTiles;
  cells_.assign(static_cast<size_t>(cell_columns_) * cell_rows, no_lines_);
}

void TileGrid::Build(absl::Span<const ImageLine> lines, double reach_px) {
  for (const uint32_t tile : touched_) {
    // Pages that are not in use have no lines, so that a page need not be cleared when it is used again.
    Tile& used = (*cells_[CellOf(tile)])[tile % kTilesPerCell];
    used.count = 0;
    used.distances = Tile::kNone;
  }
  for (const uint32_t tile : touched_) cells_[CellOf(tile)] = no_lines_;
  num_pages_ = 1;
  touched_.clear();
  distances_px_.clear();
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    const ImageLine& line = lines[k];
    if (!line.in_view()) continue;
    const double reach = reach_px + kHalfDiagonalPx + std::abs(line.sagitta_px);
    const double y1 = line.p1_px.y();
    const double y2 = line.PointAt(1.0).y();
    const double first = (std::min(y1, y2) - reach + kMarginPx) / kTilePx;
    const double last = (std::max(y1, y2) + reach + kMarginPx) / kTilePx;
    const int first_row = static_cast<int>(std::clamp(first, 0.0, rows_ - 1.0));
    const int last_row = static_cast<int>(std::clamp(last, -1.0, rows_ - 1.0));
    for (int row = first_row; row <= last_row; ++row) EnterRow(row, lines, k, reach);
  }
}

TileGrid::Page* TileGrid::UsePage(uint32_t cell) {
  if (num_pages_ == pages_.size()) pages_.emplace_back();
  cells_[cell] = &pages_[num_pages_++];
  return cells_[cell];
}

inline TileGrid::Tile& TileGrid::Touch(uint32_t tile) {
  Page* page = cells_[CellOf(tile)];
  if (page == no_lines_) page = UsePage(CellOf(tile));
  Tile& touched = (*page)[tile % kTilesPerCell];
  if (touched.count == 0) touched_.push_back(tile);
  return touched;
}

bool TileGrid::GiveLines(Observation& event) const {
  const uint32_t tile = TileOf(event.u_px, event.v_px);
  event.num_lines = 0;
  if (tile == kNoTile) return false;
  GiveLines(tile, event);
  return true;
}

void TileGrid::EnterRow(int row, absl::Span<const ImageLine> lines, size_t index, double reach) {
  const ImageLine& line = lines[index];
  const double y = (row + 0.5) * kTilePx - kMarginPx;
  const Eigen::Vector2d normal(-line.direction.y(), line.direction.x());
  const double across = normal.y() * (y - line.p1_px.y()) - normal.x() * line.p1_px.x();
  const double along = line.direction.y() * (y - line.p1_px.y()) - line.direction.x() * line.p1_px.x();
  double low = -kMarginPx;
  double high = columns_ * kTilePx - kMarginPx;
  Restrict(across, normal.x(), -reach, reach, low, high);
  // A tile's events at a joint may belong to either element, and move with the image within the window.
  const double joined_reach = kHalfDiagonalPx + 2.0 * kJoinedReachRatio * (reach - kHalfDiagonalPx);
  Restrict(along, line.direction.x(), -(line.is_joined[0] ? joined_reach : reach),
           line.length_px + (line.is_joined[1] ? joined_reach : reach), low, high);
  // Tiles whose centre (column + 0.5) kTilePx - kMarginPx lies in [low, high].
  const double first_centre = std::ceil((low + kMarginPx) / kTilePx - 0.5);
  const double last_centre = std::floor((high + kMarginPx) / kTilePx - 0.5);
  const int first = static_cast<int>(std::clamp(first_centre, 0.0, columns_ + 0.0));
  const int last = static_cast<int>(std::clamp(last_centre, -1.0, columns_ - 1.0));
  for (int column = first; column <= last; ++column) {
    Tile& tile = Touch(NumberOf(static_cast<uint32_t>(column), static_cast<uint32_t>(row)));
    if (tile.count == kSlots) {
      Replace(lines, index, {(column + 0.5) * kTilePx - kMarginPx, y}, tile);
      continue;
    }
    tile.lines[tile.count++] = static_cast<uint16_t>(index);
  }
}

void TileGrid::Replace(absl::Span<const ImageLine> lines, size_t index, const Eigen::Vector2d& centre_px, Tile& tile) {
  const auto distance_px = [&](size_t k) {
    const ImageLine& line = lines[k];
    const Eigen::Vector2d from_p1 = centre_px - line.p1_px;
    const double across = std::abs(line.direction.x() * from_p1.y() - line.direction.y() * from_p1.x());
    if (!line.is_element) return across;
    const double along = line.direction.dot(from_p1);
    const double beyond = std::max({0.0, -along, along - line.length_px});
    return std::sqrt(across * across + beyond * beyond) + kTilePx * (1.0 - line.prior_contrast);
  };
  if (tile.distances == Tile::kNone) {
    tile.distances = static_cast<uint32_t>(distances_px_.size());
    std::transform(tile.lines, tile.lines + kSlots, distances_px_.emplace_back().begin(), distance_px);
  }
  std::array<double, kSlots>& distances_px = distances_px_[tile.distances];
  const auto farthest = std::max_element(distances_px.begin(), distances_px.end());
  const double of_new = distance_px(index);
  if (!(of_new < *farthest)) return;
  *farthest = of_new;
  tile.lines[farthest - distances_px.begin()] = static_cast<uint16_t>(index);
}

}  // namespace evpose
