// SPDX-License-Identifier: Apache-2.0
#include "core/models/visibility.h"

#include <algorithm>
#include <limits>
#include <numeric>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// Lines are cut at this depth, because the projection divides by the depth.
constexpr double kNearM = 1e-3;
// Halvings of a sampling step that locate a change of visibility: 1/16 / 2^9 = 1.2e-4 of the line.
constexpr int kBisections = 9;
// The ends of a line are tested this far inside, relative to its length: the faces of other lines meet at its corners.
constexpr double kEndInset = 1e-3;
// Margin around the image, relative to its larger side, from which lens distortion may move a point into the image.
constexpr double kDistortionMargin = 0.5;

struct Interval {
  double begin = 0.0;
  double end = 1.0;
  bool empty() const { return !(begin < end); }
};

// Restricts the interval to the parameters s with value1 + s (value2 - value1) >= 0.
void Clip(double value1, double value2, Interval& interval) {
  if (value1 >= 0.0 && value2 >= 0.0) return;
  if (value1 < 0.0 && value2 < 0.0) {
    interval.end = interval.begin;
    return;
  }
  const double crossing = value1 / (value1 - value2);
  if (value1 < 0.0) {
    interval.begin = std::max(interval.begin, crossing);
  } else {
    interval.end = std::min(interval.end, crossing);
  }
}

// The part of the line, given in the camera frame, that projects into the image enlarged by the margin (px). The
// conditions are linear in the line's parameter (core/models/README.md, equation (4)).
Interval ClipToImage(const CameraModel& camera, const Eigen::Vector3d& p1, const Eigen::Vector3d& p2,
                     double margin_px) {
  Interval interval;
  Clip(p1.z() - kNearM, p2.z() - kNearM, interval);
  const double left = -0.5 - margin_px, right = camera.width_px - 0.5 + margin_px;
  const double top = -0.5 - margin_px, bottom = camera.height_px - 0.5 + margin_px;
  const auto u = [&](const Eigen::Vector3d& p, double bound) {
    return camera.fx_px * p.x() + (camera.cx_px - bound) * p.z();
  };
  const auto v = [&](const Eigen::Vector3d& p, double bound) {
    return camera.fy_px * p.y() + (camera.cy_px - bound) * p.z();
  };
  Clip(u(p1, left), u(p2, left), interval);
  Clip(-u(p1, right), -u(p2, right), interval);
  Clip(v(p1, top), v(p2, top), interval);
  Clip(-v(p1, bottom), -v(p2, bottom), interval);
  return interval;
}

}  // namespace

absl::Status VisibilityOptions::Validate() const {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  EVPOSE_RETURN_IF_ERROR(CheckRange("samples_per_line", samples_per_line, 2, 10'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("surface_tolerance", surface_tolerance, 0.0, 0.1, OpenEnds::kBoth));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_length_px", min_length_px, 0.0, kInfinity, OpenEnds::kHigh));
  return CheckRange("grazing_cosine", grazing_cosine, -1.0, 1.0);
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

  bool SeesPoint(const Eigen::Vector3d& origin_object, const Eigen::Vector3d& point_object) const {
    if (has_distortion && !camera.IsInImage(camera.Project(camera_from_object * point_object))) return false;
    return !faces.IsOccluded(origin_object, point_object, tolerance_m);
  }
};

// The origin of the rays to a line; false if all its faces are turned away. In a grazing view, whether a face hides its
// own lines would depend on rounding errors of the pose: the origin is moved to where the view is no longer grazing
// (core/models/README.md, section 6).
bool FindOrigin(const View& view, const ModelLine& line, const Eigen::Vector3d& middle, Eigen::Vector3d& origin) {
  origin = view.centre_object;
  if (line.face_normals.empty()) return true;
  const Eigen::Vector3d to_camera = view.centre_object - middle;
  const double distance_m = to_camera.norm();
  const Eigen::Vector3d* best_normal = nullptr;
  double best_height_m = 0.0;
  for (const Eigen::Vector3d& normal : line.face_normals) {
    const double height_m = normal.dot(to_camera);
    if (best_normal != nullptr && height_m <= best_height_m) continue;
    best_normal = &normal;
    best_height_m = height_m;
  }
  const double grazing_height_m = view.options.grazing_cosine * distance_m;
  if (best_height_m < grazing_height_m) return false;
  if (best_height_m < -grazing_height_m) origin += (-grazing_height_m - best_height_m) * *best_normal;
  return true;
}

// The parameter between `visible` and `hidden` at which the visibility of the line changes.
double Bisect(const View& view, const Eigen::Vector3d& origin, const ModelLine& line, double visible, double hidden) {
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
    point.z() = std::max(point.z(), kNearM);  // the line is cut there up to rounding
    return view.camera.Project(point);
  };
  if (!(begin < end) || (project(end) - project(begin)).norm() < view.options.min_length_px) return;
  segments.push_back({index, begin, end});
}

void AppendVisibleParts(const View& view, int index, const ModelLine& line, const Interval& interval,
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

VisibilityTester::VisibilityTester(const ObjectModel& model, const VisibilityOptions& options)
    : model_(&model),
      options_(options),
      faces_(model.vertices, model.triangles),
      tolerance_m_(options.surface_tolerance * model.diameter_m),
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
  const View view{camera,
                  camera_from_object,
                  faces_,
                  options_,
                  tolerance_m_,
                  camera_from_object.Inverse().translation_m,
                  camera.HasDistortion()};
  const double margin_px = view.has_distortion ? kDistortionMargin * std::max(camera.width_px, camera.height_px) : 0.0;
  segments.clear();
  for (const int i : lines) {
    const ModelLine& line = model_->lines[i];
    const Interval interval =
        ClipToImage(camera, camera_from_object * line.p1, camera_from_object * line.p2, margin_px);
    if (interval.empty()) continue;
    Eigen::Vector3d origin;
    const Eigen::Vector3d middle = line.p1 + 0.5 * (interval.begin + interval.end) * (line.p2 - line.p1);
    if (!FindOrigin(view, line, middle, origin)) continue;
    AppendVisibleParts(view, i, line, interval, origin, segments);
  }
}

bool VisibilityTester::IsPointVisible(const Eigen::Vector3d& origin_object, const Eigen::Vector3d& point_object) const {
  return !faces_.IsOccluded(origin_object, point_object, tolerance_m_);
}

}  // namespace evpose
