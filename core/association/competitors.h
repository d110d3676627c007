// SPDX-License-Identifier: Apache-2.0

// The other objects of a stream in one window: their lines compete for its events (an event belongs to an object by its
// responsibility, as it does to a line, core/association/README.md, section 2), and their faces hide what lies behind
// them.
#pragma once

#include <memory>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/geometry/camera.h"
#include "core/geometry/motion_prior.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

// A sphere about an object, object frame, metres. Its centre, the mean of the lines' ends, stays where it is under the
// object's symmetries.
struct BoundingSphere {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double radius_m = 0.0;
};
BoundingSphere BoundingSphereOf(const ObjectModel& model);

// Whether the images of two spheres, given in the camera frame, come within `margin_px` of each other. May say so of
// spheres that do not, never the other way.
bool MayOverlap(const CameraModel& camera, const BoundingSphere& a, const BoundingSphere& b, double margin_px);

// How many events per second a line makes, relative to others: the speed across itself at its middle, px/s, as far as
// it is known, sqrt(mean^2 + variance). The contrast is left out: of the other object's nothing is known here.
double RelativeEventRate(const CameraModel& camera, const MotionState& state, const ImageLine& line);

// The share of an event at this distance from its object's line that is the object's own; the rest is its competitors',
// whose density `competing` is Observation::competing.
double OwnShare(double distance_px, double competing);

class Competitors {
 public:
  explicit Competitors(const CameraModel& camera);

  void Clear();
  // An object with its visible lines, at mid-window; `sigma_px` is the spread of events about a line. `visibility` must
  // live until the next Clear.
  void Add(const MotionState& state, absl::Span<const TrackedLine> lines, const VisibilityTester& visibility,
           const BoundingSphere& sphere, double sigma_px);
  // After the last Add.
  void Build();

  bool empty() const { return bodies_.empty(); }
  // Sum over the lines near the event of RelativeEventRate times the density across the line, events / (s px^2) but for
  // the contrast.
  double DensityAt(const Observation& event) const;
  // Whether a line of theirs is so near that the event is most likely theirs, if only they and clutter are asked.
  bool Explain(const Observation& event) const;
  // Replaces the lines, of an object at this pose, by the parts of them that no competitor hides; whether one does.
  bool RemoveHidden(const RigidTransform& camera_from_object, std::vector<TrackedLine>& lines) const;

 private:
  struct Body {
    const VisibilityTester* visibility;
    RigidTransform object_from_camera;
    BoundingSphere sphere;  // camera frame
  };
  bool IsHidden(const Eigen::Vector3d& point_camera, absl::Span<const Body* const> bodies) const;
  // Appends the visible parts of one line; whether something of it is hidden.
  bool AppendVisibleParts(const RigidTransform& camera_from_object, const TrackedLine& line,
                          absl::Span<const Body* const> bodies, std::vector<TrackedLine>& visible) const;

  const CameraModel camera_;
  TileGrid grid_;
  std::vector<Body> bodies_;
  std::vector<ImageLine> lines_;
  std::vector<double> rates_;   // of the lines
  std::vector<double> sigmas_;  // of the lines, px
  std::vector<ImageLine> added_;
};

}  // namespace evpose
