// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/rotation_bnb.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/baselines/first_pose/directions_testing.h"
#include "core/baselines/first_pose/rotation_count.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/direction_symmetries.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using Directions = std::vector<Eigen::Vector3d>;
using ::testing::HasSubstr;

Eigen::Matrix3d RandomRotation(Random& random) {
  Eigen::Quaterniond q{random.Normal(), random.Normal(), random.Normal(), random.Normal()};
  return q.normalized().toRotationMatrix();
}

Directions BoxDirections() { return {Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitZ()}; }

// Normals of planes through lines with directions R v_k, in turn, rotated by `noise_rad`; `num_spurious` of them are
// random.
Directions MakeNormals(Random& random, const Directions& directions, const Eigen::Matrix3d& rotation, int num_lines,
                       double noise_rad, int num_spurious) {
  Directions normals;
  for (int j = 0; j < num_lines; ++j) {
    const Eigen::Vector3d line = rotation * directions[j % directions.size()];
    const Eigen::Vector3d normal = line.cross(RandomUnit(random)).normalized();
    normals.push_back((normal + noise_rad * random.Normal() * line).normalized());
  }
  for (int j = 0; j < num_spurious; ++j) normals.push_back(RandomUnit(random));
  return normals;
}

// Smallest angle to R Q over the symmetries Q of the directions.
double AngleModuloSymmetry(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b, const Directions& directions) {
  double smallest = M_PI;
  for (const Eigen::Matrix3d& q : DirectionSymmetries(directions)) {
    smallest = std::min(smallest, RotationAngle(a, b * q));
  }
  return smallest;
}

// Largest count on a grid over the ball of axis-angle vectors.
int BruteForce(const Directions& normals, const Directions& directions, double inlier_rad, double step_rad) {
  const int n = static_cast<int>(std::ceil(M_PI / step_rad));
  int best = 0;
  for (int x = -n; x <= n; ++x) {
    for (int y = -n; y <= n; ++y) {
      for (int z = -n; z <= n; ++z) {
        const Eigen::Vector3d r = step_rad * Eigen::Vector3d(x, y, z);
        if (r.norm() > M_PI + step_rad) continue;
        best = std::max(best, CountPerpendicular(normals, directions, ExpSo3(r), inlier_rad));
      }
    }
  }
  return best;
}

class RotationBnbVariants : public ::testing::TestWithParam<RotationBnbOptions> {};

TEST_P(RotationBnbVariants, EqualsBruteForceOnSmallProblems) {
  RotationBnbOptions options = GetParam();
  options.inlier_rad = 0.1;  // large enough for a grid of 0.07 rad to hit the plateaus
  int equal = 0;
  constexpr int kProblems = 12;
  for (int seed = 0; seed < kProblems; ++seed) {
    Random random(seed);
    Directions directions = BoxDirections();
    if (seed % 3 == 1) directions = {RandomUnit(random), RandomUnit(random), RandomUnit(random), RandomUnit(random)};
    if (seed % 3 == 2) directions.resize(2);
    Directions normals;
    for (int j = 0; j < 6; ++j) normals.push_back(RandomUnit(random));
    const auto result = MaximisePerpendicular(normals, directions, options);
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_TRUE(result->is_certified()) << seed;
    const int brute = BruteForce(normals, directions, options.inlier_rad, 0.07);
    EXPECT_GE(result->lower_bound, brute) << seed;
    equal += result->lower_bound == brute;
    for (const Eigen::Matrix3d& rotation : result->rotations) {
      EXPECT_EQ(CountPerpendicular(normals, directions, rotation, options.inlier_rad), result->lower_bound);
    }
  }
  EXPECT_GE(equal, kProblems - 1);  // a plateau may be smaller than the grid
}

RotationBnbOptions Variant(bool uses_symmetry, bool uses_first_order_bound) {
  RotationBnbOptions options;
  options.uses_symmetry = uses_symmetry;
  options.uses_first_order_bound = uses_first_order_bound;
  return options;
}

INSTANTIATE_TEST_SUITE_P(Bounds, RotationBnbVariants,
                         ::testing::Values(Variant(false, false), Variant(false, true), Variant(true, false),
                                           Variant(true, true)));

