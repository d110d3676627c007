// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/search_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>

#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/initialization/check_lines.h"
#include "core/initialization/direction_symmetries.h"
#include "core/initialization/line_near_symmetries.h"
#include "core/initialization/pose_search.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Number of lines that are searched for, the longest first: enough to determine a pose; more would only cost time. A
// model with more lines is a detailed part, most of whose lines are short and hidden; the time of a search grows with
// the number of lines and of directions, and kFewLines still show three and more from every side.
constexpr size_t kMaxLines = 256;
constexpr size_t kFewLines = 128;
// Directions closer than this are equal for the search; a segment of 100 px cannot resolve less.
constexpr double kSameDirectionRad = 0.01;
// Cosine of 8 degrees: a rotation that maps the directions onto each other preserves a direction, reverses it, or turns
// it by at least the angle between two of them.
constexpr double kSameAxisCosine = 0.99;
// Number of directions up to which their symmetries are computed. The time grows with its fourth power, and an object
// with more directions has hardly any.
constexpr size_t kMaxDirections = 64;
// Angle below which two labellings are equal, radians: twice the tolerance of a direction.
constexpr double kSameLabellingRad = 0.02;
// Distance from which the views are rendered, in radii: perspective changes the visible lines by more than a few
// degrees only at much smaller distances.
constexpr double kViewDistanceOfRadius = 6.0;
constexpr int kMaxCellsPerSide = 8;  // cells of 11 degrees
// Limit of the product of lines and views when a model is prepared; takes a fraction of a second.
constexpr int kMaxViewLines = 100'000;
// Rays per line for the visibility of its parts; fewer than in tracking, because a search tests many lines and poses.
constexpr int kSamplesPerLine = 6;
// Shortest visible part, pixels: a shorter one gives no segment.
constexpr double kMinPartPx = 4.0;
// Number of pairs of directions; the search sweeps fewer than this in its budget of rotations.
constexpr size_t kMaxPairs = 4096;

// A camera that sees the whole object from the distance of the views. Its resolution only determines the shortest part
// that counts as visible: about 1/100 of the radius.
CameraModel ViewCamera() { return {2400, 2400, 2400.0, 2400.0, 1200.0, 1200.0, {}}; }

// Returns whether a rotation reverses a unit vector.
bool Reverses(const Matrix3d& rotation, const Vector3d& v) { return v.dot(rotation * v) < -kSameAxisCosine; }
// Returns whether a rotation preserves a unit vector.
bool Preserves(const Matrix3d& rotation, const Vector3d& v) { return v.dot(rotation * v) > kSameAxisCosine; }

}  // namespace

SearchModel::SearchModel(const ObjectModel& model, std::shared_ptr<const TriangleBvh> faces) {
  if (faces == nullptr) faces = std::make_shared<const TriangleBvh>(model.vertices, model.triangles);
  ChooseLines(model);
  FindLabellings(model);
  near_symmetries_ = FindLineNearSymmetries(shape_.lines, labellings_, radius_m_);
  FindPairs();
  const VisibilityOptions visibility = {.samples_per_line = kSamplesPerLine, .min_length_px = kMinPartPx};
  visibility_ = std::make_unique<VisibilityTester>(shape_, visibility, std::move(faces));
  MakeViews(model.views);
}

void SearchModel::ChooseLines(const ObjectModel& model) {
  const auto length_m = [&](int i) { return (model.lines[i].p2 - model.lines[i].p1).norm(); };
  std::vector<int> order(model.lines.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int i, int j) { return length_m(i) > length_m(j); });
  while (!order.empty() && !(length_m(order.back()) > 0.0)) order.pop_back();
  if (order.size() > kMaxLines) order.resize(kFewLines);

  shape_.diameter_m = model.diameter_m;
  for (const int i : order) shape_.lines.push_back(model.lines[i]);
  directions_ = UniqueDirections(shape_, kSameDirectionRad);
  direction_lengths_m_.assign(directions_.size(), 0.0);
  Vector3d low = shape_.lines[0].p1, high = low;
  for (size_t i = 0; i < order.size(); ++i) {
    const ModelLine& line = shape_.lines[i];
    SearchLine out{line.p1, line.p2, (line.p2 - line.p1).normalized(), (line.p2 - line.p1).norm(), 0, order[i]};
    const auto nearest = std::max_element(directions_.begin(), directions_.end(), [&](const auto& a, const auto& b) {
      return std::abs(a.dot(out.along)) < std::abs(b.dot(out.along));
    });
    out.direction = static_cast<int>(nearest - directions_.begin());
    direction_lengths_m_[out.direction] += out.length_m;
    lines_.push_back(out);
    low = low.cwiseMin(line.p1).cwiseMin(line.p2);
    high = high.cwiseMax(line.p1).cwiseMax(line.p2);
  }
  centre_ = 0.5 * (low + high);
  for (const SearchLine& line : lines_) {
    radius_m_ = std::max({radius_m_, (line.p1 - centre_).norm(), (line.p2 - centre_).norm()});
  }
}

