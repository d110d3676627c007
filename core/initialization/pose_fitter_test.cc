// SPDX-License-Identifier: Apache-2.0

// Compares the steps of PoseFitter with Ceres and automatic differentiation.
#include "core/initialization/pose_fitter.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/jet.h>
#include <ceres/problem.h>
#include <ceres/solver.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <string>

#include "core/experiments/first_pose/line_trial.h"
#include "core/initialization/pose_search.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr int kTrials = 25;
constexpr int kManySteps = 60;  // more than are needed for convergence

// Segments of a trial and their matches at the best pose of a search.
struct Matched {
  std::vector<SearchSegment> segments;
  std::vector<SegmentMatch> matches;
  RigidTransform pose;
};

class PoseFitterTest : public testing::TestWithParam<SimulatedObject> {
 protected:
  void SetUp() override {
    trials_ = LineTrialGenerator::Create({GetParam(), 0.8, 2, 1}).value();
    model_ = std::make_unique<SearchModel>(trials_->model());
    search_ = MakePoseSearch(std::make_shared<ObjectModel>(trials_->model()), trials_->camera()).value();
  }

  Matched MakeMatched(int seed) const {
    const LineTrial trial = trials_->Make(seed);
    Matched matched;
    matched.segments =
        MakeSearchSegments(trials_->camera(), trial.segments, options_.end_point_sigma_px, options_.max_segments);
    const auto hypotheses = search_->Search(trial.segments);
    if (hypotheses.empty()) return matched;
    matched.pose = hypotheses[0].camera_from_object;
    const PoseFitter fitter(*model_, trials_->camera(), matched.segments, options_);
    matched.matches = fitter.Match(fitter.VisibleParts(matched.pose), 1.0);
    return matched;
  }

  RigidTransform Disturbed(const RigidTransform& pose, Random& random) const {
    Vector6d xi;
    for (int i = 0; i < 3; ++i) xi[i] = 0.002 * pose.translation_m.norm() * random.Normal();
    for (int i = 3; i < 6; ++i) xi[i] = 0.004 * random.Normal();
    return Perturb(pose, xi);
  }

  const PoseSearchOptions options_{};
  const FitWeights weights_ = FitWeights::Make(options_, 1.0);
  std::unique_ptr<LineTrialGenerator> trials_;
  std::unique_ptr<SearchModel> model_;
  std::unique_ptr<PoseSearch> search_;
};

// Rotation by 2 atan(|v| / 2) about v, from the unit quaternion along (1, v / 2): equal to exp(v) to first order, and
// rational.
template <typename T>
Eigen::Quaternion<T> RationalRotation(const T* v) {
  return Eigen::Quaternion<T>(T(1.0), 0.5 * v[0], 0.5 * v[1], 0.5 * v[2]).normalized();
}

// The four residuals of a match as segment_fit.h defines their cost, in standard deviations: both ends across the line
// and both along it.
struct MatchResiduals {
  const CameraModel& camera;
  const RigidTransform& start;
  const SearchSegment& seen;
  const SegmentMatch& match;
  const FitWeights& weights;

  // `change` holds the translation and the rotation relative to the start; the unit of the translation is the distance
  // of the start from the camera.
  template <typename T>
  bool operator()(const T* change, T* residuals) const {
    using Vector2 = Eigen::Matrix<T, 2, 1>;
    using Vector3 = Eigen::Matrix<T, 3, 1>;
    const Eigen::Quaternion<T> turn = RationalRotation(change + 3);
    const Vector3 shift = start.translation_m.norm() * Eigen::Map<const Vector3>(change);
    std::array<Vector2, 2> ends;
    for (const int end : {0, 1}) {
      const Eigen::Vector3d turned = start.rotation * (end == 0 ? match.p1 : match.p2);
      const Vector3 x = turn * turned.cast<T>() + start.translation_m.cast<T>() + shift;
      if (!(x.z() > 0.0)) return false;
      ends[end] = Vector2(camera.fx_px * x.x() / x.z() + camera.cx_px, camera.fy_px * x.y() / x.z() + camera.cy_px);
    }
    const Vector2 extent = ends[1] - ends[0];
    const T length = extent.norm();
    if (!(length > 0.0)) return false;
    for (const int end : {0, 1}) {
      const double side = end == 0 ? -1.0 : 1.0;
      const Eigen::Vector2d seen_end = seen.middle_px + side * seen.half_px * seen.along;
      const Vector2 way = seen_end.cast<T>() - ends[0];
      residuals[end] = std::sqrt(weights.across) * (extent.x() * way.y() - extent.y() * way.x()) / length;
      const Vector2 past = ends[end] - seen_end.cast<T>();
      const T u = std::sqrt(weights.along) * side * (seen.along.x() * past.x() + seen.along.y() * past.y());
      residuals[2 + end] = u < 0.0 ? u : u / sqrt(1.0 + u * u / weights.short_cost);
    }
    return true;
  }
};

