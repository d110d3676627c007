// SPDX-License-Identifier: Apache-2.0

// The minimum of the mixture at given weights, computed by the sums by line and by Ceres over all events with automatic
// differentiation. Both must agree.
#include <ceres/autodiff_cost_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <memory>
#include <vector>

#include "core/association/observation_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/estimation/mixture_estimator.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr double kSigmaPx = 0.8;
constexpr double kEventsPerInformation = 20.0;
constexpr double kScale = 1.0 / (kSigmaPx * kSigmaPx * kEventsPerInformation);

// Residual: sqrt(kScale w) times the distance of an event from its line at the time of the event. The parameters are
// Minus(state, predicted).
struct EventDistance {
  const CameraModel& camera;
  const MotionState& predicted;
  TrackedLine line;
  Observation event;
  double weight;

  template <typename T>
  bool operator()(const T* x, T* residual) const {
    using Vector3 = Eigen::Matrix<T, 3, 1>;
    const Vector3 turn(x[3], x[4], x[5]);
    const Vector3 v = Vector3(x[6], x[7], x[8]) + predicted.twist.head<3>().cast<T>();
    const Vector3 w = Vector3(x[9], x[10], x[11]) + predicted.twist.tail<3>().cast<T>();
    Vector3 points[2], velocities[2];
    for (const int end : {0, 1}) {
      const Vector3 arm = (predicted.camera_from_object.rotation * (end == 0 ? line.p1 : line.p2)).cast<T>();
      const Vector3 turned = Turn(turn, arm);
      points[end] = turned + predicted.camera_from_object.translation_m.cast<T>() + Vector3(x[0], x[1], x[2]);
      velocities[end] = v + w.cross(turned);
    }
    const Vector3 n = points[0].cross(points[1]);
    const Vector3 n_dot = velocities[0].cross(points[1]) + points[0].cross(velocities[1]);
    const double fx2 = camera.fx_px * camera.fx_px, fy2 = camera.fy_px * camera.fy_px;
    const T rho = sqrt(n.x() * n.x() / fx2 + n.y() * n.y() / fy2);
    const T rho_dot = (n.x() * n_dot.x() / fx2 + n.y() * n_dot.y() / fy2) / rho;
    const Vector3 a = n / rho + event.tau_s * (n_dot / rho - n * (rho_dot / (rho * rho)));
    residual[0] = std::sqrt(kScale * weight) * (a.x() * event.bx + a.y() * event.by + a.z());
    return true;
  }

  // Rotation by the formula of Rodrigues; near zero its quotients are replaced by series.
  template <typename T>
  static Eigen::Matrix<T, 3, 1> Turn(const Eigen::Matrix<T, 3, 1>& by, const Eigen::Matrix<T, 3, 1>& what) {
    const T angle2 = by.squaredNorm();
    T sinc = 1.0 - angle2 / 6.0 + angle2 * angle2 / 120.0;
    T versine = 0.5 - angle2 / 24.0 + angle2 * angle2 / 720.0;
    if (angle2 > 1e-4) {
      const T angle = sqrt(angle2);
      sinc = sin(angle) / angle;
      versine = (1.0 - cos(angle)) / angle2;
    }
    const Eigen::Matrix<T, 3, 1> cross = by.cross(what);
    return what + sinc * cross + versine * by.cross(cross);
  }
};

// Residual of the prior: |U x|^2 = x^T P^-1 x.
struct PriorResidual {
  Matrix12d root_information;

  template <typename T>
  bool operator()(const T* x, T* residuals) const {
    Eigen::Map<Eigen::Matrix<T, 12, 1>> out(residuals);
    out = root_information.cast<T>() * Eigen::Map<const Eigen::Matrix<T, 12, 1>>(x);
    return true;
  }
};

// A window of a cube that moves fast, with clutter, and with a prediction that deviates from the truth.
class MixtureReference : public ::testing::TestWithParam<int> {
 protected:
  MixtureReference() : grid_(camera_) {
    Random random(GetParam());
    const auto normal = [&](double scale) {
      return Eigen::Vector3d{scale * random.Normal(), scale * random.Normal(), scale * random.Normal()};
    };
    MotionState truth;
    truth.camera_from_object = testing::MakePose(Eigen::Vector3d(0.0, 0.0, 0.8) + normal(0.05), normal(1.0));
    truth.twist << normal(1.0), normal(4.0);
    for (const ModelLine& line : cube_->lines) {
      tracked_.push_back({static_cast<int>(tracked_.size()), line.p1, line.p2});
    }
    Vector12d off;
    off << normal(5e-4), normal(2e-3), normal(0.05), normal(0.2);
    predicted_ = Plus(truth, off);
    predicted_.covariance.setZero();
    for (int k = 0; k < 12; ++k)
      predicted_.covariance(k, k) = std::pow(k < 3 ? 5e-4 : k < 6 ? 2e-3 : k < 9 ? 0.05 : 0.2, 2);
    predicted_.covariance.topRightCorner<6, 6>().diagonal().setConstant(1e-6);
    predicted_.covariance.bottomLeftCorner<6, 6>().diagonal().setConstant(1e-6);

    ProjectLines(camera_, truth, tracked_, lines_);
    ProjectVelocityJacobians(camera_, truth, tracked_, absl::MakeSpan(lines_));
    grid_.Build(lines_, 20.0);
    for (int i = 0; i < 1500; ++i) AddEvent(random);
  }

