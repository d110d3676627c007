// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/initialization_methods.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/status_macros.h"
#include "core/baselines/first_pose/aspnl.h"
#include "core/baselines/first_pose/blind_pnp_lines.h"
#include "core/baselines/first_pose/published_bnb.h"
#include "core/baselines/first_pose/ransac_p3l.h"
#include "core/baselines/first_pose/ropnl.h"
#include "core/baselines/first_pose/softposit_lines.h"
#include "core/baselines/first_pose/sqpnp.h"
#include "core/initialization/pose_search.h"

namespace evpose {
namespace {

using ModelPointer = std::shared_ptr<const ObjectModel>;

constexpr int kAll = 1'000'000'000;

absl::StatusOr<InitializationFunction> MakeSqpnp(ModelPointer, const CameraModel& camera) {
  return [camera](const InitializationProblem& problem) { return EstimatePoseBySqpnp(camera, problem.point_matches); };
}

absl::StatusOr<InitializationFunction> MakeAspnl(ModelPointer, const CameraModel& camera) {
  return [camera](const InitializationProblem& problem) { return EstimatePoseByAspnl(camera, problem.matches); };
}

absl::StatusOr<InitializationFunction> MakeRopnl(ModelPointer, const CameraModel& camera) {
  return [camera](const InitializationProblem& problem) {
    return EstimatePoseByRopnl(camera, problem.matches, RotationBnbOptions());
  };
}

absl::StatusOr<InitializationFunction> MakeSoftPosit(ModelPointer model, const CameraModel& camera) {
  return [model, camera](const InitializationProblem& problem) {
    return EstimatePoseBySoftPosit(*model, camera, problem.segments, problem.prior, SoftPositOptions(), problem.seed);
  };
}

absl::StatusOr<InitializationFunction> MakeBlindPnp(ModelPointer model, const CameraModel& camera) {
  return [model, camera](const InitializationProblem& problem) {
    return EstimatePoseByBlindPnp(*model, camera, problem.segments, problem.prior, BlindPnpOptions(), problem.seed);
  };
}

absl::StatusOr<InitializationFunction> MakeRansac(ModelPointer model, const CameraModel& camera) {
  return [model, camera](const InitializationProblem& problem) {
    return EstimatePoseByRansac(*model, camera, problem.segments, RansacP3lOptions(), problem.seed);
  };
}

absl::StatusOr<InitializationFunction> MakePublishedBnb(ModelPointer model, const CameraModel& camera) {
  return [model, camera](const InitializationProblem& problem) {
    return EstimatePoseByPublishedBnb(*model, camera, problem.segments, PublishedBnbOptions());
  };
}

absl::StatusOr<InitializationFunction> MakeOurs(ModelPointer model, const CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<const PoseSearch> search, MakePoseSearch(model, camera));
  return [search](const InitializationProblem& problem) -> absl::StatusOr<RigidTransform> {
    const std::vector<PoseHypothesis> hypotheses = search->Search(problem.segments);
    if (hypotheses.empty()) return absl::NotFoundError("the search found no pose");
    return hypotheses.front().camera_from_object;
  };
}

const std::vector<InitializationMethod>& Methods() {
  static const auto* const methods = new std::vector<InitializationMethod>{
      {"sqpnp", "SQPnP of OpenCV, on true end points (for OPnP)", PriorKnowledge::kCorrespondences, kAll, MakeSqpnp},
      {"aspnl", "ASPnL", PriorKnowledge::kCorrespondences, kAll, MakeAspnl},
      {"ropnl", "RoPnL: branch and bound over rotations", PriorKnowledge::kCorrespondences, kAll, MakeRopnl},
      {"softposit", "SoftPOSIT for lines", PriorKnowledge::kPosePrior, 100, MakeSoftPosit},
      {"blind-pnp", "BlindPnP, for lines", PriorKnowledge::kPosePrior, 100, MakeBlindPnp},
      {"ransac", "RANSAC with a three-line solver", PriorKnowledge::kNothing, 100, MakeRansac},
      {"published-bnb", "branch and bound over rotations (the paper's)", PriorKnowledge::kNothing, 100,
       MakePublishedBnb},
      {"evpose", "ours: sweeps, whole segments, visibility", PriorKnowledge::kNothing, kAll, MakeOurs},
  };
  return *methods;
}

}  // namespace

absl::Span<const InitializationMethod> InitializationMethods() { return Methods(); }

absl::StatusOr<const InitializationMethod*> FindInitializationMethod(const std::string& name) {
  std::vector<std::string> names;
  for (const InitializationMethod& method : Methods()) {
    if (method.name == name) return &method;
    names.push_back(method.name);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("no method of initialisation is called \"", name, "\"; known are: ", absl::StrJoin(names, ", ")));
}

}  // namespace evpose