ceres::Solver::Options SolverOptions() {
  ceres::Solver::Options options;
  options.trust_region_strategy_type = ceres::DOGLEG;
  options.linear_solver_type = ceres::DENSE_QR;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = kManySteps;
  options.function_tolerance = 1e-16;  // about the square of the pose error
  options.gradient_tolerance = 0.0;
  options.parameter_tolerance = 0.0;
  return options;
}

// Minimises the cost of the matches from `pose`.
bool RefineWithCeres(const CameraModel& camera, absl::Span<const SearchSegment> lines,
                     absl::Span<const SegmentMatch> matches, const FitWeights& weights, RigidTransform& pose) {
  ceres::Problem::Options problem_options;
  problem_options.disable_all_safety_checks = true;
  ceres::Problem problem(problem_options);
  std::array<double, 6> change = {};
  for (const SegmentMatch& match : matches) {
    using Cost = ceres::AutoDiffCostFunction<MatchResiduals, 4, 6>;
    problem.AddResidualBlock(new Cost(new MatchResiduals{camera, pose, lines[match.segment], match, weights}), nullptr,
                             change.data());
  }
  ceres::Solver::Summary summary;
  ceres::Solve(SolverOptions(), &problem, &summary);
  if (!summary.IsSolutionUsable()) return false;
  const Eigen::Vector3d shift = pose.translation_m.norm() * Eigen::Vector3d(change[0], change[1], change[2]);
  pose = {(RationalRotation(&change[3]) * Eigen::Quaterniond(pose.rotation)).normalized().toRotationMatrix(),
          pose.translation_m + shift};
  return true;
}

double RelativeDifference(const RigidTransform& a, const RigidTransform& b) {
  return std::max(RotationAngle(a.rotation, b.rotation),
                  (a.translation_m - b.translation_m).norm() / b.translation_m.norm());
}

TEST_P(PoseFitterTest, StepsConvergeToTheResultOfCeres) {
  Random random(1);
  int num_compared = 0;
  for (int seed = 0; seed < kTrials; ++seed) {
    const Matched matched = MakeMatched(seed);
    if (matched.matches.size() < 4) continue;
    const PoseFitter fitter(*model_, trials_->camera(), matched.segments, options_);
    const RigidTransform start = Disturbed(matched.pose, random);
    RigidTransform own = start, reference = start;
    ASSERT_TRUE(fitter.Refine(matched.matches, 1.0, kManySteps, own)) << seed;
    ASSERT_TRUE(RefineWithCeres(trials_->camera(), matched.segments, matched.matches, weights_, reference)) << seed;
    EXPECT_GT(RelativeDifference(start, reference), 1e-4) << seed;
    EXPECT_LT(RelativeDifference(own, reference), 1e-8) << seed;
    ++num_compared;
  }
  EXPECT_GE(num_compared, kTrials - 3);
}

// The pose that a search returns lies at the minimum. The visible parts are those at the start of the refinement; the
// ends of the lines at the refined pose may move the minimum by a small share of its standard deviation.
TEST_P(PoseFitterTest, TheBestPoseIsAMinimum) {
  int num_near = 0;
  for (int seed = 0; seed < kTrials; ++seed) {
    const Matched matched = MakeMatched(seed);
    if (matched.matches.size() < 4) continue;
    const PoseFitter fitter(*model_, trials_->camera(), matched.segments, options_);
    RigidTransform minimum = matched.pose;
    PoseFitter::NormalEquations normal;
    ASSERT_TRUE(fitter.Refine(matched.matches, 1.0, kManySteps, minimum)) << seed;
    ASSERT_TRUE(fitter.Accumulate(matched.matches, weights_, minimum, normal)) << seed;
    const Vector6d off = Difference(matched.pose, minimum);
    num_near += off.dot(normal.h * off) < 0.1 * 0.1;
  }
  EXPECT_GE(num_near, kTrials * 9 / 10);
}

using Jet = ceres::Jet<double, 6>;
using Vector2J = Eigen::Matrix<Jet, 2, 1>;
using Vector3J = Eigen::Matrix<Jet, 3, 1>;

