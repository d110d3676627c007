// SPDX-License-Identifier: Apache-2.0

// The description of an object to be tracked.
#pragma once

#include <memory>
#include <optional>

#include "absl/status/status.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

class ModelEdges;
class SearchModel;
class TemplateModel;

// An object to be tracked.
struct ObjectToTrack {
  std::shared_ptr<const ObjectModel> model;  // shared by all sessions and objects with the same model
  // The pose at the first event; without one, a search finds it from the events.
  std::optional<RigidTransform> initial_camera_from_object;
  // camera_from_object. Among the equivalent poses of a symmetric object, the one nearest to this rotation is reported.
  Eigen::Matrix3d reference_rotation = Eigen::Matrix3d::Identity();
  // The tables below depend on the model alone; those that are null are computed when they are needed.
  std::shared_ptr<const SearchModel> search_model;      // for the search by lines
  std::shared_ptr<const TemplateModel> template_model;  // views of a model with curved edges
  std::shared_ptr<const ModelEdges> edges;              // made with TrackerOptions::visibility and elements

  // INVALID_ARGUMENT names the field or the defect of the model.
  absl::Status Validate() const;
  // The part of Validate() for `initial_camera_from_object`, whose error does not name it. `model` must be valid.
  absl::Status ValidateInitialPose() const;
};

}  // namespace evpose
