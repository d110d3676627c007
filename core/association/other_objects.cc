// SPDX-License-Identifier: Apache-2.0
#include "core/association/other_objects.h"

#include <algorithm>
#include <cmath>

#include "core/base/yield_point.h"
#include "core/numerics/math.h"
#include "core/numerics/robust.h"

namespace evpose {
namespace {

// Half width of the gate of a line, in standard deviations: a normal distribution has 6e-5 of its events outside.
constexpr double kReachSigma = 4.0;
// Pixels beyond a line's end within which events still belong to it, because the end points move within the window.
constexpr double kEndMarginPx = 2.0;
// Half the length, pixels, up to which an element is not cut where another object begins to hide it.
constexpr double kShortHalfPx = 24.0;
// Lower bound of a rate, px/s: events of a slower line cannot be distinguished from noise. It keeps ratios of rates
// finite.
constexpr double kMinRatePxPerS = 1.0;

double NormalDensity(double distance_px, double sigma_px) {
  const double u = distance_px / sigma_px;
  return MixtureDensity::kInverseSqrt2Pi / sigma_px * DeterministicExp(-0.5 * u * u);
}

}  // namespace

BoundingSphere BoundingSphereOf(const ObjectModel& model) {
  BoundingSphere sphere;
  for (const ModelLine& line : model.lines) sphere.centre += 0.5 * (line.p1 + line.p2);
  if (!model.lines.empty()) {
    sphere.centre /= static_cast<double>(model.lines.size());
  } else if (!model.vertices.empty()) {
    for (const Eigen::Vector3d& vertex : model.vertices) sphere.centre += vertex;
    sphere.centre /= static_cast<double>(model.vertices.size());
  }
  const auto enclose = [&](const Eigen::Vector3d& point) {
    sphere.radius_m = std::max(sphere.radius_m, (point - sphere.centre).norm());
  };
  for (const Eigen::Vector3d& vertex : model.vertices) enclose(vertex);
  for (const ModelLine& line : model.lines) {
    enclose(line.p1);
    enclose(line.p2);
  }
  return sphere;
}

bool MayOverlap(const CameraModel& camera, const BoundingSphere& a, const BoundingSphere& b, double margin_px) {
  const double focal_px = camera.MaxFocalPx();
  double reach_px = margin_px;
  for (const BoundingSphere* sphere : {&a, &b}) {
    const Eigen::Vector3d& c = sphere->centre;
    if (c.z() <= sphere->radius_m) return true;
    // Upper bound of the factor by which perspective stretches the image of a sphere away from the optical axis.
    const double stretch = 1.0 + (c.x() * c.x() + c.y() * c.y()) / (c.z() * c.z());
    reach_px += focal_px * sphere->radius_m / (c.z() - sphere->radius_m) * stretch;
  }
  const Eigen::Vector2d distance = a.centre.head<2>() / a.centre.z() - b.centre.head<2>() / b.centre.z();
  return distance.norm() * focal_px <= reach_px;
}

double RelativeEventRate(const CameraModel& camera, const MotionState& state, const ImageLine& line) {
  const Eigen::Vector3d middle = BearingOf(camera, line.PointAt(0.5));
  const Vector6d row = line.jacobian.transpose() * middle;
  const double speed = middle.dot(line.a_dot);
  const double variance = row.dot(state.covariance.bottomRightCorner<6, 6>() * row);
  return std::max(kMinRatePxPerS, std::sqrt(speed * speed + std::max(0.0, variance)));
}

double OwnShare(double distance_px, double others_per_px) {
  if (others_per_px <= 0.0) return 1.0;
  // Standard deviation of the events about a line, from the rounding of pixels and the several events of an edge.
  constexpr double kSigmaPx = 0.8;
  // Density of clutter relative to the line's events, 1/px: a fifth of the events, uniform over 12 px.
  constexpr double kClutterPerPx = 0.02;
  const double own = NormalDensity(distance_px, kSigmaPx) + kClutterPerPx;
  return own / (own + others_per_px);
}

OtherObjects::OtherObjects(const CameraModel& camera) : camera_(camera), grid_(camera) {}

void OtherObjects::Clear() {
  bodies_.clear();
  lines_.clear();
  rates_.clear();
  sigmas_.clear();
}

void OtherObjects::Add(const MotionState& state, absl::Span<const TrackedLine> lines,
                       const VisibilityTester& visibility, const BoundingSphere& sphere, double sigma_px) {
  const RigidTransform& pose = state.camera_from_object;
  bodies_.push_back({&visibility, pose.Inverse(), {pose * sphere.centre, sphere.radius_m}});
  ProjectLines(camera_, state, lines, added_);
  for (const ImageLine& line : added_) {
    if (!line.in_view()) continue;
    const Vector6d row = line.jacobian.transpose() * BearingOf(camera_, line.PointAt(0.5));
    const double variance = std::max(0.0, row.dot(state.covariance.topLeftCorner<6, 6>() * row));
    lines_.push_back(line);
    rates_.push_back(RelativeEventRate(camera_, state, line));
    sigmas_.push_back(std::sqrt(sigma_px * sigma_px + variance));
  }
}

void OtherObjects::Build() {
  // Limit of the distance, pixels, at which tiles list a line. The position of a line with a wider gate is too
  // uncertain to attribute events to it.
  constexpr double kMaxReachPx = 32.0;
  double reach_px = 0.0;
  for (const double sigma_px : sigmas_) reach_px = std::max(reach_px, kReachSigma * sigma_px);
  grid_.Build(lines_, std::min(reach_px, kMaxReachPx));
}

double OtherObjects::DensityAt(const Observation& event) const {
  const uint32_t tile = grid_.TileOf(event.u_px, event.v_px);
  if (tile == TileGrid::kNoTile) return 0.0;
  double density = 0.0;
  for (const uint16_t index : grid_.Lines(tile)) {
    const double reach_px = kReachSigma * sigmas_[index];
    const NearLines near = FindNearLines(event, {&index, 1}, lines_.data(), reach_px, kEndMarginPx);
    if (near.count == 0) continue;
    density += rates_[index] * NormalDensity(near.distance_px[0], sigmas_[index]);
  }
  return density;
}

bool OtherObjects::Explains(const Observation& event) const {
  // Distance, in standard deviations, at which the normal density of a line equals that of clutter: 0.02 / px for a
  // standard deviation of 0.8 px, as in OwnShare().
  constexpr double kOwnSigma = 2.5;
  const uint32_t tile = grid_.TileOf(event.u_px, event.v_px);
  if (tile == TileGrid::kNoTile) return false;
  for (const uint16_t index : grid_.Lines(tile)) {
    const double reach_px = kOwnSigma * sigmas_[index];
    if (FindNearLines(event, {&index, 1}, lines_.data(), reach_px, kEndMarginPx).count > 0) return true;
  }
  return false;
}

bool OtherObjects::RemoveHidden(const RigidTransform& camera_from_object, std::vector<TrackedLine>& lines) const {
  std::vector<TrackedLine> visible;
  std::vector<int> place_of(lines.size(), -1);  // index in `visible` of each element
  std::vector<const Body*> before;
  bool hides = false;
  for (size_t k = 0; k < lines.size(); ++k) {
    const TrackedLine& line = lines[k];
    YieldPoint();
    place_of[k] = static_cast<int>(visible.size());
    const Eigen::Vector3d p1 = camera_from_object * line.p1;
    const Eigen::Vector3d p2 = camera_from_object * line.p2;
    const BoundingSphere segment{0.5 * (p1 + p2), 0.5 * (p2 - p1).norm()};
    before.clear();
    for (const Body& body : bodies_) {
      const bool is_behind_all = body.sphere.centre.norm() - body.sphere.radius_m > std::max(p1.norm(), p2.norm());
      if (!is_behind_all && MayOverlap(camera_, segment, body.sphere, 0.0)) before.push_back(&body);
    }
    // The straight lines of a model with many are elements, too, but not all of them are short.
    const bool is_short =
        !line.sagitta.isZero(0.0) || segment.radius_m * camera_.MaxFocalPx() <= kShortHalfPx * segment.centre.z();
    if (before.empty()) {
      visible.push_back(line);
    } else if (line.is_element && is_short) {
      // It is visible or hidden as its middle.
      const bool is_hidden = IsHidden(camera_from_object * (0.5 * (line.p1 + line.p2)), before);
      hides |= is_hidden;
      if (is_hidden) place_of[k] = -1;
      if (!is_hidden) visible.push_back(line);
    } else {
      const bool is_cut = AppendVisibleParts(camera_from_object, line, before, visible);
      hides |= is_cut;
      if (is_cut) place_of[k] = -1;
    }
  }
  for (TrackedLine& line : visible) {
    if (line.previous >= 0) line.previous = place_of[line.previous];
    if (line.next >= 0) line.next = place_of[line.next];
  }
  lines.swap(visible);
  return hides;
}

bool OtherObjects::IsHidden(const Eigen::Vector3d& point_camera, absl::Span<const Body* const> bodies) {
  return std::any_of(bodies.begin(), bodies.end(), [&](const Body* body) {
    const Eigen::Vector3d eye = body->object_from_camera.translation_m;
    return !body->visibility->IsPointVisible(eye, body->object_from_camera * point_camera);
  });
}

bool OtherObjects::AppendVisibleParts(const RigidTransform& camera_from_object, const TrackedLine& line,
                                      absl::Span<const Body* const> bodies, std::vector<TrackedLine>& visible) const {
  // Distance of the tested points along the line, pixels. A visible or hidden part shorter than a step may be missed.
  constexpr double kStepPx = 12.0;
  constexpr int kMaxSteps = 32;   // bounds the number of ray casts per line
  constexpr int kBisections = 5;  // locate the end of a part to 1/32 of a step, below a pixel
  const std::optional<ProjectedLine> projected = ProjectLine(camera_, camera_from_object, line.p1, line.p2);
  if (!projected) return false;
  const double length_px = (projected->p2_px - projected->p1_px).norm();
  const int steps = static_cast<int>(std::clamp(length_px / kStepPx, 2.0, static_cast<double>(kMaxSteps)));
  const auto at = [&](double s) -> Eigen::Vector3d { return line.p1 + s * (line.p2 - line.p1); };
  const auto is_hidden = [&](double s) { return IsHidden(camera_from_object * at(s), bodies); };
  const auto boundary = [&](double seen, double hidden) {
    for (int i = 0; i < kBisections; ++i) {
      const double middle = 0.5 * (seen + hidden);
      (is_hidden(middle) ? hidden : seen) = middle;
    }
    return seen;
  };
  const auto append = [&](const Eigen::Vector3d& p1, const Eigen::Vector3d& p2) {
    TrackedLine& part = visible.emplace_back(line);
    part.p1 = p1;
    part.p2 = p2;
    part.previous = part.next = -1;
  };
  double begin = 0.0;
  bool was_hidden = true;
  bool hides = false;
  for (int i = 0; i <= steps; ++i) {
    const double s = static_cast<double>(i) / steps;
    const double previous = static_cast<double>(i - 1) / steps;
    const bool now_hidden = is_hidden(s);
    if (!now_hidden && was_hidden) begin = i == 0 ? 0.0 : boundary(s, previous);
    if (now_hidden && !was_hidden) append(at(begin), at(boundary(previous, s)));
    hides |= now_hidden;
    was_hidden = now_hidden;
  }
  if (!hides) {
    visible.push_back(line);
  } else if (!was_hidden) {
    append(at(begin), line.p2);
  }
  return hides;
}

}  // namespace evpose