void SearchModel::FindLabellings(const ObjectModel& model) {
  num_symmetries_ = std::max<size_t>(1, model.symmetries.size());
  direction_symmetries_ = {Matrix3d::Identity()};
  if (directions_.size() <= kMaxDirections) {
    direction_symmetries_ = DirectionSymmetries(directions_, kSameDirectionRad);
  }
  for (const Matrix3d& rotation : direction_symmetries_) {
    YieldPoint();
    const auto equals = [&](const Matrix3d& other) {
      const auto same = [&](const Matrix3d& q) { return RotationAngle(other * q, rotation) < kSameLabellingRad; };
      return same(Matrix3d::Identity()) ||
             std::any_of(model.symmetries.begin(), model.symmetries.end(),
                         [&](const RigidTransform& symmetry) { return same(symmetry.rotation); });
    };
    if (std::none_of(labellings_.begin(), labellings_.end(), equals)) labellings_.push_back(rotation);
  }
}

void SearchModel::FindPairs() {
  const int count = static_cast<int>(directions_.size());
  // Returns whether a pair of directions is new: no symmetry maps an earlier pair onto it.
  const auto is_new = [&](int a, int b) {
    return std::none_of(pairs_.begin(), pairs_.end(), [&](const DirectionPair& pair) {
      return std::any_of(direction_symmetries_.begin(), direction_symmetries_.end(), [&](const Matrix3d& q) {
        return std::abs((q * directions_[pair.a]).dot(directions_[a])) > 1.0 - kSameDirectionRad * kSameDirectionRad &&
               std::abs((q * directions_[pair.b]).dot(directions_[b])) > 1.0 - kSameDirectionRad * kSameDirectionRad;
      });
    });
  };
  std::vector<std::pair<int, int>> order;
  for (int a = 0; a < count; ++a) {
    for (int b = 0; b < count; ++b) {
      if (a != b) order.emplace_back(a, b);
    }
  }
  const auto weight = [&](const std::pair<int, int>& p) {
    return direction_lengths_m_[p.first] * direction_lengths_m_[p.second];
  };
  std::stable_sort(order.begin(), order.end(), [&](const auto& p, const auto& q) { return weight(p) > weight(q); });
  for (const auto& [a, b] : order) {
    YieldPoint();
    if (pairs_.size() >= kMaxPairs) break;
    if (direction_symmetries_.size() > 1 && !is_new(a, b)) continue;
    DirectionPair pair{a, b, directions_[a].dot(directions_[b]), Matrix3d::Identity()};
    pair.frame.col(0) = directions_[a];
    pair.frame.col(1) = (directions_[b] - pair.cosine * directions_[a]).normalized();
    pair.frame.col(2) = pair.frame.col(0).cross(pair.frame.col(1));
    for (const Matrix3d& q : direction_symmetries_) {
      const bool reverses_a = Reverses(q, directions_[a]), reverses_b = Reverses(q, directions_[b]);
      pair.needs_half_circle |= reverses_a && (reverses_b || Preserves(q, directions_[b]));
      pair.has_one_solution |= Preserves(q, directions_[a]) && reverses_b;
    }
    pairs_.push_back(pair);
  }
}

Vector3d SearchModel::CellPoint(int cell, double u, double v) const {
  const int face = cell / (cells_per_side_ * cells_per_side_);
  const int row = cell / cells_per_side_ % cells_per_side_, column = cell % cells_per_side_;
  const int axis = face / 2;
  Vector3d point = Vector3d::Unit(axis) * (face % 2 == 0 ? 1.0 : -1.0);
  point[(axis + 1) % 3] = 2.0 * (row + u) / cells_per_side_ - 1.0;
  point[(axis + 2) % 3] = 2.0 * (column + v) / cells_per_side_ - 1.0;
  return point;
}

const std::vector<ViewLine>& SearchModel::View(const Vector3d& to_camera) const {
  int axis = 0;
  const double largest = to_camera.cwiseAbs().maxCoeff(&axis);
  const auto place = [&](int i) {
    const double share = 0.5 * (to_camera[(axis + i) % 3] / largest + 1.0);
    return std::clamp(static_cast<int>(share * cells_per_side_), 0, cells_per_side_ - 1);
  };
  const int face = 2 * axis + (to_camera[axis] > 0.0 ? 0 : 1);
  return (*views_)[(face * cells_per_side_ + place(1)) * cells_per_side_ + place(2)];
}

