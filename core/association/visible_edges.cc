// SPDX-License-Identifier: Apache-2.0
#include "core/association/visible_edges.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "core/association/element_arcs.h"
#include "core/base/yield_point.h"
#include "core/contours/surface_tables.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Changes of the view below which the visible parts are not computed again: the direction from the object to the
// camera centre, radians (0.3 degrees), and the distance. Faces that turn towards or away from the camera are checked
// separately, at every pose.
constexpr double kChangeRad = 0.005;
constexpr double kChangeOfDistance = 0.01;
// For an object that the border of the image cuts: translation of the image, pixels, which moves the ends of a visible
// part by little against a line's length.
constexpr double kChangePx = 2.0;
// Radians (0.75 degrees), for the straight lines of a model that has many, or curves besides: each of its lines has a
// small part of the information, and rays are a large part of the cost.
constexpr double kChangeOfManyRad = 0.013;
// The same for elements: 1.5 degrees and 2 % of the distance. Contours slide in between; what changes is mostly which
// elements are visible, README, section 5.
constexpr double kElementChangeRad = 0.026;
constexpr double kElementChangeOfDistance = 0.02;
// Pixels by which the rim of a flat face that has turned round lies beside the rim that is still extracted, from which
// on the elements are extracted again: the standard deviation of events about an edge.
constexpr double kTurnedFacePx = 0.5;
// Contours between facets do not slide but pass to another edge when a facet turns. A tenth of a pixel is below the
// standard deviation of the distance of an edge that the events of a window determine.
constexpr double kFacetShiftPx = 0.1;
// Number of points at which the visibility of a line is tested in a model with many lines. Most of its lines are short.
constexpr int kFewSamples = 8;
// Largest number of lines of a model that are tested to choose those of a view; hidden lines are among them.
constexpr size_t kMaxTested = 384;
// Ends of successive elements may differ by the displacement that halves the error of a chord, below half a pixel.
constexpr double kJointPx = 1.0;
// Least cosine of the turn between successive elements: the chords of a circle of 3 px in radius turn by 47 degrees.
// Where a curve turns by more, it has a corner.
constexpr double kMinJointCosine = 0.5;

VisibilityOptions WithFewSamples(VisibilityOptions options, bool has_many_lines) {
  if (has_many_lines) options.samples_per_line = std::min(options.samples_per_line, kFewSamples);
  return options;
}

std::vector<int> LongestLines(const ObjectModel& model, size_t max_lines) {
  std::vector<int> order(model.lines.size());
  std::iota(order.begin(), order.end(), 0);
  if (order.size() <= max_lines) return order;
  std::vector<double> squares_m2;
  for (const ModelLine& line : model.lines) squares_m2.push_back((line.p2 - line.p1).squaredNorm());
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return squares_m2[a] > squares_m2[b]; });
  order.resize(max_lines);
  std::sort(order.begin(), order.end());
  return order;
}

// Sine of the angle between two vectors from the object to the camera centre; 1 for angles above 90 degrees.
double SineOfViewChange(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return a.dot(b) > 0.0 ? a.cross(b).norm() / (a.norm() * b.norm()) : 1.0;
}

// Whether, between two poses, the direction from the centre of the object to the camera centre has changed by more than
// `change_rad` in the object frame, or the distance by more than this ratio.
bool HasEyeMoved(const Eigen::Vector3d& centre, const RigidTransform& from, const RigidTransform& to, double change_rad,
                 double distance_ratio) {
  const Eigen::Vector3d now = to.Inverse().translation_m - centre;
  const Eigen::Vector3d then = from.Inverse().translation_m - centre;
  return SineOfViewChange(now, then) > change_rad || std::abs(now.norm() - then.norm()) > distance_ratio * then.norm();
}

}  // namespace

ModelEdges::ModelEdges(const ObjectModel& model, const VisibilityOptions& visibility,
                       const EdgeElementOptions& elements, std::shared_ptr<const SurfaceTables> surface)
    : model_(model),
      surface_(surface != nullptr ? std::move(surface) : std::make_shared<const SurfaceTables>(model)),
      visibility_(model, WithFewSamples(visibility, has_many_lines()), surface_->faces),
      elements_(model, surface_, elements),
      lines_(LongestLines(model, kMaxPool)),
      num_curves_(static_cast<int>(
          std::min<uint64_t>(kMaxCurves, std::max<uint64_t>(elements_.num_curves(), model.lines.size())))),
      sphere_(BoundingSphereOf(model)) {
  for (const EdgeCurve& curve : model.curves) flat_faces_.push_back(FlatFacesOf(curve));
  face_planes_ = FindFacePlanes();
}