Vector2J Projected(const CameraModel& camera, const RigidTransform& pose, const Eigen::Vector3d& point) {
  const Eigen::Vector3d turned = pose.rotation * point;
  Vector3J x = (turned + pose.translation_m).cast<Jet>(), shift, turn;
  for (int i = 0; i < 3; ++i) {
    shift[i] = Jet(0.0, i);
    turn[i] = Jet(0.0, 3 + i);
  }
  x += shift + turn.cross(turned.cast<Jet>());
  return {camera.fx_px * x.x() / x.z() + camera.cx_px, camera.fy_px * x.y() / x.z() + camera.cy_px};
}

// The cost as segment_fit.h defines it, its gradient, and the weighted squares of the residuals' gradients.
struct Reference {
  Jet cost = Jet(0.0);
  Matrix6d h = Matrix6d::Zero();

  void Add(const Jet& residual, const Jet& residual_cost) {
    // The weight w of w r^2 with the gradient of the cost: w = (d cost / d r) / 2 r, from the largest component.
    int axis = 0;
    residual.v.cwiseAbs().maxCoeff(&axis);
    cost += residual_cost;
    h += residual_cost.v[axis] / (2.0 * residual.a * residual.v[axis]) * residual.v * residual.v.transpose();
  }
};

Reference Differentiate(const CameraModel& camera, const Matched& matched, const FitWeights& weights,
                        const RigidTransform& pose) {
  Reference reference;
  for (const SegmentMatch& match : matched.matches) {
    const SearchSegment& seen = matched.segments[match.segment];
    const Vector2J p1 = Projected(camera, pose, match.p1), p2 = Projected(camera, pose, match.p2);
    const Vector2J along = (p2 - p1) / sqrt((p2 - p1).squaredNorm());
    for (const double side : {-1.0, 1.0}) {
      const Vector2J seen_end = (seen.middle_px + side * seen.half_px * seen.along).cast<Jet>();
      const Vector2J way = seen_end - p1;
      const Jet across = along.x() * way.y() - along.y() * way.x();
      reference.Add(across, weights.across * across * across);
      const Jet inside = side * ((side < 0.0 ? p1 : p2) - seen_end).dot(seen.along.cast<Jet>());
      const Jet u2 = weights.along * inside * inside;
      reference.Add(inside, inside.a < 0.0 ? u2 : u2 * weights.short_cost / (weights.short_cost + u2));
    }
  }
  return reference;
}

TEST_P(PoseFitterTest, NormalEquationsAreThoseOfAutomaticDifferentiation) {
  Random random(2);
  int num_compared = 0;
  for (int seed = 0; seed < kTrials; ++seed) {
    const Matched matched = MakeMatched(seed);
    if (matched.matches.empty()) continue;
    const PoseFitter fitter(*model_, trials_->camera(), matched.segments, options_);
    const RigidTransform pose = Disturbed(matched.pose, random);
    PoseFitter::NormalEquations normal;
    ASSERT_TRUE(fitter.Accumulate(matched.matches, weights_, pose, normal)) << seed;
    const Reference reference = Differentiate(trials_->camera(), matched, weights_, pose);
    EXPECT_NEAR(normal.cost, reference.cost.a, 1e-9 * normal.cost) << seed;
    // The unit of each component of the pose is its standard deviation.
    const Vector6d scale = normal.h.diagonal().cwiseSqrt().cwiseInverse();
    const Vector6d gradient = scale.cwiseProduct(normal.g - 0.5 * reference.cost.v);
    EXPECT_LT(gradient.norm(), 1e-8 * (1.0 + scale.cwiseProduct(normal.g).norm())) << seed;
    EXPECT_LT((scale.asDiagonal() * (normal.h - reference.h) * scale.asDiagonal()).norm(), 1e-8) << seed;
    ++num_compared;
  }
  EXPECT_GE(num_compared, kTrials - 3);
}

TEST_P(PoseFitterTest, ALineBehindTheCameraIsRejected) {
  Matched matched = MakeMatched(0);
  ASSERT_FALSE(matched.matches.empty());
  const PoseFitter fitter(*model_, trials_->camera(), matched.segments, options_);
  matched.matches.front().p2 = matched.pose.Inverse() * Eigen::Vector3d(0.1, 0.0, -1.0);
  RigidTransform pose = matched.pose;
  EXPECT_FALSE(fitter.Refine(matched.matches, 1.0, kManySteps, pose));
  EXPECT_EQ(pose.translation_m, matched.pose.translation_m);
}

INSTANTIATE_TEST_SUITE_P(Objects, PoseFitterTest,
                         testing::Values(SimulatedObject::kPlanar, SimulatedObject::kCube, SimulatedObject::kBook,
                                         SimulatedObject::kSpacecraft, SimulatedObject::kCuboid),
                         [](const auto& tested) { return std::string(SimulatedObjectName(tested.param)); });

}  // namespace
}  // namespace evpose
