// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/estimators/line_fit.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "core/association/association.h"
#include "core/baselines/estimators/line_cost.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"
#include "core/numerics/robust.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using testing::MakeCamera;

constexpr int kNumLines = 12;

struct Trial {
  CameraModel camera = MakeCamera(640, 480, 800.0);
  std::vector<LineEnds> lines;
  std::vector<LabelledEvent> events;
  RigidTransform truth;
  RigidTransform start;
};

Eigen::Vector3d NormalVector(Random& random) { return {random.Normal(), random.Normal(), random.Normal()}; }

// Lines in the image at a depth of 5 to 10 m; each event lies on its line with a normal error, or has a wrong label.
Trial MakeTrial(uint64_t seed, double sigma_px, double outlier_ratio, int events_per_line = 60) {
  Random random(seed);
  Trial trial;
  trial.camera.fy_px = 790.0;
  trial.truth = {ExpSo3(NormalVector(random)), Eigen::Vector3d(0.1, -0.2, 7.5)};
  const RigidTransform object_from_camera = trial.truth.Inverse();
  for (int k = 0; k < kNumLines; ++k) {
    Eigen::Vector3d ends[2];
    for (Eigen::Vector3d& end : ends) {
      const Eigen::Vector2d pixel(random.Uniform(0.0, 640.0), random.Uniform(0.0, 480.0));
      end = random.Uniform(5.0, 10.0) * BearingOf(trial.camera, pixel);
    }
    trial.lines.push_back({object_from_camera * ends[0], object_from_camera * ends[1]});
    const Eigen::Vector2d p1 = trial.camera.Project(ends[0]);
    const Eigen::Vector2d extent = trial.camera.Project(ends[1]) - p1;
    const Eigen::Vector2d normal = Eigen::Vector2d(-extent.y(), extent.x()).normalized();
    for (int i = 0; i < events_per_line; ++i) {
      const Eigen::Vector2d pixel = p1 + random.Uniform() * extent + sigma_px * random.Normal() * normal;
      const Eigen::Vector3d bearing = BearingOf(trial.camera, pixel);
      const int other = (k + 1 + static_cast<int>(random.UniformInt(kNumLines - 1))) % kNumLines;
      trial.events.push_back({bearing.x(), bearing.y(), random.Uniform() < outlier_ratio ? other : k});
    }
  }
  Vector6d off;
  off << 0.03 * NormalVector(random), 0.005 * NormalVector(random);
  trial.start = Perturb(trial.truth, off);
  return trial;
}

LineFitOptions With(LineFitMethod method, LineFitFormulas formulas = LineFitFormulas::kCorrected) {
  LineFitOptions options;
  options.method = method;
  options.formulas = formulas;
  return options;
}

LineFit FitOrDie(const Trial& trial, const LineFitOptions& options) {
  const absl::StatusOr<LineFit> fit = FitPoseToLines(trial.camera, trial.lines, trial.events, trial.start, options);
  EXPECT_TRUE(fit.ok()) << fit.status();
  return fit.ok() ? *fit : LineFit();
}

std::vector<double> Distances(const Trial& trial, const RigidTransform& pose) {
  std::vector<double> distances;
  for (const LabelledEvent& event : trial.events) {
    const LineEnds& ends = trial.lines[event.line];
    const ProjectedLine line = *ProjectLine(trial.camera, pose, ends.p1, ends.p2);
    distances.push_back(line.a.dot(Eigen::Vector3d(event.bx, event.by, 1.0)));
  }
  return distances;
}

double Median(std::vector<double> values) { return UpperMedian(values); }

// One weighted distance with the full exponential map, for automatic differentiation.
struct EventDistance {
  const CameraModel& camera;
  const LineEnds& ends;
  const RigidTransform& origin;
  LabelledEvent event;
  double root_weight;