std::shared_ptr<const ModelEdges> MakeModelEdges(std::shared_ptr<const ObjectModel> model,
                                                 const VisibilityOptions& visibility,
                                                 const EdgeElementOptions& elements) {
  struct Both {
    Both(std::shared_ptr<const ObjectModel> of, const VisibilityOptions& visibility_,
         const EdgeElementOptions& elements_)
        : model(std::move(of)), edges(*model, visibility_, elements_) {}
    const std::shared_ptr<const ObjectModel> model;
    const ModelEdges edges;
  };
  const auto both = std::make_shared<const Both>(std::move(model), visibility, elements);
  return std::shared_ptr<const ModelEdges>(both, &both->edges);
}

std::vector<ModelEdges::FacePlane> ModelEdges::FindFacePlanes() const {
  constexpr double kSamePlane = 1e-3;  // difference of the normals, and distance relative to the diameter of the model
  std::vector<FacePlane> faces;
  std::vector<Eigen::AlignedBox3d> boxes(model_.surface.regions.size());
  for (size_t i = 0; i < model_.surface.region_of.size(); ++i) {
    const uint32_t region = model_.surface.region_of[i];
    if (!model_.surface.regions[region].is_flat()) continue;
    for (const uint32_t corner : model_.triangles[i]) boxes[region].extend(model_.vertices[corner]);
  }
  for (size_t i = 0; i < boxes.size(); ++i) {
    const SurfaceRegion& region = model_.surface.regions[i];
    if (boxes[i].isEmpty()) continue;
    const Eigen::Vector3d middle = boxes[i].center();
    faces.push_back(
        {region.axis, middle - region.axis.dot(middle - region.point) * region.axis, boxes[i].diagonal().norm()});
  }
  for (size_t i = 0; i < flat_faces_.size(); ++i) {
    for (const Eigen::Vector3d& normal : flat_faces_[i].normals) {
      if (normal.isZero()) continue;
      Eigen::Vector3d middle = Eigen::Vector3d::Zero();
      for (const Eigen::Vector3d& point : model_.curves[i].points) {
        middle += point / static_cast<double>(model_.curves[i].points.size());
      }
      faces.push_back({normal, middle, flat_faces_[i].diameter_m});
    }
  }
  std::stable_sort(faces.begin(), faces.end(),
                   [](const FacePlane& a, const FacePlane& b) { return a.width_m > b.width_m; });
  constexpr size_t kMaxFaces = 16 * kMaxFacePlanes;  // bounds the time: each is compared with the planes so far
  if (faces.size() > kMaxFaces) faces.resize(kMaxFaces);
  std::vector<FacePlane> planes;
  for (const FacePlane& face : faces) {
    if (planes.size() == kMaxFacePlanes) break;
    const bool is_known = std::any_of(planes.begin(), planes.end(), [&](const FacePlane& plane) {
      return (plane.normal - face.normal).norm() < kSamePlane &&
             std::abs(plane.normal.dot(face.point - plane.point)) < kSamePlane * model_.diameter_m;
    });
    if (!is_known) planes.push_back(face);
  }
  return planes;
}

bool ModelEdges::IsNarrow(const FacePlane& plane, double distance_m, double focal_px) {
  return focal_px * plane.width_m * kElementChangeRad < kTurnedFacePx * distance_m;
}

void ModelEdges::FacingPlanes(const Eigen::Vector3d& eye, double focal_px, std::vector<bool>& facing) const {
  facing.clear();
  const double distance_m = (eye - sphere_.centre).norm();
  for (const FacePlane& plane : face_planes_) {
    facing.push_back(!IsNarrow(plane, distance_m, focal_px) && plane.normal.dot(eye - plane.point) > 0.0);
  }
}

