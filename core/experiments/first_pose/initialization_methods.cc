// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/initialization_methods.h"

#include <utility>

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

constexpr int kAll = 1'000'000'000;  // more than InitializationBenchOptions::num_trials may be

// A method without precomputed data.
auto Direct(const InitializationFunction& estimate) {
  return
      [estimate](const ModelPointer&, const CameraModel&) { return absl::StatusOr<InitializationFunction>(estimate); };
}

absl::StatusOr<InitializationFunction> MakeOurs(const ModelPointer& model, const CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<const PoseSearch> search, MakePoseSearch(model, camera));
  return [search](const InitializationProblem& problem) -> absl::StatusOr<RigidTransform> {
    const std::vector<PoseHypothesis> hypotheses = search->Search(problem.segments);
    if (hypotheses.empty()) return absl::NotFoundError("the search found no pose");
    return hypotheses.front().camera_from_object;
  };
}

}  // namespace

const std::vector<InitializationMethod>& InitializationMethods() {
  static const auto* const methods = new std::vector<InitializationMethod>{
      {"sqpnp", "SQPnP of OpenCV, on true end points (for OPnP)", PriorKnowledge::kCorrespondences, kAll,
       Direct([](const InitializationProblem& p) { return EstimatePoseBySqpnp(p.camera, p.point_matches); })},
      {"aspnl", "ASPnL", PriorKnowledge::kCorrespondences, kAll,
       Direct([](const InitializationProblem& p) { return EstimatePoseByAspnl(p.camera, p.matches); })},
      {"ropnl", "RoPnL: branch and bound over rotations", PriorKnowledge::kCorrespondences, kAll,
       Direct([](const InitializationProblem& p) { return EstimatePoseByRopnl(p.camera, p.matches, {}); })},
      {"softposit", "SoftPOSIT for lines", PriorKnowledge::kPosePrior, 100, Direct([](const InitializationProblem& p) {
         return EstimatePoseBySoftPosit(p.model, p.camera, p.segments, p.prior, {}, p.seed);
       })},
      {"blind-pnp", "BlindPnP, for lines", PriorKnowledge::kPosePrior, 100, Direct([](const InitializationProblem& p) {
         return EstimatePoseByBlindPnp(p.model, p.camera, p.segments, p.prior, {}, p.seed);
       })},
      {"ransac", "RANSAC with a three-line solver", PriorKnowledge::kNothing, 100,
       Direct([](const InitializationProblem& p) {
         return EstimatePoseByRansac(p.model, p.camera, p.segments, {}, p.seed);
       })},
      {"published-bnb", "branch and bound over rotations (the paper's)", PriorKnowledge::kNothing, 100,
       Direct([](const InitializationProblem& p) {
         return EstimatePoseByPublishedBnb(p.model, p.camera, p.segments, {});
       })},
      {"evpose", "ours: sweeps, whole segments, visibility", PriorKnowledge::kNothing, kAll, MakeOurs},
  };
  return *methods;
}

}  // namespace evpose
