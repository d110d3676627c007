// SPDX-License-Identifier: Apache-2.0
#include "core/association/background.h"

#include <gtest/gtest.h>

#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr double kWindowS = 0.002;
constexpr double kNoiseHz = 5.0;

class BackgroundTest : public ::testing::Test {
 protected:
  // Adds `per_s` events spread evenly over a rectangle, except those in tiles with lines.
  void Add(double per_s, double left, double top, double right, double bottom, double events_per_sample = 1.0) {
    const uint32_t count = random_.Poisson(per_s * kWindowS);
    for (uint32_t i = 0; i < count; ++i) {
      const double u_px = random_.Uniform(left, right), v_px = random_.Uniform(top, bottom);
      const uint32_t tile = grid_.TileOf(u_px, v_px);
      if (grid_.Lines(tile).empty()) background_.Count(tile, events_per_sample);
    }
  }
  void AddNoise(double hz_per_px, double events_per_sample = 1.0) {
    Add(hz_per_px * 640 * 480, 0.0, 0.0, 640.0, 480.0, events_per_sample);
  }

  const CameraModel camera_ = testing::MakeCamera(640, 480, 500.0);
  TileGrid grid_{camera_};
  BackgroundRate background_{camera_};
  Random random_{3};
};

TEST_F(BackgroundTest, MotionInAPartOfTheImageIsNotBackground) {
  for (int i = 0; i < 20; ++i) {
    AddNoise(kNoiseHz);
    Add(2e6, 100.0, 100.0, 300.0, 300.0);  // ten times denser
    background_.CloseWindow(grid_, kWindowS);
  }
  EXPECT_NEAR(background_.hz_per_px(), kNoiseHz, 0.2 * kNoiseHz);
}

TEST_F(BackgroundTest, TilesNearLinesAreLeftOut) {
  // Vertical lines every 32 px: half of the image is near one of them.
  std::vector<ImageLine> lines(20);
  for (size_t k = 0; k < lines.size(); ++k) {
    lines[k].p1_px = {32.0 * static_cast<double>(k) + 4.0, 0.0};
    lines[k].direction = {0.0, 1.0};
    lines[k].length_px = 480.0;
  }
  grid_.Build(lines, 4.0);
  AddNoise(kNoiseHz);
  background_.CloseWindow(grid_, kWindowS);
  EXPECT_NEAR(background_.hz_per_px(), kNoiseHz, 0.2 * kNoiseHz);
}

TEST_F(BackgroundTest, FollowsABurstAtOnceAndItsEndSoon) {
  for (int i = 0; i < 50; ++i) {
    AddNoise(0.1);
    background_.CloseWindow(grid_, kWindowS);
  }
  EXPECT_LT(background_.hz_per_px(), 0.2);
  AddNoise(20.0);
  background_.CloseWindow(grid_, kWindowS);
  EXPECT_NEAR(background_.hz_per_px(), 20.0, 4.0);
  for (int i = 0; i < 5; ++i) {
    AddNoise(5.0);
    background_.CloseWindow(grid_, kWindowS);
  }
  EXPECT_NEAR(background_.hz_per_px(), 5.0, 1.0);
}

TEST_F(BackgroundTest, CountsTheEventsThatSamplesRepresent) {
  AddNoise(kNoiseHz, 4.0);
  background_.CloseWindow(grid_, kWindowS);
  EXPECT_NEAR(background_.hz_per_px(), 4.0 * kNoiseHz, kNoiseHz);
}

}  // namespace
}  // namespace evpose