TEST(RotationBnb, FindsTheCubesRotationAndProvesIt) {
  int exact = 0;
  for (int seed = 0; seed < 10; ++seed) {
    Random random(seed);
    const Eigen::Matrix3d truth = RandomRotation(random);
    const Directions normals = MakeNormals(random, BoxDirections(), truth, 9, 0.0, 0);
    const auto result = MaximisePerpendicular(normals, BoxDirections(), {});
    ASSERT_TRUE(result.ok()) << result.status();
    EXPECT_EQ(result->lower_bound, 9);
    EXPECT_EQ(result->upper_bound, 9);
    EXPECT_TRUE(result->has_all_rotations);
    EXPECT_LT(result->branches, 20'000);
    double nearest = M_PI;
    for (const Eigen::Matrix3d& rotation : result->rotations) {
      nearest = std::min(nearest, AngleModuloSymmetry(truth, rotation, BoxDirections()));
    }
    EXPECT_LT(nearest, RotationBnbOptions().inlier_rad) << seed;
    exact += nearest < 1e-4;
  }
  // Without noise the least-squares rotation of the inliers is the truth, unless a line is within the band of two.
  EXPECT_GE(exact, 8);
}

TEST(RotationBnb, VariantsAgreeAndTheSharperNeedFewerBranches) {
  int64_t published = 0;
  int64_t first_order = 0;
  int64_t symmetric = 0;
  for (int seed = 0; seed < 10; ++seed) {
    Random random(seed);
    const Directions normals = MakeNormals(random, BoxDirections(), RandomRotation(random), 8, 0.005, 2);
    RotationBnbOptions options = Variant(false, false);
    options.max_plateau_branches = 0;
    const auto a = MaximisePerpendicular(normals, BoxDirections(), options);
    options.uses_first_order_bound = true;
    const auto b = MaximisePerpendicular(normals, BoxDirections(), options);
    options.uses_symmetry = true;
    const auto c = MaximisePerpendicular(normals, BoxDirections(), options);
    ASSERT_TRUE(a.ok() && b.ok() && c.ok());
    EXPECT_TRUE(a->is_certified() && b->is_certified() && c->is_certified());
    EXPECT_EQ(a->lower_bound, b->lower_bound);
    EXPECT_EQ(a->lower_bound, c->lower_bound);
    published += a->branches;
    first_order += b->branches;
    symmetric += c->branches;
  }
  EXPECT_LT(first_order, 0.9 * published);
  EXPECT_LT(symmetric, 0.2 * published);
}

TEST(RotationBnb, ReturnsEveryPlateau) {
  // Three image lines do not determine the assignment of directions: there are many plateaus.
  Random random(5);
  const Directions normals = {RandomUnit(random), RandomUnit(random), RandomUnit(random)};
  RotationBnbOptions options;
  options.max_rotations = 1000;
  const auto result = MaximisePerpendicular(normals, BoxDirections(), options);
  ASSERT_TRUE(result.ok());
  EXPECT_EQ(result->lower_bound, 3);
  ASSERT_TRUE(result->has_all_rotations) << result->rotations.size() << " " << result->branches;
  EXPECT_GT(result->rotations.size(), 5u);
  for (size_t a = 0; a < result->rotations.size(); ++a) {
    EXPECT_EQ(CountPerpendicular(normals, BoxDirections(), result->rotations[a], options.inlier_rad), 3);
    for (size_t b = 0; b < a; ++b) {
      const double apart = AngleModuloSymmetry(result->rotations[a], result->rotations[b], BoxDirections());
      EXPECT_GE(apart, options.distinct_rad - 1e-9);
    }
  }
  // Random rotations that reach the maximum: each is near one that was returned.
  int hits = 0;
  while (hits < 200) {
    const Eigen::Matrix3d rotation = RandomRotation(random);
    if (CountPerpendicular(normals, BoxDirections(), rotation, options.inlier_rad) < 3) continue;
    ++hits;
    double nearest = M_PI;
    for (const Eigen::Matrix3d& known : result->rotations) {
      nearest = std::min(nearest, AngleModuloSymmetry(rotation, known, BoxDirections()));
    }
    EXPECT_LE(nearest, 2.0 * options.distinct_rad + 1e-9);
  }
  options.max_rotations = 3;
  const auto few = MaximisePerpendicular(normals, BoxDirections(), options);
  EXPECT_EQ(few->rotations.size(), 3u);
  EXPECT_FALSE(few->has_all_rotations);
}

TEST(RotationBnb, ReportsASpentBudget) {
  Random random(3);
  const Directions normals = MakeNormals(random, BoxDirections(), RandomRotation(random), 8, 0.005, 4);
  RotationBnbOptions options;
  options.max_branches = 100;
  const auto result = MaximisePerpendicular(normals, BoxDirections(), options);
  ASSERT_TRUE(result.ok());
  EXPECT_FALSE(result->is_certified());
  EXPECT_FALSE(result->has_all_rotations);
  EXPECT_LE(result->branches, 107);  // the eight parts of a cube are completed
  options.max_branches = 2'000'000;
  const auto whole = MaximisePerpendicular(normals, BoxDirections(), options);
  EXPECT_TRUE(whole->is_certified());
  EXPECT_LE(result->lower_bound, whole->lower_bound);
  EXPECT_GE(result->upper_bound, whole->upper_bound);
}

TEST(RotationBnb, MatchesGiveOneRotation) {
  Random random(11);
  const Eigen::Matrix3d truth = RandomRotation(random);
  Directions directions;
  Directions normals;
  for (int j = 0; j < 10; ++j) {
    directions.push_back(RandomUnit(random));
    normals.push_back((truth * directions[j]).cross(RandomUnit(random)).normalized());
  }
  for (int j = 0; j < 3; ++j) {  // wrong matches
    directions.push_back(RandomUnit(random));
    normals.push_back(RandomUnit(random));
  }
  RotationBnbOptions options;
  options.inlier_rad = 0.01;
  const auto result = MaximisePerpendicular(normals, directions, options, Correspondences::kKnown);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_TRUE(result->is_certified());
  EXPECT_EQ(result->lower_bound, 10);
  ASSERT_FALSE(result->rotations.empty());
  EXPECT_LT(RotationAngle(result->rotations.front(), truth), 1e-4);
}

TEST(RotationBnb, MatchesOfABoxLeaveFour) {
  Random random(12);
  const Eigen::Matrix3d truth = RandomRotation(random);
  Directions directions;
  for (int j = 0; j < 9; ++j) directions.push_back(BoxDirections()[j % 3]);
  EXPECT_EQ(SignSymmetries(directions).size(), 4u);
  const Directions normals = MakeNormals(random, directions, truth, 9, 0.0, 0);
  RotationBnbOptions options;
  options.inlier_rad = 0.005;
  const auto result = MaximisePerpendicular(normals, directions, options, Correspondences::kKnown);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->lower_bound, 9);
  ASSERT_EQ(result->rotations.size(), 1u);
  double nearest = M_PI;
  for (const Eigen::Matrix3d& q : SignSymmetries(directions)) {
    EXPECT_EQ(CountPerpendicular(normals, BoxDirections(), result->rotations[0] * q, options.inlier_rad), 9);
    nearest = std::min(nearest, RotationAngle(result->rotations[0] * q, truth));
  }
  EXPECT_LT(nearest, 1e-4);
}

