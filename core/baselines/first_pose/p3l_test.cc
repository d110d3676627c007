// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/p3l.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <unsupported/Eigen/Polynomials>

#include "core/baselines/first_pose/directions_testing.h"
#include "core/geometry/rigid_transform.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using ::testing::DoubleNear;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

struct Problem {
  Eigen::Matrix3d rotation;
  std::array<Eigen::Vector3d, 3> normals;
  std::array<Eigen::Vector3d, 3> directions;
};

Problem MakeProblem(Random& random, const std::array<Eigen::Vector3d, 3>& directions) {
  Problem problem;
  problem.rotation = ExpSo3(3.0 * random.Uniform() * RandomUnit(random));
  problem.directions = directions;
  for (int i = 0; i < 3; ++i) {
    problem.normals[i] = (problem.rotation * directions[i]).cross(RandomUnit(random)).normalized();
  }
  return problem;
}

double NearestSolution(const Problem& problem) {
  double nearest = M_PI;
  for (const Eigen::Matrix3d& rotation : SolveP3l(problem.normals, problem.directions)) {
    nearest = std::min(nearest, RotationAngle(rotation, problem.rotation));
  }
  return nearest;
}

TEST(P3l, FindsTheTruthAmongAtMostEightSolutions) {
  Random random(1);
  for (int i = 0; i < 200; ++i) {
    const Problem problem = MakeProblem(random, {RandomUnit(random), RandomUnit(random), RandomUnit(random)});
    const auto rotations = SolveP3l(problem.normals, problem.directions);
    EXPECT_LE(rotations.size(), 8u);
    EXPECT_LT(NearestSolution(problem), 1e-5) << i;
    for (const Eigen::Matrix3d& rotation : rotations) {
      EXPECT_NEAR((rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).norm(), 0.0, 1e-12);
      EXPECT_NEAR(rotation.determinant(), 1.0, 1e-12);
    }
  }
}

TEST(P3l, SolutionsSatisfyTheConstraints) {
  Random random(2);
  for (int i = 0; i < 100; ++i) {
    const Problem problem = MakeProblem(random, {RandomUnit(random), RandomUnit(random), RandomUnit(random)});
    int exact = 0;
    for (const Eigen::Matrix3d& rotation : SolveP3l(problem.normals, problem.directions)) {
      double worst = 0.0;
      for (int k = 0; k < 3; ++k) {
        worst = std::max(worst, std::abs(problem.normals[k].dot(rotation * problem.directions[k])));
      }
      exact += worst < 1e-6;
      EXPECT_LT(worst, 1e-2);  // a double root that rounding has separated
    }
    EXPECT_GE(exact, 1);
  }
}

TEST(P3l, PolynomialAndFunctionOfTheAngleAgree) {
  Random random(5);
  for (int i = 0; i < 20; ++i) {
    const bool is_box = i % 2 == 1;
    const Eigen::Vector3d x = Eigen::Vector3d::UnitX(), y = Eigen::Vector3d::UnitY(), z = Eigen::Vector3d::UnitZ();
    const P3lFrame frame(RandomUnit(random), is_box ? x : RandomUnit(random));
    const P3lConstraint first(frame, RandomUnit(random), is_box ? y : RandomUnit(random));
    const P3lConstraint second(frame, RandomUnit(random), is_box ? z : RandomUnit(random));
    const P3lPolynomial polynomial = EliminateBeta(first, second);
    EXPECT_EQ(polynomial.is_perpendicular, is_box);
    const double alpha = random.Uniform(-3.0, 3.0);
    const double t = std::tan(0.5 * alpha);
    const double scale = std::pow(1.0 + t * t, is_box ? 2 : 4);
    EXPECT_NEAR(Eigen::poly_eval(polynomial.coefficients, t) / scale, ConstraintOfAlpha(first, second, alpha), 1e-12);
  }
}

TEST(P3l, BoxesAndParallelPairsAreSolved) {
  const Eigen::Vector3d x = Eigen::Vector3d::UnitX(), y = Eigen::Vector3d::UnitY(), z = Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d xy = (x + 2.0 * y).normalized();
  Random random(3);
  for (const auto& directions : std::vector<std::array<Eigen::Vector3d, 3>>{{x, y, z},
                                                                            {z, x, y},
                                                                            {x, x, y},
                                                                            {x, y, x},
                                                                            {y, x, x},
                                                                            {x, y, xy},
                                                                            {z, x, xy},
                                                                            {x, z, xy},
                                                                            {x, Eigen::Vector3d(-x), z}}) {
    for (int i = 0; i < 50; ++i) {
      const Problem problem = MakeProblem(random, directions);
      EXPECT_LT(NearestSolution(problem), 1e-4)
          << directions[0].transpose() << ", " << directions[1].transpose() << ", " << directions[2].transpose();
    }
  }
}

TEST(RealRoots, AreThoseOfTheFactors) {
  Eigen::VectorXd roots(5), coefficients(6);
  roots << 3.0, -1.0, 0.5, 20.0, -7.0;
  Eigen::roots_to_monicPolynomial(roots, coefficients);
  EXPECT_THAT(RealRoots(coefficients, 1e-6),
              ElementsAre(DoubleNear(-7.0, 1e-11), DoubleNear(-1.0, 1e-11), DoubleNear(0.5, 1e-11),
                          DoubleNear(3.0, 1e-11), DoubleNear(20.0, 1e-10)));
}

TEST(RealRoots, ASplitDoubleRootCountsWithinTheImaginaryRatio) {
  EXPECT_THAT(RealRoots(Eigen::Vector3d(1.0, 0.0, 1.0), 1e-3), IsEmpty());
  // (x - 1)^2 + 1e-8: two roots 1e-4 from the real axis.
  const Eigen::VectorXd split = Eigen::Vector3d(1.0 + 1e-8, -2.0, 1.0);
  EXPECT_THAT(RealRoots(split, 1e-6), IsEmpty());
  EXPECT_THAT(RealRoots(split, 1e-3), ElementsAre(DoubleNear(1.0, 1e-6)));
}

TEST(RealRoots, VanishingLeadingCoefficientsLowerTheDegree) {
  EXPECT_THAT(RealRoots(Eigen::Vector4d(2.0, -1.0, 1e-20, 0.0), 1e-6), ElementsAre(DoubleNear(2.0, 1e-12)));
  EXPECT_THAT(RealRoots(Eigen::VectorXd::Constant(1, 3.0), 1e-6), IsEmpty());
  EXPECT_THAT(RealRoots(Eigen::VectorXd::Zero(4), 1e-6), IsEmpty());
}

TEST(P3l, ParallelLinesDoNotDetermineTheRotation) {
  const Eigen::Vector3d x = Eigen::Vector3d::UnitX();
  Random random(4);
  const Problem problem = MakeProblem(random, {x, x, x});
  EXPECT_TRUE(SolveP3l(problem.normals, problem.directions).empty());
}

}  // namespace
}  // namespace evpose