  template <typename T>
  bool operator()(const T* xi, T* residual) const {
    using Vector3 = Eigen::Matrix<T, 3, 1>;
    const Vector3 turn(xi[3], xi[4], xi[5]);
    const T angle2 = turn.squaredNorm();
    // Formula of Rodrigues; near zero, where derivatives are computed, its series to fourth order.
    T sinc = 1.0 - angle2 / 6.0 + angle2 * angle2 / 120.0, versine = 0.5 - angle2 / 24.0 + angle2 * angle2 / 720.0;
    if (angle2 > 1e-4) {
      const T angle = sqrt(angle2);
      sinc = sin(angle) / angle;
      versine = (1.0 - cos(angle)) / angle2;
    }
    const auto moved = [&](const Eigen::Vector3d& p) -> Vector3 {
      const Vector3 x = (origin.rotation * p).cast<T>();
      const Vector3 cross = turn.cross(x);
      return x + sinc * cross + versine * turn.cross(cross) + origin.translation_m.cast<T>() +
             Vector3(xi[0], xi[1], xi[2]);
    };
    const Vector3 n = moved(ends.p1).cross(moved(ends.p2));
    const T nx = n.x() / camera.fx_px, ny = n.y() / camera.fy_px;
    residual[0] = root_weight * (n.x() * event.bx + n.y() * event.by + n.z()) / sqrt(nx * nx + ny * ny);
    return true;
  }
};

using EventCost = ceres::AutoDiffCostFunction<EventDistance, 1, 6>;

std::vector<LineMoment> Moments(const Trial& trial, const std::vector<double>& weights) {
  std::vector<LineMoment> moments(trial.lines.size(), LineMoment::Zero());
  for (size_t i = 0; i < trial.events.size(); ++i) {
    const Eigen::Vector3d b(trial.events[i].bx, trial.events[i].by, 1.0);
    moments[trial.events[i].line] += weights[i] * b * b.transpose();
  }
  return moments;
}

TEST(LineCost, CostAndGradientEqualAutomaticDifferentiationEventByEvent) {
  const Trial trial = MakeTrial(1, 2.0, 0.1);
  std::vector<double> weights;
  Random random(2);
  for (size_t i = 0; i < trial.events.size(); ++i) weights.push_back(random.Uniform());
  const std::vector<LineMoment> moments = Moments(trial, weights);
  const LineCost cost(trial.camera, trial.lines, moments, trial.start);
  // Away from the origin, so that the Jacobian of the rotation parameter matters.
  for (const Vector6d& xi : {Vector6d(Vector6d::Zero()), Vector6d(0.1 * Vector6d::LinSpaced(-1.0, 1.5))}) {
    const double* parameters[] = {xi.data()};
    std::vector<double> residuals(cost.num_residuals()), rows(6 * residuals.size());
    double* jacobians[] = {rows.data()};
    ASSERT_TRUE(cost.Evaluate(parameters, residuals.data(), jacobians));
    const Eigen::Map<Eigen::VectorXd> r(residuals.data(), static_cast<Eigen::Index>(residuals.size()));
    const Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>> j(rows.data(), r.size(), 6);

    double expected_cost = 0.0;
    Vector6d expected_gradient = Vector6d::Zero();
    Matrix6d expected_hessian = Matrix6d::Zero();
    for (size_t i = 0; i < trial.events.size(); ++i) {
      const EventCost event_cost(new EventDistance{trial.camera, trial.lines[trial.events[i].line], trial.start,
                                                   trial.events[i], std::sqrt(weights[i])});
      double residual = 0.0;
      Vector6d row;
      double* row_pointer[] = {row.data()};
      ASSERT_TRUE(event_cost.Evaluate(parameters, &residual, row_pointer));
      expected_cost += 0.5 * residual * residual;
      expected_gradient += residual * row;
      expected_hessian += row * row.transpose();
    }
    EXPECT_NEAR(0.5 * r.squaredNorm() / expected_cost, 1.0, 1e-9);
    EXPECT_LT((j.transpose() * r - expected_gradient).norm(), 1e-8 * expected_gradient.norm());
    EXPECT_LT((j.transpose() * j - expected_hessian).norm(), 1e-8 * expected_hessian.norm());
  }
}

