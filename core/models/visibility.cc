// SPDX-License-Identifier: Apache-2.0
#include "core/models/visibility.h"

#include <algorithm>
#include <cstdint>
#include <limits>
#include <numeric>
#include <optional>
#include <utility>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/geometry/image_clip.h"

namespace evpose {
namespace {

// Halvings of a sampling step that locate a change of visibility: 1/16 / 2^9 = 1.2e-4 of the line.
constexpr int kBisections = 9;
// The ends of a line are tested this far inside, relative to its length: the faces of other lines meet at its corners.
constexpr double kEndInset = 1e-3;

}  // namespace

absl::Status VisibilityOptions::Validate() const {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  EVPOSE_RETURN_IF_ERROR(CheckRange("samples_per_line", samples_per_line, 2, 10'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("surface_tolerance", surface_tolerance, 0.0, 0.1, OpenEnds::kBoth));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_length_px", min_length_px, 0.0, kInfinity, OpenEnds::kHigh));
  EVPOSE_RETURN_IF_ERROR(CheckRange("grazing_cosine", grazing_cosine, -1.0, 1.0));
  return CheckRange("painted_cosine", painted_cosine, -1.0, 1.0);
}

bool FindRayOrigin(absl::Span<const Eigen::Vector3d> face_normals, const Eigen::Vector3d& middle, double grazing_cosine,
                   Eigen::Vector3d& origin) {
  if (face_normals.empty()) return true;
  const Eigen::Vector3d to_camera = origin - middle;
  const double distance_m = to_camera.norm();
  const Eigen::Vector3d* best_normal = nullptr;
  double best_height_m = 0.0;
  for (const Eigen::Vector3d& normal : face_normals) {
    const double height_m = normal.dot(to_camera);
    if (best_normal != nullptr && height_m <= best_height_m) continue;
    best_normal = &normal;
    best_height_m = height_m;
  }
  const double grazing_height_m = grazing_cosine * distance_m;
  if (best_height_m < grazing_height_m) return false;
  if (best_height_m < -grazing_height_m) origin += (-grazing_height_m - best_height_m) * *best_normal;
  return true;
}

EdgeSides SidesOf(const SeenEdge& edge, const TriangleBvh& faces, double diameter_m) {
  // Under one lamp, faces that differ by this angle, 6 degrees, differ in brightness by less than the contrast
  // threshold of a sensor.
  constexpr double kSameBrightnessCosine = 0.995;
  const Eigen::Vector3d middle = 0.5 * (edge.p1 + edge.p2);
  const Eigen::Vector3d across = (middle - edge.eye).cross(edge.p2 - edge.p1).normalized();
  const Eigen::Vector3d beside = kBesideEdgePx * (middle - edge.eye).norm() / edge.focal_px * across;
  const auto normal_at = [&](const Eigen::Vector3d& point) {
    return faces.FirstNormal(edge.eye, point + kBackgroundDiameters * diameter_m * (point - edge.eye).normalized());
  };
  const std::optional<Eigen::Vector3d> first = normal_at(middle + beside);
  if (!first) return EdgeSides::kBackground;
  const std::optional<Eigen::Vector3d> second = normal_at(middle - beside);
  if (!second) return EdgeSides::kBackground;
  return first->dot(*second) >= kSameBrightnessCosine ? EdgeSides::kParallel : EdgeSides::kDifferent;
}

namespace {

// The arguments of one call of VisibleSegments.
struct View {
  const CameraModel& camera;
  const RigidTransform& camera_from_object;
  const TriangleBvh& faces;
  const VisibilityOptions& options;
  double tolerance_m;
  Eigen::Vector3d centre_object;
  bool has_distortion;
  uint32_t occluder = ~0u;  // the hint of TriangleBvh::IsOccluded

  bool SeesPoint(const Eigen::Vector3d& origin_object, const Eigen::Vector3d& point_object) {
    if (has_distortion && !camera.IsInImage(camera.Project(camera_from_object * point_object))) return false;
    return !faces.IsOccluded(origin_object, point_object, tolerance_m, occluder);
  }
};

// The parameter between `visible` and `hidden` at which the visibility of the line changes.
double Bisect(View& view, const Eigen::Vector3d& origin, const ModelLine& line, double visible, double hidden) {
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (visible + hidden);
    (view.SeesPoint(origin, line.p1 + middle * (line.p2 - line.p1)) ? visible : hidden) = middle;
  }
  return visible;
}

void AppendSegment(const View& view, int index, const ModelLine& line, double begin, double end,
                   std::vector<VisibleSegment>& segments) {
  const auto project = [&](double s) {
    Eigen::Vector3d point = view.camera_from_object * (line.p1 + s * (line.p2 - line.p1));
    point.z() = std::max(point.z(), kClipDepthM);  // the line is cut there up to rounding
    return view.camera.Project(point);
  };
  if (!(begin < end) || (project(end) - project(begin)).norm() < view.options.min_length_px) return;
  segments.push_back({index, begin, end});
}

void AppendVisibleParts(View& view, int index, const ModelLine& line, const LineInterval& interval,
                        const Eigen::Vector3d& origin, std::vector<VisibleSegment>& segments) {
  const double length = interval.end - interval.begin;
  const int steps = view.options.samples_per_line;
  double begin = interval.begin;
  double previous = interval.begin;
  bool was_visible = false;
  for (int i = 0; i <= steps; ++i) {
    const double fraction = std::clamp(static_cast<double>(i) / steps, kEndInset, 1.0 - kEndInset);
    const double sample = interval.begin + fraction * length;
    const bool is_visible = view.SeesPoint(origin, line.p1 + sample * (line.p2 - line.p1));
    if (is_visible && !was_visible) begin = i == 0 ? interval.begin : Bisect(view, origin, line, sample, previous);
    if (!is_visible && was_visible) {
      AppendSegment(view, index, line, begin, Bisect(view, origin, line, previous, sample), segments);
    }
    was_visible = is_visible;
    previous = sample;
  }
  if (was_visible) AppendSegment(view, index, line, begin, interval.end, segments);
}

}  // namespace

VisibilityTester::VisibilityTester(const ObjectModel& model, const VisibilityOptions& options,
                                   std::shared_ptr<const TriangleBvh> faces)
    : model_(&model),
      options_(options),
      faces_(faces != nullptr ? std::move(faces)
                              : std::make_shared<const TriangleBvh>(model.vertices, model.triangles)),
      tolerance_m_(options.surface_tolerance * model.diameter_m),
      is_solid_(std::any_of(model.lines.begin(), model.lines.end(),
                            [](const ModelLine& line) { return line.face_normals.size() > 1; })),
      all_lines_(model.lines.size()) {
  std::iota(all_lines_.begin(), all_lines_.end(), 0);
}

std::vector<VisibleSegment> VisibilityTester::VisibleSegments(const CameraModel& camera,
                                                              const RigidTransform& camera_from_object) const {
  std::vector<VisibleSegment> segments;
  segments.reserve(model_->lines.size());
  FindVisibleSegments(camera, camera_from_object, segments);
  return segments;
}

void VisibilityTester::FindVisibleSegments(const CameraModel& camera, const RigidTransform& camera_from_object,
                                           std::vector<VisibleSegment>& segments) const {
  FindVisibleSegments(camera, camera_from_object, all_lines_, segments);
}

void VisibilityTester::FindVisibleSegments(const CameraModel& camera, const RigidTransform& camera_from_object,
                                           absl::Span<const int> lines, std::vector<VisibleSegment>& segments) const {
  View view{camera,
            camera_from_object,
            *faces_,
            options_,
            tolerance_m_,
            camera_from_object.Inverse().translation_m,
            camera.HasDistortion()};
  segments.clear();
  for (const int i : lines) {
    const ModelLine& line = model_->lines[i];
    const LineInterval interval = ClipToImage(camera, camera_from_object * line.p1, camera_from_object * line.p2);
    if (interval.empty()) continue;
    Eigen::Vector3d origin = view.centre_object;
    const Eigen::Vector3d middle = line.p1 + 0.5 * (interval.begin + interval.end) * (line.p2 - line.p1);
    const bool is_drawn = is_solid_ && line.kind == EdgeKind::kPainted && line.face_normals.size() == 1;
    const double least_cosine =
        is_drawn ? std::max(options_.grazing_cosine, options_.painted_cosine) : options_.grazing_cosine;
    if (!FindRayOrigin(line.face_normals, middle, least_cosine, origin)) continue;
    AppendVisibleParts(view, i, line, interval, origin, segments);
  }
}

bool VisibilityTester::IsPointVisible(const Eigen::Vector3d& origin_object, const Eigen::Vector3d& point_object) const {
  return !faces_->IsOccluded(origin_object, point_object, tolerance_m_);
}

}  // namespace evpose