TEST(CertifyRotation, ReturnsEachOptimality) {
  Random random(7);
  const Eigen::Matrix3d truth = RandomRotation(random);
  const Directions normals = MakeNormals(random, BoxDirections(), truth, 9, 0.0, 1);
  const auto whole = MaximisePerpendicular(normals, BoxDirections(), {});
  ASSERT_TRUE(whole.ok() && whole->is_certified());
  const auto good = CertifyRotation(normals, BoxDirections(), whole->rotations.front(), {});
  ASSERT_TRUE(good.ok()) << good.status();
  EXPECT_EQ(good->optimality, RotationOptimality::kMaximum);
  EXPECT_EQ(good->count, whole->lower_bound);
  EXPECT_EQ(good->upper_bound, whole->upper_bound);

  const auto bad = CertifyRotation(normals, BoxDirections(), truth * ExpSo3({0.3, 0.2, 0.1}), {});
  ASSERT_TRUE(bad.ok()) << bad.status();
  EXPECT_EQ(bad->optimality, RotationOptimality::kNotMaximum);
  EXPECT_GT(CountPerpendicular(normals, BoxDirections(), bad->better, RotationBnbOptions().inlier_rad), bad->count);

  RotationBnbOptions options;
  options.max_branches = 1;
  const auto unknown = CertifyRotation(normals, BoxDirections(), whole->rotations.front(), options);
  ASSERT_TRUE(unknown.ok());
  EXPECT_EQ(unknown->optimality, RotationOptimality::kUnknown);
  EXPECT_GE(unknown->upper_bound, whole->upper_bound);
}

TEST(RotationBnb, RejectsInvalidArguments) {
  const Directions normals = BoxDirections();
  const Directions box = BoxDirections();
  const auto message = [&](const Directions& n, const Directions& v, const RotationBnbOptions& options) {
    const auto result = MaximisePerpendicular(n, v, options);
    EXPECT_EQ(result.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(result.status().message());
  };
  EXPECT_THAT(message({}, box, {}), HasSubstr("normals"));
  EXPECT_THAT(message({Eigen::Vector3d::Zero()}, box, {}), HasSubstr("normals[0] has length 0"));
  EXPECT_THAT(message(normals, {box[0]}, {}), HasSubstr("fewer than two"));
  EXPECT_THAT(message(normals, {box[0], 2.0 * box[1]}, {}), HasSubstr("directions[1]"));
  const double nan = std::nan("");
  EXPECT_THAT(message({{nan, 0.0, 0.0}}, box, {}), HasSubstr("normals[0]"));
  RotationBnbOptions options;
  options.inlier_rad = 0.0;
  EXPECT_THAT(message(normals, box, options), HasSubstr("inlier_rad"));
  options = {};
  options.max_branches = 0;
  EXPECT_THAT(message(normals, box, options), HasSubstr("max_branches"));
  EXPECT_FALSE(MaximisePerpendicular(normals, {box[0], box[1]}, {}, Correspondences::kKnown).ok());
  EXPECT_FALSE(CertifyRotation(normals, box, -Eigen::Matrix3d::Identity(), {}).ok());
  EXPECT_FALSE(CertifyRotation(normals, box, 1.1 * Eigen::Matrix3d::Identity(), {}).ok());
}

}  // namespace
}  // namespace evpose