ModelEdges::FlatFaces ModelEdges::FlatFacesOf(const EdgeCurve& curve) {
  constexpr double kSameNormal = 1e-3;  // the rounding of a face in single precision, and far below a tessellation step
  FlatFaces faces = {{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()}, 0.0};
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& point : curve.points) middle += point / static_cast<double>(curve.points.size());
  for (const Eigen::Vector3d& point : curve.points) {
    faces.diameter_m = std::max(faces.diameter_m, 2.0 * (point - middle).norm());
  }
  for (int side = 0; side < 2 && !curve.face_normals.empty(); ++side) {
    const Eigen::Vector3d& first = curve.face_normals.front()[side];
    const bool is_flat = std::all_of(curve.face_normals.begin(), curve.face_normals.end(),
                                     [&](const auto& normals) { return (normals[side] - first).norm() < kSameNormal; });
    if (is_flat) faces.normals[side] = first;
  }
  return faces;
}

double ModelEdges::NarrowestFacePx(uint32_t curve, const Eigen::Vector3d& to_eye, double focal_px) const {
  const size_t index = curve - model_.lines.size();
  if (curve < model_.lines.size() || index >= flat_faces_.size()) return kInfinity;
  double narrowest_px = kInfinity;
  const double width_px = focal_px * flat_faces_[index].diameter_m / to_eye.squaredNorm();
  for (const Eigen::Vector3d& normal : flat_faces_[index].normals) {
    if (normal.isZero()) continue;
    narrowest_px = std::min(narrowest_px, width_px * std::abs(normal.dot(to_eye)));
  }
  return narrowest_px;
}

VisibleEdges::VisibleEdges(const CameraModel& camera, const ModelEdges& edges) : camera_(camera), edges_(edges) {
  if (!edges.has_many_lines()) chosen_ = edges.lines();
}

bool VisibleEdges::ViewChanged(const RigidTransform& camera_from_object) const {
  if (!computed_at_) return true;
  const double change_rad = edges_.elements().has_curves() || edges_.has_many_lines() ? kChangeOfManyRad : kChangeRad;
  if (was_whole_ && IsWholeInImage(camera_from_object)) {
    return HasEyeMoved(edges_.centre(), *computed_at_, camera_from_object, change_rad, kChangeOfDistance);
  }
  const Vector6d change = Difference(camera_from_object, *computed_at_);
  const double depth_m = camera_from_object.translation_m.norm();
  return change.head<3>().norm() * camera_.MaxFocalPx() > kChangePx * depth_m || change.tail<3>().norm() > change_rad;
}

bool VisibleEdges::IsWholeInImage(const RigidTransform& camera_from_object) const {
  const Eigen::Vector3d centre = camera_from_object * edges_.centre();
  const double radius_m = edges_.sphere().radius_m;
  const double nearest_m = centre.z() - radius_m;
  if (!(nearest_m > 0.0)) return false;
  // No point of the sphere is further from the image of its centre, in any of the two directions.
  const Eigen::Vector2d middle = centre.head<2>() / centre.z();
  const double reach_px = camera_.MaxFocalPx() * radius_m / nearest_m * (1.0 + middle.cwiseAbs().maxCoeff());
  const Eigen::Vector2d middle_px = camera_.Project(centre);
  // The middles of the sides are tested, too, because a lens bends them.
  for (int row = -1; row <= 1; ++row) {
    for (int column = -1; column <= 1; ++column) {
      const bool is_on_border = row != 0 || column != 0;
      if (is_on_border && !camera_.IsInImage(middle_px + reach_px * Eigen::Vector2d(column, row))) return false;
    }
  }
  return true;
}

bool VisibleEdges::ElementsChanged(const RigidTransform& camera_from_object, int level) {
  if (!extracted_at_ || level != level_) return true;
  if (Difference(camera_from_object, *extracted_at_).tail<3>().norm() > kElementChangeRad) return true;
  if (HasEyeMoved(edges_.centre(), *extracted_at_, camera_from_object, kElementChangeRad, kElementChangeOfDistance)) {
    return true;
  }
  const Eigen::Vector3d eye = camera_from_object.Inverse().translation_m;
  edges_.FacingPlanes(eye, camera_.MaxFocalPx(), facing_planes_now_);
  if (facing_planes_now_ != facing_planes_) return true;
  return std::any_of(elements_.begin(), elements_.end(), [&](const EdgeElement& element) {
    return edges_.elements().FacetShiftPx(element, eye, camera_.MaxFocalPx()) > kFacetShiftPx;
  });
}