void SearchModel::MakeViews(const std::shared_ptr<const SearchViews>& stored) {
  const int num_lines = static_cast<int>(lines_.size());
  cells_per_side_ = kMaxCellsPerSide;
  while (cells_per_side_ > 2 && 6 * 5 * cells_per_side_ * cells_per_side_ * num_lines > kMaxViewLines)
    --cells_per_side_;
  const int num_cells = 6 * cells_per_side_ * cells_per_side_;
  if (stored != nullptr && AreOfThisModel(stored->lines)) {
    views_ = {stored, &stored->lines};
  } else {
    auto made = std::make_shared<SearchViews::LineViews>();
    for (int cell = 0; cell < num_cells; ++cell) {
      YieldPoint();
      made->push_back(MakeView(cell));
    }
    views_ = std::move(made);
  }
  for (const auto& view : *views_) mean_view_size_ += static_cast<double>(view.size()) / num_cells;
}

bool SearchModel::AreOfThisModel(const SearchViews::LineViews& views) const {
  const auto is_of_model = [this](const ViewLine& seen) {
    return seen.line >= 0 && static_cast<size_t>(seen.line) < lines_.size() && seen.begin >= 0.0 &&
           seen.begin < seen.end && seen.end <= 1.0 && seen.certain_ratio >= 0.0 && seen.certain_ratio <= 1.0 + 1e-9;
  };
  const auto has_lines = [&](const std::vector<ViewLine>& view) {
    return view.size() <= lines_.size() && std::all_of(view.begin(), view.end(), is_of_model);
  };
  const int num_cells = 6 * cells_per_side_ * cells_per_side_;
  return views.size() == static_cast<size_t>(num_cells) && std::all_of(views.begin(), views.end(), has_lines);
}

std::vector<ViewLine> SearchModel::MakeView(int cell) const {
  // The directions at which a cell is sampled: its centre and points near its corners.
  constexpr std::array<std::array<double, 2>, 5> kPlaces = {
      {{0.5, 0.5}, {0.05, 0.05}, {0.05, 0.95}, {0.95, 0.05}, {0.95, 0.95}}};
  struct Seen {
    double begin = 1.0, end = 0.0, least_ratio = 1.0;
  };
  std::vector<Seen> seen(lines_.size());
  std::vector<double> ratio(lines_.size());
  for (const auto& [u, v] : kPlaces) {
    const Vector3d forward = -CellPoint(cell, u, v).normalized();
    Matrix3d rotation;
    rotation.row(2) = forward;
    rotation.row(0) = forward.unitOrthogonal();
    rotation.row(1) = forward.cross(Vector3d(rotation.row(0)));
    const RigidTransform pose{rotation, Vector3d(0.0, 0.0, kViewDistanceOfRadius * radius_m_) - rotation * centre_};
    std::fill(ratio.begin(), ratio.end(), 0.0);
    for (const VisibleSegment& part : visibility_->VisibleSegments(ViewCamera(), pose)) {
      seen[part.line].begin = std::min(seen[part.line].begin, part.begin);
      seen[part.line].end = std::max(seen[part.line].end, part.end);
      ratio[part.line] += part.end - part.begin;
    }
    for (size_t i = 0; i < seen.size(); ++i) {
      seen[i].least_ratio = std::min(seen[i].least_ratio, ratio[i]);
    }
  }
  std::vector<ViewLine> view;
  for (size_t i = 0; i < seen.size(); ++i) {
    if (seen[i].begin < seen[i].end) {
      view.push_back({static_cast<int>(i), seen[i].begin, seen[i].end, seen[i].least_ratio});
    }
  }
  return view;
}

absl::StatusOr<std::shared_ptr<const SearchModel>> MakeSearchModel(std::shared_ptr<const ObjectModel> model,
                                                                   std::shared_ptr<const TriangleBvh> faces) {
  EVPOSE_RETURN_IF_ERROR(CheckLinesDeterminePose(*model));
  struct Both {
    Both(std::shared_ptr<const ObjectModel> of, std::shared_ptr<const TriangleBvh> faces_of)
        : model(std::move(of)), search_model(*model, std::move(faces_of)) {}
    const std::shared_ptr<const ObjectModel> model;
    const SearchModel search_model;
  };
  const auto both = std::make_shared<const Both>(std::move(model), std::move(faces));
  return std::shared_ptr<const SearchModel>(both, &both->search_model);
}

}  // namespace evpose
