// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/tracker_memory.h"

#include <gtest/gtest.h>

#include <set>

#include "core/detection/line_detector.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/math.h"
#include "core/tracking/lens_views.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakeCube;
using Models = std::vector<std::shared_ptr<const ObjectModel>>;

constexpr double kMb = 1e6;

double MegabytesOf(const CameraModel& camera, const Models& models) {
  uint64_t bytes = EstimateTrackerMemory(camera, models, TrackerOptions()).max_bytes;
  for (const auto& model : std::set(models.begin(), models.end())) bytes += EstimateModelMemory(*model);
  return static_cast<double>(bytes) / kMb;
}

TEST(TrackerMemory, GrowsWithPixelsObjectsAndDistortion) {
  const std::shared_ptr<const ObjectModel> cube = MakeCube(0.2);
  CameraModel small = MakeCamera(640, 480, 500.0);
  CameraModel large = MakeCamera(4096, 4096, 3000.0);
  const double one = MegabytesOf(small, {cube});
  EXPECT_GT(MegabytesOf(large, {cube}), one + 4.0) << "two bits per pixel of the history, and grids";
  EXPECT_GT(MegabytesOf(small, Models(16, cube)), one + 15 * 5.0) << "the stored windows of each object";
  const double plain = MegabytesOf(large, {cube});
  large.distortion[0] = small.distortion[0] = -0.1;
  EXPECT_NEAR(MegabytesOf(small, {cube}) - one, 12.0 * 640 * 480 / kMb, 0.1) << "bearings and tiles";
  EXPECT_NEAR(MegabytesOf(large, {cube}) - plain, 8.0 * 4096 * 4096 / kMb, 0.1) << "bearings";
}

TEST(TrackerMemory, CountsAModelAndItsSearchTreeOnceForAllObjects) {
  ObjectModel dense = *MakeCube(0.2);
  const CameraModel camera = MakeCamera(640, 480, 500.0);
  const double small = MegabytesOf(camera, Models(2, MakeCube(0.2)));
  dense.triangles.resize(1'000'000);
  const auto shared = std::make_shared<const ObjectModel>(dense);
  const double once = MegabytesOf(camera, Models(1, shared)) - MegabytesOf(camera, {MakeCube(0.2)});
  const double twice = MegabytesOf(camera, Models(2, shared)) - small;
  const double apart = MegabytesOf(camera, {shared, std::make_shared<const ObjectModel>(dense)}) - small;
  EXPECT_GT(once, 160.0 + 12.0) << "a tree, and the triangles";
  EXPECT_NEAR(twice, once, 1.0);
  EXPECT_NEAR(apart, 2.0 * once, 1.0);
}

TEST(TrackerMemory, OfAModelWithManyLinesIsThatOfItsVisibleOnes) {
  const CameraModel camera = MakeCamera(640, 480, 500.0);
  ObjectModel model = *MakeCube(0.2);
  model.lines.resize(1000, model.lines[0]);
  const double thousand = MegabytesOf(camera, {std::make_shared<const ObjectModel>(model)});
  model.lines.resize(100'000, model.lines[0]);
  const double many = MegabytesOf(camera, {std::make_shared<const ObjectModel>(model)});
  EXPECT_LT(many, thousand + 45.0) << "400 bytes for each line of the model itself";
}

TEST(TrackerMemory, CountsElements) {
  const CameraModel camera = MakeCamera(640, 480, 500.0);
  ObjectModel model = *MakeCube(0.2);
  const double straight = MegabytesOf(camera, {std::make_shared<const ObjectModel>(model)});
  model.surface.regions.resize(3);
  EXPECT_GT(MegabytesOf(camera, {std::make_shared<const ObjectModel>(model)}), straight + 5.0);
}

// A sensor with fewer than 640 columns has a second one, with a copy of the 200,000 events of a search.
TEST(TrackerMemory, CountsTheSecondLineDetectorOfASmallSensor) {
  const double two = MegabytesOf(MakeCamera(638, 480, 500.0), {MakeCube(0.2)});
  const double one = MegabytesOf(MakeCamera(640, 480, 500.0), {MakeCube(0.2)});
  EXPECT_GT(two, one + 2.0 + 200e3 * sizeof(PixelEvent) / kMb - 0.1);
}

// Three of the five views are those in which a lost object is searched for; the other two may still have a tracker.
TEST(TrackerMemory, CountsATrackerInEachViewOfAFisheyeLens) {
  CameraModel camera = MakeCamera(1280, 720, 640.0 / (75.0 / kDegreesPerRadian));
  camera.lens_model = LensModel::kFisheye;
  const std::vector<LensView> views = MakeLensViews(camera);
  ASSERT_EQ(views.size(), 5u);
  const Models cube = {MakeCube(0.2)};
  const TrackerMemory memory = EstimateTrackerMemory(camera, cube, TrackerOptions());
  for (const LensView& view : views) {
    const TrackerMemory of_view = EstimateTrackerMemory(view.camera, cube, TrackerOptions());
    EXPECT_GE(memory.max_bytes, 5 * of_view.max_bytes);
    EXPECT_GE(memory.max_state_bytes, 5 * of_view.max_state_bytes);
  }
}

TEST(TrackerMemory, OfALargeSensorIsFarBelowATableOfItsPixels) {
  const CameraModel large = MakeCamera(4096, 4096, 3000.0);
  EXPECT_LT(MegabytesOf(large, {MakeCube(0.2)}), 100.0);
}

}  // namespace
}  // namespace evpose
