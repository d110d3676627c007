// SPDX-License-Identifier: Apache-2.0

// Methods for first poses, of this project and published ones, with a common interface.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/baselines/first_pose/pose_prior.h"
#include "core/baselines/first_pose/sqpnp.h"
#include "core/experiments/first_pose/line_trial.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Input of a method beside the segments.
enum class PriorKnowledge {
  kNothing,
  kPosePrior,        // a pose near the truth: PosePrior
  kCorrespondences,  // the line of each segment; spurious segments are removed
};

// Input of a method; all methods get the same segments.
struct InitializationProblem {
  const ObjectModel& model;
  const CameraModel& camera;  // without distortion
  absl::Span<const ImageSegment> segments;
  absl::Span<const LineMatch> matches;         // kCorrespondences
  absl::Span<const PointMatch> point_matches;  // kCorrespondences, for methods of points
  PosePrior prior;                             // kPosePrior
  uint64_t seed = 0;                           // for the random draws of the method
};

using InitializationFunction = std::function<absl::StatusOr<RigidTransform>(const InitializationProblem&)>;

struct InitializationMethod {
  std::string name;  // name on the command line
  std::string description;
  PriorKnowledge prior_knowledge = PriorKnowledge::kNothing;
  // Maximum number of trials of each scenario: some published methods take a second per trial.
  int max_trials = 0;
  // Makes the method for one object and camera; its precomputed data are shared by all trials.
  std::function<absl::StatusOr<InitializationFunction>(std::shared_ptr<const ObjectModel>, const CameraModel&)> make;
};

// Returns the methods in the order of the tables: with correspondences, with a prior, without either; that of this
// project is last.
const std::vector<InitializationMethod>& InitializationMethods();

}  // namespace evpose
