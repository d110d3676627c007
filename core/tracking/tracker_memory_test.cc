// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/tracker_memory.h"

#include <gtest/gtest.h>

#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/tracker_options.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakeCube;
using Models = std::vector<std::shared_ptr<const ObjectModel>>;

constexpr double kMb = 1e6;

double MegabytesOf(const CameraModel& camera, const Models& models) {
  return static_cast<double>(EstimateTrackerMemory(camera, models, TrackerOptions()).max_bytes) / kMb;
}

TEST(TrackerMemory, GrowsWithPixelsObjectsAndDistortion) {
  const std::shared_ptr<const ObjectModel> cube = MakeCube(0.2);
  const CameraModel small = MakeCamera(640, 480, 500.0);
  CameraModel large = MakeCamera(4096, 4096, 3000.0);
  const double one = MegabytesOf(small, {cube});
  EXPECT_GT(MegabytesOf(large, {cube}), one + 4.0) << "two bits per pixel of the history, and grids";
  EXPECT_GT(MegabytesOf(small, Models(16, cube)), one + 15 * 5.0) << "the stored windows of each object";
  const double plain = MegabytesOf(large, {cube});
  large.distortion[0] = -0.1;
  EXPECT_NEAR(MegabytesOf(large, {cube}) - plain, 8.0 * 4096 * 4096 / kMb, 0.1);
}

TEST(TrackerMemory, CountsTheModelOnceAndItsTreesForEachObject) {
  ObjectModel dense = *MakeCube(0.2);
  const CameraModel camera = MakeCamera(640, 480, 500.0);
  const double small = MegabytesOf(camera, Models(2, MakeCube(0.2)));
  dense.triangles.resize(1'000'000);
  const auto shared = std::make_shared<const ObjectModel>(dense);
  const double twice = MegabytesOf(camera, Models(2, shared)) - small;
  const double apart = MegabytesOf(camera, {shared, std::make_shared<const ObjectModel>(dense)}) - small;
  EXPECT_GT(twice, 2 * 100.0);
  EXPECT_GT(apart, twice + 100.0);
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

TEST(TrackerMemory, OfALargeSensorIsFarBelowATableOfItsPixels) {
  const CameraModel large = MakeCamera(4096, 4096, 3000.0);
  EXPECT_LT(MegabytesOf(large, {MakeCube(0.2)}), 100.0);
}

}  // namespace
}  // namespace evpose
