// SPDX-License-Identifier: Apache-2.0

// The other tracked objects of a stream in one window. Their lines compete for the events: an event is shared between
// objects in proportion to the likelihoods, as it is between lines (core/association/README.md, section 2). Their faces
// hide lines behind them.
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/geometry/camera.h"
#include "core/geometry/motion_prior.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

// A sphere that contains an object, metres, in the object frame unless stated otherwise. Its centre is the mean of the
// straight lines' end points, or of the vertices of a model without such lines; it is invariant under the object's
// discrete symmetries.
struct BoundingSphere {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double radius_m = 0.0;
};
BoundingSphere BoundingSphereOf(const ObjectModel& model);

// Returns whether the images of two spheres (camera frame) may come within `margin_px` of each other. Conservative: the
// result is true whenever they do, and may be true when they do not.
bool MayOverlap(const CameraModel& camera, const BoundingSphere& a, const BoundingSphere& b, double margin_px);

// Returns the expected event rate of a line relative to other lines: the root mean square of the normal speed of its
// middle, sqrt(mean^2 + variance) in px/s, under the covariance of the twist. The contrast is not included, because it
// is unknown for the other objects.
double RelativeEventRate(const CameraModel& camera, const MotionState& state, const ImageLine& line);

// Returns the probability in [0, 1] that an event at this distance from a line of the object was produced by the object
// and not by another one. `others_per_px` is Observation::others_per_px, 1/px.
double OwnShare(double distance_px, double others_per_px);

class OtherObjects {
 public:
  explicit OtherObjects(const CameraModel& camera);

  // Removes all objects.
  void Clear();
  // Adds an object with its state at the middle of the window and its visible lines. `sigma_px` is the standard
  // deviation of events about a line. `visibility` must remain valid until the next Clear().
  void Add(const MotionState& state, absl::Span<const TrackedLine> lines, const VisibilityTester& visibility,
           const BoundingSphere& sphere, double sigma_px);
  // Builds the grid of lines. To be called after the last Add() and before DensityAt() or Explains().
  void Build();

  bool empty() const { return bodies_.empty(); }
  // Returns the density of the other objects' events at this event: the sum over their lines of RelativeEventRate()
  // times the normal density across the line, events / (s px^2) up to the factor of the contrast.
  double DensityAt(const Observation& event) const;
  // Returns whether the event lies so near to a line of another object that this line is a more likely cause than
  // clutter.
  bool Explains(const Observation& event) const;
  // Replaces the lines of an object at this pose by the parts that no other object hides; an element stays as a whole
  // or is removed. Returns whether any part is hidden.
  bool RemoveHidden(const RigidTransform& camera_from_object, std::vector<TrackedLine>& lines) const;

 private:
  struct Body {
    const VisibilityTester* visibility;
    RigidTransform object_from_camera;
    BoundingSphere sphere;  // camera frame
  };
  static bool IsHidden(const Eigen::Vector3d& point_camera, absl::Span<const Body* const> bodies);
  // Appends the parts of one straight line that `bodies` do not hide. Returns whether any part is hidden.
  bool AppendVisibleParts(const RigidTransform& camera_from_object, const TrackedLine& line,
                          absl::Span<const Body* const> bodies, std::vector<TrackedLine>& visible) const;

  const CameraModel camera_;
  TileGrid grid_;
  std::vector<Body> bodies_;
  std::vector<ImageLine> lines_;
  std::vector<double> rates_;     // RelativeEventRate() of each line
  std::vector<double> sigmas_;    // standard deviation of the events of each line, px
  std::vector<ImageLine> added_;  // temporary of Add()
};

}  // namespace evpose
