// SPDX-License-Identifier: Apache-2.0

// The methods that find a first pose, ours and the published ones, behind one call.
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

// What a method is told beside the segments.
enum class PriorKnowledge {
  kNothing,
  kPosePrior,        // a pose near the truth: PosePrior
  kCorrespondences,  // which segment is which line; spurious segments are left out
};

// One problem: all methods get the same segments.
struct InitializationProblem {
  absl::Span<const ImageSegment> segments;
  absl::Span<const LineMatch> matches;         // kCorrespondences
  absl::Span<const PointMatch> point_matches;  // kCorrespondences, for methods of points
  PosePrior prior;                             // kPosePrior
  uint64_t seed = 0;                           // of the method's own draws
};

using InitializationFunction = std::function<absl::StatusOr<RigidTransform>(const InitializationProblem&)>;

struct InitializationMethod {
  std::string name;  // as on the command line
  std::string description;
  PriorKnowledge told = PriorKnowledge::kNothing;
  // Trials of each scenario, at most: some published methods take a second for each.
  int max_trials = 0;
  // For one object and camera; what it keeps is shared by the trials.
  std::function<absl::StatusOr<InitializationFunction>(std::shared_ptr<const ObjectModel>, const CameraModel&)> make;
};

// In the order of the tables: known correspondences, with a prior, without anything; ours last.
absl::Span<const InitializationMethod> InitializationMethods();
// INVALID_ARGUMENT listing the known names.
absl::StatusOr<const InitializationMethod*> FindInitializationMethod(const std::string& name);

}  // namespace evpose