void VisibleEdges::FacingFaces(const Eigen::Vector3d& eye, std::vector<bool>& facing) const {
  facing.clear();
  for (const int index : chosen_) {
    const ModelLine& line = edges_.model().lines[index];
    for (const Eigen::Vector3d& normal : line.face_normals) facing.push_back(normal.dot(eye - line.p1) > 0.0);
  }
}

absl::Span<const TrackedLine> VisibleEdges::At(const RigidTransform& camera_from_object) {
  if (edges_.elements().has_curves() || edges_.has_many_lines()) {
    const int level = DetailLevel(edges_.model(), camera_, camera_from_object, level_);
    if (ElementsChanged(camera_from_object, level)) {
      ExtractAt(camera_from_object, level);
      if (edges_.has_many_lines()) computed_at_.reset();  // the chosen lines may be others
    }
  }
  const Eigen::Vector3d eye = camera_from_object.Inverse().translation_m;
  FacingFaces(eye, facing_now_);
  if (facing_now_ != facing_ || ViewChanged(camera_from_object)) {
    facing_.swap(facing_now_);
    ComputeAt(camera_from_object);
  }
  PlaceElements(eye);
  MeasureFaces(eye);
  return lines_;
}

void VisibleEdges::MeasureFaces(const Eigen::Vector3d& eye) {
  const double focal_px = camera_.MaxFocalPx();
  const ObjectModel& model = edges_.model();
  for (size_t k = 0; k < segments_.size(); ++k) {
    TrackedLine& line = lines_[k];
    const Eigen::Vector3d to_eye = eye - 0.5 * (line.p1 + line.p2);
    const double width_px = focal_px * model.diameter_m / to_eye.squaredNorm();
    line.narrowest_face_px = kInfinity;
    for (const Eigen::Vector3d& normal : model.lines[segments_[k].line].face_normals) {
      line.narrowest_face_px = std::min(line.narrowest_face_px, width_px * std::abs(normal.dot(to_eye)));
    }
  }
  for (size_t k = 0; k < elements_.size(); ++k) {
    TrackedLine& line = lines_[segments_.size() + k];
    const Eigen::Vector3d to_eye = eye - 0.5 * (line.p1 + line.p2);
    line.narrowest_face_px = edges_.NarrowestFacePx(elements_[k].curve, to_eye, focal_px);
  }
}

void VisibleEdges::ComputeAt(const RigidTransform& camera_from_object) {
  computed_at_ = camera_from_object;
  was_whole_ = IsWholeInImage(camera_from_object);
  lines_.clear();
  edges_.visibility().FindVisibleSegments(camera_, camera_from_object, chosen_, segments_);
  for (const VisibleSegment& segment : segments_) {
    const ModelLine& line = edges_.model().lines[segment.line];
    const Eigen::Vector3d extent = line.p2 - line.p1;
    lines_.push_back({.curve = edges_.CurveOf(static_cast<uint32_t>(segment.line)),
                      .p1 = line.p1 + segment.begin * extent,
                      .p2 = line.p1 + segment.end * extent,
                      .is_element = edges_.has_many_lines(),
                      .kind = line.kind});
  }
  SetPriorContrasts(camera_from_object);
}

float VisibleEdges::ContrastOf(const ModelLine& line, const SeenEdge& edge) const {
  if (line.kind != EdgeKind::kCrease || line.face_normals.size() != 2) return 1.0f;
  switch (SidesOf(edge, edges_.visibility().faces(), edges_.model().diameter_m)) {
    case EdgeSides::kBackground:
      return 1.0f;
    case EdgeSides::kParallel:
      return kStepContrast;
    case EdgeSides::kDifferent:
      break;
  }
  const Eigen::Vector3d &a = line.face_normals[0], &b = line.face_normals[1];
  const float contrast = CreaseContrast(DeterministicAtan2(a.cross(b).norm(), a.dot(b)));
  return contrast < kSharpCreaseContrast ? contrast : 1.0f;
}

