// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/direction_symmetries.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/geometry/rigid_transform.h"

namespace evpose {
namespace {

using Directions = std::vector<Eigen::Vector3d>;

TEST(DirectionSymmetriesTest, AreThoseOfTheSet) {
  const Directions box = {Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitZ()};
  EXPECT_EQ(DirectionSymmetries(box).size(), 24u);
  EXPECT_EQ(DirectionSymmetries({box[0], box[1]}).size(), 8u);
  EXPECT_EQ(DirectionSymmetries({box[0]}).size(), 1u);
  const Directions any = {Eigen::Vector3d(1, 2, 3).normalized(), Eigen::Vector3d(-2, 1, 5).normalized(),
                          Eigen::Vector3d(4, -1, 1).normalized()};
  EXPECT_EQ(DirectionSymmetries(any).size(), 1u);
  // Six directions in a plane, 30 degrees apart: the dihedral group of the regular 12-gon.
  Directions star;
  for (int i = 0; i < 6; ++i) star.push_back(ExpSo3({0.0, 0.0, i * M_PI / 6}) * Eigen::Vector3d::UnitX());
  EXPECT_EQ(DirectionSymmetries(star).size(), 24u);
  for (const Eigen::Matrix3d& q : DirectionSymmetries(box)) EXPECT_NEAR(q.determinant(), 1.0, 1e-12);
  EXPECT_LT(SymmetryDeviation(box, DirectionSymmetries(box)), 1e-12);
}

TEST(DirectionSymmetriesTest, EachDirectionOfAModelIsTakenOnce) {
  ObjectModel model;
  const auto add = [&model](const Eigen::Vector3d& direction) {
    model.lines.push_back({Eigen::Vector3d::Ones(), Eigen::Vector3d::Ones() + direction, {}});
  };
  add({2.0, 0.0, 0.0});
  add({-1.0, 0.0, 0.0});
  add({0.0, 0.0, 3.0});
  add({1.0, 0.0, 0.0005});
  add({1.0, 0.0, 0.01});
  add({0.0, 0.0, 0.0});
  const Directions directions = UniqueDirections(model);
  ASSERT_EQ(directions.size(), 3u);
  EXPECT_EQ(directions[0], Eigen::Vector3d::UnitX());
  EXPECT_EQ(directions[1], Eigen::Vector3d::UnitZ());
}

}  // namespace
}  // namespace evpose
