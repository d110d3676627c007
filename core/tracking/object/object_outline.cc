// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/object_outline.h"

#include <cmath>
#include <optional>
#include <utility>

namespace evpose {
namespace {

// Pixels: distance of a curve from its chord, at the middle and at a quarter, up to which it is drawn as one segment. A
// person does not see it, and more segments take more bytes.
constexpr double kMaxBendPx = 0.1;
// Halvings of a line or arc: 64 parts at most. What remains of one that is partly hidden ends within 1/64 of its
// length.
constexpr int kMaxHalvings = 6;
constexpr double kNearestDepthM = 1e-6;

// Divides the edges of an outline into segments.
class OutlineProjection {
 public:
  OutlineProjection(const CameraModel& camera, const RigidTransform& camera_from_object)
      : camera_(camera), camera_from_object_(camera_from_object) {}

  void Add(const ObjectOutline::Edge& edge) {
    edge_ = &edge;
    AddPart(0.0, PixelAt(0.0), 1.0, PixelAt(1.0), kMaxHalvings);
  }

  std::vector<OutlineSegment> Take() { return std::move(segments_); }

 private:
  // The pixel at a fraction of the length; nullopt where the camera shows none.
  std::optional<Eigen::Vector2d> PixelAt(double fraction) const {
    // core/association/README.md, equation (11).
    const double position = 2.0 * fraction - 1.0;
    const Eigen::Vector3d point = camera_from_object_ * (edge_->p1 + fraction * (edge_->p2 - edge_->p1) +
                                                         (1.0 / 3.0 - position * position) * edge_->sagitta);
    if (!(point.z() > kNearestDepthM)) return std::nullopt;
    const Eigen::Vector2d plane = point.head<2>() / point.z();
    const DistortedPoint distorted = DistortNormalised(camera_.lens_model, camera_.distortion, plane);
    if (!distorted.is_regular) return std::nullopt;
    const Eigen::Vector2d pixel(camera_.fx_px * distorted.point.x() + camera_.cx_px,
                                camera_.fy_px * distorted.point.y() + camera_.cy_px);
    const bool is_near = pixel.x() > -camera_.width_px && pixel.x() < 2 * camera_.width_px &&
                         pixel.y() > -camera_.height_px && pixel.y() < 2 * camera_.height_px;
    return is_near ? std::optional(pixel) : std::nullopt;
  }

  // `begin` and `end` are the pixels at the fractions `from` and `to`.
  void AddPart(double from, const std::optional<Eigen::Vector2d>& begin, double to,
               const std::optional<Eigen::Vector2d>& end, int halvings) {
    const double middle = 0.5 * (from + to);
    const std::optional<Eigen::Vector2d> between = PixelAt(middle);
    if (begin && end && between && (halvings == 0 || IsStraight(from, *begin, *between, *end, to))) {
      if (segments_.size() == kMaxOutlineSegments) return;
      segments_.push_back({begin->cast<float>(), end->cast<float>(), edge_->kind});
    } else if (halvings > 0 && (begin || end || between)) {
      AddPart(from, begin, middle, between, halvings - 1);
      AddPart(middle, between, to, end, halvings - 1);
    }
  }

  bool IsStraight(double from, const Eigen::Vector2d& begin, const Eigen::Vector2d& between, const Eigen::Vector2d& end,
                  double to) const {
    const std::optional<Eigen::Vector2d> quarter = PixelAt(0.75 * from + 0.25 * to);
    return quarter && DistanceFromChord(begin, end, between) <= kMaxBendPx &&
           DistanceFromChord(begin, end, *quarter) <= kMaxBendPx;
  }

  static double DistanceFromChord(const Eigen::Vector2d& begin, const Eigen::Vector2d& end, const Eigen::Vector2d& at) {
    const Eigen::Vector2d chord = end - begin, from_begin = at - begin;
    const double length_px = chord.norm();
    if (!(length_px > 0.0)) return from_begin.norm();
    return std::abs(chord.x() * from_begin.y() - chord.y() * from_begin.x()) / length_px;
  }

  const CameraModel& camera_;
  const RigidTransform& camera_from_object_;
  const ObjectOutline::Edge* edge_ = nullptr;
  std::vector<OutlineSegment> segments_;
};

}  // namespace

void ObjectOutline::SetEdges(absl::Span<const TrackedLine> lines) {
  edges.clear();
  for (const TrackedLine& line : lines) edges.push_back({line.p1, line.p2, line.sagitta, line.kind});
}

std::vector<OutlineSegment> ProjectOutline(const CameraModel& camera, const ObjectOutline& outline) {
  OutlineProjection projection(camera, outline.camera_from_object);
  for (const ObjectOutline::Edge& edge : outline.edges) projection.Add(edge);
  return projection.Take();
}

}  // namespace evpose