void VisibleEdges::SetPriorContrasts(const RigidTransform& camera_from_object) {
  images_.clear();
  for (const TrackedLine& line : lines_) {
    images_.push_back(
        SegmentBetween(camera_.Project(camera_from_object * line.p1), camera_.Project(camera_from_object * line.p2)));
  }
  const Eigen::Vector3d eye = camera_from_object.Inverse().translation_m;
  for (size_t i = 0; i < lines_.size(); ++i) {
    YieldPoint(i);
    const auto is_stronger = [&](size_t k) {
      const double half_px = images_[k].half_length_px, own_half_px = images_[i].half_length_px;
      return half_px != own_half_px ? half_px > own_half_px : k < i;
    };
    TrackedLine& line = lines_[i];
    line.prior_contrast =
        ContrastOf(edges_.model().lines[segments_[i].line], {eye, line.p1, line.p2, camera_.MaxFocalPx()});
    for (size_t k = 0; k < lines_.size() && line.prior_contrast > kStepContrast; ++k) {
      if (is_stronger(k) && IsBeside(images_[i], images_[k])) line.prior_contrast = kStepContrast;
    }
  }
}

void VisibleEdges::ExtractAt(const RigidTransform& camera_from_object, int level) {
  extracted_at_ = camera_from_object;
  level_ = level;
  if (edges_.has_many_lines()) ChooseLines(camera_from_object);
  elements_.clear();
  if (edges_.elements().has_curves()) {
    has_more_elements_ = edges_.elements().Extract(camera_, camera_from_object, level, elements_);
  }
  std::stable_sort(elements_.begin(), elements_.end(), [this](const EdgeElement& a, const EdgeElement& b) {
    return edges_.CurveOf(a.curve) < edges_.CurveOf(b.curve);
  });
  const Eigen::Vector3d eye = camera_from_object.Inverse().translation_m;
  edges_.FacingPlanes(eye, camera_.MaxFocalPx(), facing_planes_);
  for (EdgeElement& element : elements_) {
    if (element.kind != EdgeKind::kContour) continue;
    // The outward normal of the surface is the side on which the distance is positive.
    if ((element.p1 - eye).cross(element.p2 - eye).dot(element.normals[0] + element.normals[1]) >= 0.0) continue;
    std::swap(element.p1, element.p2);
    std::swap(element.normals[0], element.normals[1]);
    std::swap(element.radius_m[0], element.radius_m[1]);
  }
  joined_.clear();
  for (const EdgeElement& element : elements_) {
    TrackedLine& line = joined_.emplace_back();
    line.curve = edges_.CurveOf(element.curve);
    line.p1 = element.p1;
    line.p2 = element.p2;
    line.is_element = true;
    line.kind = element.kind;
    line.prior_contrast = element.prior_contrast;
  }
  FindNeighbours(camera_from_object);
  JoinArcs(camera_, camera_from_object, edges_.elements().options(), elements_, joined_);
}

void VisibleEdges::FindNeighbours(const RigidTransform& camera_from_object) {
  const Eigen::Vector3d eye = camera_from_object.Inverse().translation_m;
  std::vector<std::pair<double, int>> begins;  // first coordinate of p1, and the element
  for (size_t k = 0; k < joined_.size(); ++k) begins.emplace_back(joined_[k].p1.x(), static_cast<int>(k));
  std::sort(begins.begin(), begins.end());
  for (size_t k = 0; k < joined_.size(); ++k) {
    YieldPoint(k);
    TrackedLine& line = joined_[k];
    const Eigen::Vector3d along = (line.p2 - line.p1).normalized();
    double least_m = kJointPx * (line.p2 - eye).norm() / camera_.MaxFocalPx();
    int nearest = -1;
    auto at = std::lower_bound(begins.begin(), begins.end(), std::pair(line.p2.x() - least_m, -1));
    for (const double last = line.p2.x() + least_m; at != begins.end() && at->first <= last; ++at) {
      const TrackedLine& other = joined_[at->second];
      const double distance_m = (other.p1 - line.p2).norm();
      if (other.kind != line.kind || other.previous >= 0 || at->second == static_cast<int>(k)) continue;
      if (!(distance_m < least_m) || along.dot((other.p2 - other.p1).normalized()) < kMinJointCosine) continue;
      least_m = distance_m;
      nearest = at->second;
    }
    if (nearest < 0) continue;
    line.next = nearest;
    joined_[nearest].previous = static_cast<int>(k);
  }
}