  // Adds an event on a line at its own time, or displaced at random.
  void AddEvent(Random& random) {
    const ImageLine& line = lines_[random.UniformInt(lines_.size())];
    const double tau_s = random.Uniform(-1e-3, 1e-3);
    Eigen::Vector2d pixel = line.PointAt(random.Uniform());
    const Eigen::Vector2d normal(-line.direction.y(), line.direction.x());
    const double moved_px = -tau_s * BearingOf(camera_, pixel).dot(line.a_dot);
    pixel += (moved_px + kSigmaPx * random.Normal()) * -normal;
    if (random.Uniform() < 0.2) pixel += Eigen::Vector2d{random.Uniform(-8.0, 8.0), random.Uniform(-8.0, 8.0)};
    Observation event = testing::ObservationAt(camera_, pixel);
    event.tau_s = tau_s;
    if (grid_.GiveLines(event)) events_.push_back(event);
  }

  const CameraModel camera_ = testing::MakeCamera(1280, 720, 1000.0);
  const std::shared_ptr<const ObjectModel> cube_ = testing::MakeCube(0.15);
  const MixtureDensity density_{kSigmaPx, 0.2, 6.0};
  std::vector<TrackedLine> tracked_;
  MotionState predicted_;
  std::vector<ImageLine> lines_;
  TileGrid grid_;
  std::vector<Observation> events_;
};

void SolveToRounding(ceres::Problem& problem) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.trust_region_strategy_type = ceres::DOGLEG;
  options.function_tolerance = 1e-18;
  options.gradient_tolerance = 0.0;
  options.parameter_tolerance = 0.0;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
}

// The covariance of a solved problem, for a left perturbation of the state; `x` is the solution.
Matrix12d CovarianceAt(ceres::Problem& problem, const Vector12d& x) {
  ceres::CRSMatrix sparse;
  problem.Evaluate({}, nullptr, nullptr, nullptr, &sparse);
  const Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 12, Eigen::RowMajor>> rows(sparse.values.data(),
                                                                                    sparse.num_rows, 12);
  // Converts from the tangent space at the difference to the left perturbation of the state.
  Matrix12d left_from_difference = Matrix12d::Identity();
  left_from_difference.block<3, 3>(3, 3) = LeftJacobianSo3(x.segment<3>(3));
  return left_from_difference * (rows.transpose() * rows).inverse() * left_from_difference.transpose();
}

INSTANTIATE_TEST_SUITE_P(Windows, MixtureReference, ::testing::Range(1, 9));

TEST_P(MixtureReference, MinimumAndCovarianceEqualCeresOverAllEvents) {
  const Matrix12d information = predicted_.covariance.inverse();
  // Weights at the prediction: summed by line, and for each event alone for Ceres.
  ProjectLines(camera_, predicted_, tracked_, lines_);
  ProjectVelocityJacobians(camera_, predicted_, tracked_, absl::MakeSpan(lines_));
  MixturePass pass;
  const std::vector<LineDensities> even(lines_.size(), LineDensities::Of(density_));
  std::vector<MixtureLine> sums;
  const MixtureTotals totals = pass.Accumulate({events_, lines_.size()}, lines_, density_, even, sums);
  ASSERT_GT(totals.weight, 600.0);

  Vector12d x = Vector12d::Zero();
  ceres::Problem problem;
  double weight_sum = 0.0;
  std::vector<MixtureLine> of_event;
  for (const Observation& event : events_) {
    pass.Accumulate({{&event, 1}, lines_.size()}, lines_, density_, even, of_event);
    for (size_t k = 0; k < of_event.size(); ++k) {
      const double weight = of_event[k].sums.weight();
      if (weight <= 0.0) continue;
      weight_sum += weight;
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<EventDistance, 1, 12>(
                                   new EventDistance{camera_, predicted_, tracked_[k], event, weight}),
                               nullptr, x.data());
    }
  }
  EXPECT_NEAR(weight_sum, totals.weight, 1e-6 * totals.weight);
  const Matrix12d root = information.llt().matrixU();
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<PriorResidual, 12, 12>(new PriorResidual{root}), nullptr,
                           x.data());
  SolveToRounding(problem);

  MotionState state = predicted_;
  Matrix12d hessian;
  for (int step = 0; step < 8; ++step) {
    ProjectLines(camera_, state, tracked_, lines_);
    ProjectVelocityJacobians(camera_, state, tracked_, absl::MakeSpan(lines_));
    hessian.setZero();
    Vector12d gradient = Vector12d::Zero();
    AddPriorEquations(state, predicted_, information, hessian, gradient);
    for (size_t k = 0; k < lines_.size(); ++k) {
      LineEquations(sums[k].sums, lines_[k], kScale).AddTo(&hessian, gradient);
    }
    state = Plus(state, -hessian.ldlt().solve(gradient));
  }
  hessian = Matrix12d(hessian.selfadjointView<Eigen::Lower>());  // only this triangle is computed
  const Vector12d found = Minus(state, predicted_);
  EXPECT_GT(found.norm(), 1e-3) << "there must be something to find";
  // The rounding of single precision, relative to the standard deviations.
  const Vector12d sigmas_found = hessian.inverse().diagonal().cwiseSqrt();
  EXPECT_LT((found - x).cwiseQuotient(sigmas_found).cwiseAbs().maxCoeff(), 1e-3);

  const Matrix12d expected = CovarianceAt(problem, x);
  const Vector12d sigmas = expected.diagonal().cwiseSqrt().cwiseInverse();
  const Matrix12d difference = sigmas.asDiagonal() * (hessian.inverse() - expected) * sigmas.asDiagonal();
  EXPECT_LT(difference.cwiseAbs().maxCoeff(), 1e-5);
}

}  // namespace
}  // namespace evpose
