// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/sqpnp.h"

#include <gtest/gtest.h>

#include "core/numerics/random.h"

namespace evpose {
namespace {

struct Scene {
  CameraModel camera = {1280, 720, 1000.0, 1010.0, 640.0, 360.0, {}};
  RigidTransform pose;
  std::vector<PointMatch> matches;
};

Scene MakeScene(uint64_t seed, bool is_planar, double noise_px) {
  Scene scene;
  Random random(seed);
  scene.pose = {ExpSo3({random.Normal(), random.Normal(), random.Normal()}), {0.1, -0.05, 1.0}};
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3d point{random.Uniform(-0.1, 0.1), random.Uniform(-0.1, 0.1),
                                is_planar ? 0.0 : random.Uniform(-0.1, 0.1)};
    const Eigen::Vector2d noise{noise_px * random.Normal(), noise_px * random.Normal()};
    scene.matches.push_back({point, scene.camera.Project(scene.pose * point) + noise});
  }
  return scene;
}

TEST(Sqpnp, IsExactWithoutNoiseAndNearWithIt) {
  for (int seed = 0; seed < 20; ++seed) {
    for (const double noise_px : {0.0, 0.5}) {
      const Scene scene = MakeScene(seed, false, noise_px);
      const auto pose = EstimatePoseBySqpnp(scene.camera, scene.matches);
      ASSERT_TRUE(pose.ok()) << pose.status();
      EXPECT_LT(RotationAngle(pose->rotation, scene.pose.rotation), 1e-5 + 0.06 * noise_px);
      EXPECT_LT((pose->translation_m - scene.pose.translation_m).norm(), 1e-5 + 0.04 * noise_px);
    }
  }
}

TEST(Sqpnp, PlanesWork) {
  for (int seed = 0; seed < 20; ++seed) {
    const Scene scene = MakeScene(seed, true, 0.0);
    const auto pose = EstimatePoseBySqpnp(scene.camera, scene.matches);
    ASSERT_TRUE(pose.ok()) << pose.status();
    EXPECT_LT(RotationAngle(pose->rotation, scene.pose.rotation), 1e-3) << seed;
  }
}

TEST(Sqpnp, TooFewPointsAreAnError) {
  Scene scene = MakeScene(1, false, 0.0);
  scene.matches.resize(2);
  EXPECT_EQ(EstimatePoseBySqpnp(scene.camera, scene.matches).status().code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose
