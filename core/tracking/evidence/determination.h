// SPDX-License-Identifier: Apache-2.0

// Tests whether the supported curves determine every motion of an object (core/tracking/README.md, section 1).
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/association/other_objects.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/tracking/evidence/health.h"

namespace evpose {

class Determination {
 public:
  // `camera`, `model` and `options` must outlive it. `sphere`: that of the model.
  Determination(const CameraModel& camera, const ObjectModel& model, BoundingSphere sphere,
                const HealthOptions& options)
      : camera_(camera), model_(model), sphere_(sphere), options_(options) {}

  // Sums the information of the curves at a pose. `lines` are the images of `tracked`, in the same order, and `results`
  // those of TrackHealth::curve_results().
  void Sum(const RigidTransform& camera_from_object, absl::Span<const TrackedLine> tracked,
           absl::Span<const ImageLine> lines, absl::Span<const CurveResult> results);
  // Whether the supported curves determine every motion within max_uncertainty_px.
  bool IsKept() const;
  // Whether they do so without any single one of them, because another edge nearby can support one curve of a wrong
  // pose. They must also have this share of the information that all curves should give, by their expected events; with
  // a smaller share, they must do so within sure_uncertainty_px. Of curves that have no decision of their own, only
  // those with less than half of their expected events reduce that share.
  bool IsConfirmed(double support_ratio) const;

 private:
  bool IsDeterminedWithoutAny(double max_uncertainty_px) const;

  const CameraModel& camera_;
  const ObjectModel& model_;
  const BoundingSphere sphere_;
  const HealthOptions& options_;
  Eigen::Matrix3Xd free_rotations_;
  Matrix6d information_ = Matrix6d::Zero();  // information of the events observed on the supported share of the curves
  Matrix6d supported_ = Matrix6d::Zero();    // information of the events expected on that share
  Matrix6d expected_ = Matrix6d::Zero();     // information of the events expected on all curves
  std::vector<Matrix6d> of_curves_;          // the parts of information_
};

}  // namespace evpose
