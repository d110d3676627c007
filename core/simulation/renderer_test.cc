// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/renderer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace evpose {
namespace {

const CameraModel kCamera = {320, 240, 260.0, 260.0, 160.5, 118.5, {}};
const CameraModel kBentCamera = {320, 240, 260.0, 260.0, 160.5, 118.5, {-0.25, 0.1, 0.001, -0.001, 0.0}};

RigidTransform PoseAt(const SceneObject& object, double x, double y, double z, double turn = 0.0) {
  return {ExpSo3({0.0, turn, 0.3 * turn}) * object.view_from_object, {x, y, z}};
}

float At(const SceneRenderer& renderer, const CameraModel& camera, const Eigen::Vector2d& pixel) {
  const auto x = static_cast<int>(std::lround(pixel.x()));
  const auto y = static_cast<int>(std::lround(pixel.y()));
  return renderer.picture()[static_cast<size_t>(y) * camera.width_px + x];
}

TEST(SceneRendererTest, FacesHaveTheirShadeWhereTheCameraModelSays) {
  for (const CameraModel& camera : {kCamera, kBentCamera}) {
    const SceneOptions options;
    const SceneObject object = MakeSceneObject(SimulatedObject::kCube, 0.2);
    SceneRenderer renderer(options, object, camera, 1);
    const RigidTransform pose = PoseAt(object, 0.15, -0.1, 0.8);
    EXPECT_EQ(renderer.Render(pose, 0.0), (PixelRect{0, 0, 320, 240}));
    int seen = 0;
    for (const Surface& surface : object.bodies[0].surfaces) {
      const Eigen::Vector3d middle = pose * (0.5 * (surface.outline[0] + surface.outline[2]));
      if ((pose.rotation * surface.normal).dot(middle) >= 0.0) continue;
      ++seen;
      EXPECT_NEAR(At(renderer, camera, camera.Distort(camera.Project(middle))), surface.reflectance, 1e-4);
      // The corners of the face in the distorted image: its shade is inside them and not outside.
      const Eigen::Vector3d inside = pose * (0.93 * surface.outline[0] + 0.07 * surface.outline[2]);
      EXPECT_NEAR(At(renderer, camera, camera.Distort(camera.Project(inside))), surface.reflectance, 1e-4);
    }
    EXPECT_EQ(seen, 3);
    for (int y = 0; y < camera.height_px; ++y) {  // the first and the last column, which the lens's blur repeats
      ASSERT_NEAR(renderer.picture()[static_cast<size_t>(y) * camera.width_px], options.background.reflectance, 1e-6)
          << y;
      ASSERT_NEAR(renderer.picture()[(y + 1) * camera.width_px - 1], options.background.reflectance, 1e-6) << y;
    }
  }
}

// Compares incremental rendering, only of the pixels that may have changed, with complete rendering at the same time.
void ExpectStepsEqualFresh(const SceneOptions& options, const CameraModel& camera) {
  const SceneObject object = MakeSceneObject(options.object, 0.25);
  SceneRenderer stepped(options, object, camera, 7);
  for (int i = 0; i <= 12; ++i) {
    const double t = 0.003 * i;
    // The object moves from inside the image across its border.
    const RigidTransform pose = PoseAt(object, 0.2 + 0.03 * i, -0.1 - 0.01 * i, 0.8, 0.1 * i);
    const std::vector<float> before = stepped.picture();
    const PixelRect changed = stepped.Render(pose, t);
    SceneRenderer fresh(options, object, camera, 7);
    fresh.Render(pose, t);
    float largest = 0.0f;
    float largest_outside = 0.0f;
    for (int y = 0; y < camera.height_px; ++y) {
      for (int x = 0; x < camera.width_px; ++x) {
        const size_t pixel = static_cast<size_t>(y) * camera.width_px + x;
        largest = std::max(largest, std::abs(stepped.picture()[pixel] - fresh.picture()[pixel]));
        const bool inside = x >= changed.x0 && x < changed.x1 && y >= changed.y0 && y < changed.y1;
        if (!inside) largest_outside = std::max(largest_outside, std::abs(stepped.picture()[pixel] - before[pixel]));
      }
    }
    EXPECT_LT(largest, 1e-5f) << i;
    EXPECT_EQ(largest_outside, 0.0f) << i;
  }
}

TEST(SceneRendererTest, OnlyTheChangedPartIsRenderedAgain) {
  SceneOptions options;
  ExpectStepsEqualFresh(options, kBentCamera);
  options.object = SimulatedObject::kSpacecraft;
  options.background.is_textured = true;
  options.occluder.is_present = true;
  ExpectStepsEqualFresh(options, kCamera);
  options.background.has_moving_edge = true;
  options.occluder.follows_object = true;
  ExpectStepsEqualFresh(options, kCamera);
  options.background.texture_speed_px_per_s = 300.0;
  ExpectStepsEqualFresh(options, kCamera);
  options.light.flicker_depth = 0.4;
  options.light.reaches_background = true;
  ExpectStepsEqualFresh(options, kCamera);
}

TEST(SceneRendererTest, FlickerFollowsItsFrequency) {
  SceneOptions options;
  options.light.flicker_depth = 0.5;
  options.light.flicker_hz = 100.0;
  const SceneObject object = MakeSceneObject(SimulatedObject::kPlanar, 0.25);
  SceneRenderer renderer(options, object, kCamera, 1);
  const RigidTransform pose = PoseAt(object, 0.0, 0.0, 0.8);
  const auto light_at = [&](double t) {
    renderer.Render(pose, t);
    return renderer.picture()[118 * 320 + 160];
  };
  const float steady = light_at(0.0);
  EXPECT_NEAR(light_at(0.0025), 1.5f * steady, 1e-4);
  EXPECT_NEAR(light_at(0.0075), 0.5f * steady, 1e-4);
  EXPECT_NEAR(light_at(0.01), steady, 1e-4);
  EXPECT_LE(renderer.LongestStepS(), 0.25e-3);
}

TEST(SceneRendererTest, LightSwingsByItsRatio) {
  SceneOptions options;
  options.light.change_ratio = 4.0;
  options.light.change_period_s = 1.0;
  const SceneObject object = MakeSceneObject(SimulatedObject::kPlanar, 0.25);
  SceneRenderer renderer(options, object, kCamera, 1);
  const RigidTransform pose = PoseAt(object, 0.0, 0.0, 0.8);
  renderer.Render(pose, 0.0);
  const float bright = renderer.picture()[118 * 320 + 160];
  renderer.Render(pose, 0.5);
  EXPECT_NEAR(renderer.picture()[118 * 320 + 160], bright / 4.0f, 1e-4);
  EXPECT_NEAR(renderer.picture()[0], options.background.reflectance, 1e-6);  // the light does not reach the background
}

TEST(SceneRendererTest, OccluderHides) {
  SceneOptions options;
  options.occluder.is_present = true;
  options.occluder.width_px = 2000.0;
  const SceneObject object = MakeSceneObject(SimulatedObject::kCube, 0.2);
  SceneRenderer renderer(options, object, kCamera, 1);
  renderer.Render(PoseAt(object, 0.0, 0.0, 0.8), 0.0);
  for (const float light : renderer.picture()) ASSERT_NEAR(light, options.occluder.reflectance, 1e-5);
}

TEST(SceneRendererTest, AnOccluderThatFollowsTheObjectStaysInFrontOfIt) {
  SceneOptions options;
  options.occluder.is_present = true;
  options.occluder.follows_object = true;
  options.occluder.swing_ratio = 0.02;
  const SceneObject object = MakeSceneObject(SimulatedObject::kCube, 0.2);
  SceneRenderer renderer(options, object, kBentCamera, 1);
  for (int i = 0; i < 10; ++i) {
    const RigidTransform pose = PoseAt(object, 0.06 * (i - 5), 0.03 * (5 - i), 0.9);
    renderer.Render(pose, 0.1 * i);
    const Eigen::Vector2d middle = kBentCamera.Distort(kBentCamera.Project(pose.translation_m));
    EXPECT_NEAR(At(renderer, kBentCamera, middle), options.occluder.reflectance, 1e-4) << i;
  }
}

TEST(SceneRendererTest, TheMovingEdgeSweepsBehindTheObject) {
  SceneOptions options;
  options.background.has_moving_edge = true;
  options.background.edge_speed_px_per_s = 400.0;
  const SceneObject object = MakeSceneObject(SimulatedObject::kPlanar, 0.25);
  SceneRenderer renderer(options, object, kCamera, 1);
  SceneOptions without = options;
  without.background.has_moving_edge = false;
  SceneRenderer still(without, object, kCamera, 1);
  const RigidTransform pose = PoseAt(object, 0.0, 0.0, 0.8);
  still.Render(pose, 0.0);
  int least = 320, most = 0;
  for (double t_s = 0.0; t_s < 2.0; t_s += 0.01) {
    renderer.Render(pose, t_s);
    const float* row = renderer.picture().data() + size_t{5} * 320;  // above the object
    const auto bright = static_cast<int>(std::count_if(row, row + 320, [](float v) { return v > 0.39f; }));
    const auto dark = static_cast<int>(std::count_if(row, row + 320, [](float v) { return v < 0.13f; }));
    EXPECT_GE(bright + dark, 310);  // one edge, and no other shades
    least = std::min(least, bright);
    most = std::max(most, bright);
    EXPECT_NEAR(At(renderer, kCamera, {160, 118}), At(still, kCamera, {160, 118}), 1e-5);
  }
  EXPECT_LT(least, 40);
  EXPECT_GT(most, 280);
}

TEST(SceneRendererTest, TheTextureMovesBehindTheObject) {
  SceneOptions options;
  options.background.is_textured = true;
  options.background.texture_speed_px_per_s = 400.0;
  const SceneObject object = MakeSceneObject(SimulatedObject::kPlanar, 0.25);
  SceneRenderer renderer(options, object, kCamera, 1);
  const RigidTransform pose = PoseAt(object, 0.0, 0.0, 0.8);
  renderer.Render(pose, 0.0);
  const float on_object = At(renderer, kCamera, {160, 118});
  const float* const row = renderer.picture().data() + size_t{5} * 320;  // above the object
  double path_px = 0.0, change = 0.0;
  for (int i = 1; i <= 1000; ++i) {
    const double t_s = 1e-3 * i;
    const std::vector<float> before(row, row + 320);
    path_px += renderer.LargestMotionPx(pose, t_s - 1e-3, pose, t_s);
    renderer.Render(pose, t_s);
    for (int x = 0; x < 320; ++x) change += std::abs(row[x] - before[x]);
    EXPECT_NEAR(At(renderer, kCamera, {160, 118}), on_object, 1e-5);
  }
  EXPECT_GT(path_px, 400.0);  // along x alone
  EXPECT_LT(path_px, 600.0);
  EXPECT_GT(change, 10.0);
}

TEST(SceneRendererTest, NearerBodiesHideFartherOnes) {
  SceneOptions options;
  const SceneObject object = MakeSceneObject(SimulatedObject::kSpacecraft, 0.4);
  SceneRenderer renderer(options, object, kCamera, 1);
  // Seen from the right and from the left, the panel on that side is in front of the bus.
  for (const double side : {-1.0, 1.0}) {
    const Eigen::Matrix3d turn = ExpSo3({0.0, side * 1.45, 0.0});
    const RigidTransform pose = {turn, {0.0, 0.0, 0.9}};
    renderer.Render(pose, 0.0);
    const Eigen::Vector3d camera_object = pose.Inverse().translation_m;
    const int nearest = PaintersOrder(object.bodies, camera_object).back();
    const Body& body = object.bodies[nearest];
    EXPECT_GT(body.separator_normal.dot(camera_object), body.separator_offset_m);
    const Eigen::Vector3d middle = 0.25 * (body.surfaces[0].outline[0] + body.surfaces[0].outline[1] +
                                           body.surfaces[0].outline[2] + body.surfaces[0].outline[3]);
    // A panel's cells and back are darker than the bright faces of the bus behind it.
    EXPECT_LT(At(renderer, kCamera, kCamera.Project(pose * middle)), 0.75);
  }
}

TEST(SceneRendererTest, MotionIsThatOfTheFastestVertex) {
  const SceneOptions options;
  const SceneObject object = MakeSceneObject(SimulatedObject::kPlanar, 0.2);
  const SceneRenderer renderer(options, object, kCamera, 1);
  const RigidTransform a = {Eigen::Matrix3d::Identity(), {0.0, 0.0, 1.0}};
  const RigidTransform b = {Eigen::Matrix3d::Identity(), {0.01, 0.0, 1.0}};
  EXPECT_NEAR(renderer.LargestMotionPx(a, 0.0, b, 0.001), 2.6, 1e-9);
}

// Normals point outwards, lines lie on the surface, every vertex lies inside the radius, and the mesh is closed or
// two-sided.
TEST(SceneObjectTest, ModelsAreSound) {
  for (const std::string& name : SimulatedObjectNames()) {
    const SceneObject object = MakeSceneObject(*ParseSimulatedObject(name), 0.3);
    double reach = 0.0;
    for (const Eigen::Vector3d& v : object.model.vertices) reach = std::max(reach, v.norm());
    EXPECT_DOUBLE_EQ(object.radius_m, reach) << name;
    EXPECT_GT(object.model.diameter_m, 0.29) << name;
    double volume = 0.0;
    for (const auto& t : object.model.triangles) {
      volume += object.model.vertices[t[0]].dot(object.model.vertices[t[1]].cross(object.model.vertices[t[2]])) / 6.0;
    }
    EXPECT_GE(volume, -1e-12) << name;
    for (const ModelLine& line : object.model.lines) {
      EXPECT_GT((line.p2 - line.p1).norm(), 0.005) << name;
      EXPECT_FALSE(line.face_normals.empty()) << name;
      for (const Eigen::Vector3d& normal : line.face_normals) {
        EXPECT_NEAR(normal.dot(line.p2 - line.p1), 0.0, 1e-12) << name;
      }
    }
    for (const Body& body : object.bodies) {
      for (const Surface& surface : body.surfaces) {
        const Eigen::Vector3d& o = surface.outline[0];
        EXPECT_NEAR((surface.outline[1] - o).cross(surface.outline[3] - o).normalized().dot(surface.normal), 1.0, 1e-9);
      }
    }
  }
  const SceneObject cube = MakeSceneObject(SimulatedObject::kCube, 0.2);
  EXPECT_EQ(cube.model.vertices.size(), 8u);
  EXPECT_EQ(cube.model.triangles.size(), 12u);
  EXPECT_EQ(cube.model.lines.size(), 12u);
  EXPECT_EQ(MakeSceneObject(SimulatedObject::kPlanar, 0.2).model.lines.size(), 6u);
}

TEST(SceneObjectTest, SeparatorsSeparateTheBodies) {
  const SceneObject object = MakeSceneObject(SimulatedObject::kSpacecraft, 0.4);
  for (size_t i = 0; i < object.bodies.size(); ++i) {
    const Body& body = object.bodies[i];
    for (size_t k = i; k < object.bodies.size(); ++k) {
      for (const Surface& surface : object.bodies[k].surfaces) {
        for (const Eigen::Vector3d& point : surface.outline) {
          const double side = body.separator_normal.dot(point) - body.separator_offset_m;
          if (k > i) {
            EXPECT_LE(side, 1e-9) << i << " " << k;
          } else if (i + 1 < object.bodies.size()) {
            EXPECT_GE(side, -1e-9) << i;
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace evpose