void VisibleEdges::ChooseLines(const RigidTransform& camera_from_object) {
  struct Candidate {
    double weight_px = 0.0;
    int line = 0;
  };
  // An edge between a visible face and a face that is turned away is part of the outline, which has the highest
  // contrast.
  constexpr double kOutlineWeight = 2.0;
  const Eigen::Vector3d eye = camera_from_object.Inverse().translation_m;
  const double focal_px = camera_.MaxFocalPx();
  std::vector<Candidate> candidates;
  size_t position = 0;
  for (const int index : edges_.lines()) {
    YieldPoint(position++);
    const ModelLine& line = edges_.model().lines[index];
    const auto is_facing = [&](const Eigen::Vector3d& normal) { return normal.dot(eye - line.p1) > 0.0; };
    const auto facing = std::count_if(line.face_normals.begin(), line.face_normals.end(), is_facing);
    if (facing == 0 && !line.face_normals.empty()) continue;
    const bool is_outline = facing < static_cast<std::ptrdiff_t>(line.face_normals.size());
    const Eigen::Vector3d to_middle = 0.5 * (line.p1 + line.p2) - eye;
    if (!(to_middle.norm() > 0.0)) continue;
    const double across_m = to_middle.cross(line.p2 - line.p1).norm() / to_middle.norm();
    candidates.push_back({(is_outline ? kOutlineWeight : 1.0) * focal_px * across_m / to_middle.norm(), index});
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.weight_px > b.weight_px; });
  chosen_.clear();
  std::vector<int> tested;
  size_t num_tested = 0;
  for (size_t begin = 0; begin < std::min(candidates.size(), kMaxTested) && chosen_.size() < ModelEdges::kMaxLines;
       begin += ModelEdges::kMaxLines) {
    tested.clear();
    const size_t end = std::min(begin + ModelEdges::kMaxLines, candidates.size());
    num_tested = end;
    for (size_t i = begin; i < end; ++i) tested.push_back(candidates[i].line);
    std::sort(tested.begin(), tested.end());
    edges_.visibility().FindVisibleSegments(camera_, camera_from_object, tested, segments_);
    for (const VisibleSegment& segment : segments_) {
      if (chosen_.empty() || chosen_.back() != segment.line) chosen_.push_back(segment.line);
    }
  }
  has_more_lines_ = chosen_.size() > ModelEdges::kMaxLines || num_tested < candidates.size();
  if (chosen_.size() > ModelEdges::kMaxLines) chosen_.resize(ModelEdges::kMaxLines);
  std::sort(chosen_.begin(), chosen_.end());
}

void VisibleEdges::PlaceElements(const Eigen::Vector3d& eye) {
  const int offset = static_cast<int>(segments_.size());
  lines_.resize(segments_.size());
  for (size_t k = 0; k < elements_.size(); ++k) {
    EdgeElement placed = elements_[k];
    SlideContour(eye, placed);
    TrackedLine& line = lines_.emplace_back(joined_[k]);
    line.p1 = placed.p1;
    line.p2 = placed.p2;
    if (line.previous >= 0) line.previous += offset;
    if (line.next >= 0) line.next += offset;
  }
}

void VisibleEdges::SaveState(StateWriter& writer) const { writer(computed_at_, extracted_at_, level_); }

void VisibleEdges::LoadState(StateReader& reader) {
  facing_.clear();
  segments_.clear();
  lines_.clear();
  reader(computed_at_, extracted_at_, InRange(level_, -1, kNumDetailLevels - 1));
  reader.Check(extracted_at_.has_value() == (level_ >= 0), "elements without the level of detail");
  if (!reader.ok()) return;
  if (extracted_at_) ExtractAt(RigidTransform(*extracted_at_), level_);
  if (!computed_at_) return;
  const RigidTransform pose = *computed_at_;
  FacingFaces(pose.Inverse().translation_m, facing_);
  ComputeAt(pose);
}

}  // namespace evpose