TEST(LineCost, MinimumEqualsCeresOverAllEvents) {
  for (const uint64_t seed : {1, 2, 3}) {
    const Trial trial = MakeTrial(seed, 2.0, 0.0);
    std::vector<double> weights;
    Random random(seed + 10);
    for (size_t i = 0; i < trial.events.size(); ++i) weights.push_back(random.Uniform());
    const std::vector<LineMoment> moments = Moments(trial, weights);
    const auto pose = MinimiseLineCost(trial.camera, trial.lines, moments, trial.start, LineSolverOptions());
    ASSERT_TRUE(pose.ok()) << pose.status();

    Vector6d xi = Vector6d::Zero();
    ceres::Problem problem;
    for (size_t i = 0; i < trial.events.size(); ++i) {
      problem.AddResidualBlock(new EventCost(new EventDistance{trial.camera, trial.lines[trial.events[i].line],
                                                               trial.start, trial.events[i], std::sqrt(weights[i])}),
                               nullptr, xi.data());
    }
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.trust_region_strategy_type = ceres::DOGLEG;
    options.function_tolerance = 1e-18;
    options.gradient_tolerance = 0.0;
    options.parameter_tolerance = 0.0;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    EXPECT_LT(Difference(*pose, Perturb(trial.start, xi)).cwiseAbs().maxCoeff(), 1e-8) << "seed " << seed;

    // Covariance: the inverse of J^T J at the minimum.
    ceres::Problem::EvaluateOptions all;
    ceres::CRSMatrix sparse;
    problem.Evaluate(all, nullptr, nullptr, nullptr, &sparse);
    const Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>> j(sparse.values.data(), sparse.num_rows,
                                                                                  6);
    // Converts the rotation parameter to the left perturbation.
    Matrix6d left_from_parameters = Matrix6d::Identity();
    left_from_parameters.bottomRightCorner<3, 3>() = LeftJacobianSo3(xi.tail<3>());
    const Matrix6d expected = left_from_parameters * (j.transpose() * j).inverse() * left_from_parameters.transpose();
    std::vector<std::optional<ProjectedLine>> projected;
    for (const LineEnds& line : trial.lines) {
      projected.push_back(ProjectLine(trial.camera, *pose, line.p1, line.p2));
    }
    const auto covariance = InvertPoseHessian(LineCostHessian(projected, moments));
    ASSERT_TRUE(covariance.ok()) << covariance.status();
    EXPECT_LT((*covariance - expected).norm(), 1e-8 * expected.norm()) << "seed " << seed;
  }
}

class LineFitMethods : public ::testing::TestWithParam<LineFitMethod> {};
INSTANTIATE_TEST_SUITE_P(All, LineFitMethods,
                         ::testing::Values(LineFitMethod::kLeastSquares, LineFitMethod::kTukeyM, LineFitMethod::kTukeyS,
                                           LineFitMethod::kTukeyMm, LineFitMethod::kMixture,
                                           LineFitMethod::kErrorStateFilter));

TEST_P(LineFitMethods, IsExactWithoutNoise) {
  const LineFit fit = FitOrDie(MakeTrial(4, 0.0, 0.0), With(GetParam()));
  // The filter retains a share of its prior and a linearisation error.
  const double tolerance = GetParam() == LineFitMethod::kErrorStateFilter ? 2e-3 : 1e-9;
  EXPECT_LT(Difference(fit.camera_from_object, MakeTrial(4, 0.0, 0.0).truth).norm(), tolerance);
}

TEST_P(LineFitMethods, IsDeterministic) {
  const Trial trial = MakeTrial(5, 2.0, 0.1);
  const LineFit first = FitOrDie(trial, With(GetParam()));
  const LineFit second = FitOrDie(trial, With(GetParam()));
  EXPECT_EQ(first.camera_from_object.rotation, second.camera_from_object.rotation);
  EXPECT_EQ(first.camera_from_object.translation_m, second.camera_from_object.translation_m);
  EXPECT_EQ(first.covariance, second.covariance);
  EXPECT_EQ(first.weights, second.weights);
  EXPECT_EQ(first.sigma_px, second.sigma_px);
}

TEST_P(LineFitMethods, ErrorsAreConsistentWithTheCovariance) {
  // 150 trials of e^T P^-1 e, chi-square with 6 degrees of freedom: the mean within 4 standard deviations.
  constexpr int kTrials = 150;
  // The covariance of these two does not include the events that they fail to reject.
  const bool is_robust = GetParam() != LineFitMethod::kLeastSquares && GetParam() != LineFitMethod::kErrorStateFilter;
  const double outlier_ratio = is_robust ? 0.05 : 0.0;
  double sum = 0.0;
  for (int k = 0; k < kTrials; ++k) {
    const Trial trial = MakeTrial(1000 + k, 2.0, outlier_ratio);
    LineFitOptions options = With(GetParam());
    options.filter_sigma_px = 2.0;
    const LineFit fit = FitOrDie(trial, options);
    const Vector6d error = Difference(fit.camera_from_object, trial.truth);
    sum += error.dot(fit.covariance.ldlt().solve(error));
  }
  // The formula is asymptotic, and S effectively uses a third of its 720 events.
  const double slack = GetParam() == LineFitMethod::kTukeyS ? 1.0 : 0.0;
  EXPECT_GT(sum / kTrials, 6.0 - 4.0 * std::sqrt(12.0 / kTrials));
  EXPECT_LT(sum / kTrials, 6.0 + 4.0 * std::sqrt(12.0 / kTrials) + slack);
}

