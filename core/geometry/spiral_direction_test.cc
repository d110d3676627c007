// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/spiral_direction.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace evpose {
namespace {

TEST(SpiralDirectionTest, EveryDirectionHasANearOne) {
  constexpr int kCount = 256;
  std::vector<Eigen::Vector3d> directions;
  for (int i = 0; i < kCount; ++i) directions.push_back(SpiralDirection(i, 1.0 - (2.0 * i + 1.0) / kCount));
  double largest_cosine = -1.0;
  for (int i = 0; i < kCount; ++i) {
    EXPECT_NEAR(directions[i].norm(), 1.0, 1e-12);
    for (int j = 0; j < i; ++j) largest_cosine = std::max(largest_cosine, directions[i].dot(directions[j]));
  }
  // Each takes a part of the sphere of 4 pi / 256; two are at least 0.8 of its square root apart.
  EXPECT_LT(largest_cosine, 1.0 - 0.5 * 0.8 * 0.8 * 4.0 * M_PI / kCount);
}

}  // namespace
}  // namespace evpose