TEST_P(LineFitMethods, WrongLabelsAffectLeastSquaresOnly) {
  std::vector<double> errors;
  for (int k = 0; k < 20; ++k) {
    const Trial trial = MakeTrial(2000 + k, 1.0, 0.2);
    errors.push_back(Difference(FitOrDie(trial, With(GetParam())).camera_from_object, trial.truth).tail<3>().norm());
  }
  if (GetParam() == LineFitMethod::kLeastSquares) {
    EXPECT_GT(Median(errors), 0.02);
  } else {
    EXPECT_LT(Median(errors), 0.002);
  }
}

TEST_P(LineFitMethods, ErrorsNameTheArgument) {
  const Trial trial = MakeTrial(6, 1.0, 0.0);
  const LineFitOptions options = With(GetParam());
  const auto error = [&](const Trial& t) {
    return FitPoseToLines(t.camera, t.lines, t.events, t.start, options).status();
  };
  Trial few = trial;
  few.events.resize(5);
  EXPECT_EQ(error(few).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(error(few).message(), HasSubstr("5 events"));

  Trial unknown_line = trial;
  unknown_line.events[7].line = kNumLines;
  EXPECT_EQ(error(unknown_line).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(error(unknown_line).message(), HasSubstr("event 7"));
  unknown_line.events[7].line = -1;
  EXPECT_EQ(error(unknown_line).code(), absl::StatusCode::kInvalidArgument);

  Trial not_finite = trial;
  not_finite.events[3].by = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(error(not_finite).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(error(not_finite).message(), HasSubstr("event 3"));

  Trial one_line = trial;
  for (LabelledEvent& event : one_line.events) event.line = 0;
  EXPECT_EQ(error(one_line).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(error(one_line).message(), HasSubstr("do not determine the pose"));

  Trial behind = trial;
  behind.start.translation_m.z() = -30.0;
  EXPECT_EQ(error(behind).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(error(behind).message(), HasSubstr("in view"));
}

TEST(LineFitOptions, ValidateNamesTheField) {
  const Trial trial = MakeTrial(6, 1.0, 0.0);
  const auto message = [&](const auto& change) {
    LineFitOptions options;
    change(options);
    const auto fit = FitPoseToLines(trial.camera, trial.lines, trial.events, trial.start, options);
    EXPECT_EQ(fit.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(fit.status().message());
  };
  using O = LineFitOptions;
  EXPECT_THAT(message([](O& o) { o.max_iterations = 0; }), HasSubstr("max_iterations"));
  EXPECT_THAT(message([](O& o) { o.tolerance_px = 0.0; }), HasSubstr("tolerance_px"));
  EXPECT_THAT(message([](O& o) { o.min_sigma_px = -1.0; }), HasSubstr("min_sigma_px"));
  EXPECT_THAT(message([](O& o) { o.mixture_gate_px = 0.0; }), HasSubstr("mixture_gate_px"));
  EXPECT_THAT(message([](O& o) { o.filter_sigma_px = 0.0; }), HasSubstr("filter_sigma_px"));
  EXPECT_THAT(message([](O& o) { o.filter_initial_px = 0.0; }), HasSubstr("filter_initial_px"));
  EXPECT_THAT(message([](O& o) { o.filter_gate_chi2 = std::nan(""); }), HasSubstr("filter_gate_chi2"));
  EXPECT_THAT(message([](O& o) {
                o.method = LineFitMethod::kMixture;
                o.formulas = LineFitFormulas::kReleasedCode;
              }),
              HasSubstr("formulas"));
}

TEST(LineFit, LeastSquaresIsTheRootMeanSquare) {
  const Trial trial = MakeTrial(7, 2.0, 0.1);
  const LineFit fit = FitOrDie(trial, With(LineFitMethod::kLeastSquares));
  double squares = 0.0;
  for (const double d : Distances(trial, fit.camera_from_object)) squares += d * d;
  EXPECT_NEAR(fit.sigma_px, std::sqrt(squares / static_cast<double>(trial.events.size())), 1e-9);
  EXPECT_EQ(fit.weights, std::vector<double>(trial.events.size(), 1.0));
}

TEST(LineFit, TheScaleOfMIsTheMadOfItsDistances) {
  const Trial trial = MakeTrial(7, 2.0, 0.1);
  const LineFit fit = FitOrDie(trial, With(LineFitMethod::kTukeyM));
  std::vector<double> distances = Distances(trial, fit.camera_from_object);
  EXPECT_NEAR(fit.sigma_px, MadScale(distances), 1e-4);
}

TEST(LineFit, TheScaleOfSSolvesItsEquation) {
  const Trial trial = MakeTrial(7, 2.0, 0.1);
  const LineFit fit = FitOrDie(trial, With(LineFitMethod::kTukeyS));
  double sum = 0.0;
  for (const double d : Distances(trial, fit.camera_from_object)) sum += TukeyRho(d / fit.sigma_px, kTukeyBreakdown);
  EXPECT_NEAR(sum / static_cast<double>(trial.events.size()), kTukeyScaleTarget, 1e-6);
}

TEST(LineFit, MmKeepsTheScaleOfSAndDiffersFromM) {
  const Trial trial = MakeTrial(7, 2.0, 0.1);
  const LineFit s = FitOrDie(trial, With(LineFitMethod::kTukeyS));
  const LineFit m = FitOrDie(trial, With(LineFitMethod::kTukeyM));
  const LineFit mm = FitOrDie(trial, With(LineFitMethod::kTukeyMm));
  EXPECT_EQ(mm.sigma_px, s.sigma_px);
  EXPECT_NE(mm.sigma_px, m.sigma_px);
  EXPECT_GT(Difference(mm.camera_from_object, m.camera_from_object).norm(), 1e-7);
  EXPECT_GT(Difference(mm.camera_from_object, s.camera_from_object).norm(), 1e-7);
  // The weights are those of Tukey at c = 4.685 with this scale, at the estimated pose.
  const std::vector<double> distances = Distances(trial, mm.camera_from_object);
  for (size_t i = 0; i < distances.size(); ++i) {
    ASSERT_NEAR(mm.weights[i], TukeyWeight(distances[i] / s.sigma_px, kTukeyEfficient), 1e-5);
  }
}

TEST(LineFit, TheMixtureFindsSpreadAndShareAtAnyNoise) {
  for (const double sigma_px : {0.5, 2.0, 8.0}) {
    const Trial trial = MakeTrial(8, sigma_px, 0.3, 200);
    const LineFit fit = FitOrDie(trial, With(LineFitMethod::kMixture));
    EXPECT_NEAR(fit.sigma_px, sigma_px, 0.1 * sigma_px);
    double explained = 0.0;
    for (const double weight : fit.weights) explained += weight;
    EXPECT_NEAR(explained / static_cast<double>(trial.events.size()), 0.7, 0.06);
  }
}

TEST(LineFit, TheFilterDependsOnTheOrderAndReportsRejectedEvents) {
  Trial trial = MakeTrial(9, 1.0, 0.2);
  const LineFit fit = FitOrDie(trial, With(LineFitMethod::kErrorStateFilter));
  double passed = 0.0;
  for (const double weight : fit.weights) passed += weight;
  EXPECT_NEAR(passed / static_cast<double>(trial.events.size()), 0.8, 0.1);
  std::reverse(trial.events.begin(), trial.events.end());
  const LineFit reversed = FitOrDie(trial, With(LineFitMethod::kErrorStateFilter));
  EXPECT_NE(fit.camera_from_object.translation_m, reversed.camera_from_object.translation_m);
}

// The synthetic experiment with 2 px and 2 % of wrong labels, 60 trials: released against corrected formulas.
TEST(LineFit, TheReleasedCodeIsLessAccurate) {
  for (const LineFitMethod method : {LineFitMethod::kTukeyM, LineFitMethod::kTukeyMm}) {
    std::vector<double> corrected, released;
    for (int k = 0; k < 60; ++k) {
      const Trial trial = MakeTrial(3000 + k, 2.0, 0.02);
      const auto error = [&](LineFitFormulas formulas) {
        return Difference(FitOrDie(trial, With(method, formulas)).camera_from_object, trial.truth).tail<3>().norm();
      };
      corrected.push_back(error(LineFitFormulas::kCorrected));
      released.push_back(error(LineFitFormulas::kReleasedCode));
    }
    EXPECT_GT(Median(released), 1.15 * Median(corrected));
  }
}

}  // namespace
}  // namespace evpose
