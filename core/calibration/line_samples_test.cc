// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/line_samples.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/association/visible_edges.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// A cube with sides of about 30 px in the image of a small sensor, and its events during a motion of 2 px.
class SmallCube {
 public:
  SmallCube()
      : model_(testing::MakeCube(0.15)),
        camera_(testing::MakeCamera(240, 180, 200.0)),
        edges_(*model_, TrackerOptions().visibility, TrackerOptions().elements) {
    interval_.t_us = 10'000;
    interval_.duration_us = 20'000;
    interval_.camera_from_object = testing::MakePose({0.0, 0.0, 1.0}, {0.6, 0.5, 0.2});
    interval_.twist << 0.4, 0.3, 0.0, 0.0, 0.0, 0.0;
    RigidTransform start = interval_.camera_from_object;
    start.translation_m -= 0.01 * interval_.twist.head<3>();
    interval_.events =
        testing::MakeIdealEvents(*model_, camera_, testing::ConstantTwist(start, interval_.twist),
                                 {.events_per_px2 = 2.0, .clutter_per_s = 5'000, .duration_us = interval_.duration_us});
  }

  std::vector<LineSample> Sample(const LineSampleOptions& options) const {
    std::vector<LineSample> samples;
    LineSampler(camera_, edges_, options).Sample(interval_, 3, samples);
    return samples;
  }
  // Distance of a sample from its line, across it, pixels.
  double ErrorPx(const LineSample& sample) const {
    const Vector2d expected = camera_.Distort(camera_.Project(interval_.camera_from_object * sample.point));
    return std::abs(sample.normal.dot(sample.pixel - expected));
  }

 private:
  const std::shared_ptr<const ObjectModel> model_;
  const CameraModel camera_;
  const ModelEdges edges_;
  CalibrationInterval interval_;
};

TEST(LineSamplerTest, ShortLinesAreMeasuredInShortPiecesNearOtherLines) {
  const SmallCube cube;
  const std::vector<LineSample> samples = cube.Sample({});
  EXPECT_GE(samples.size(), 12u);  // what an interval needs (RemoveWeakIntervals)
  for (const LineSample& sample : samples) {
    EXPECT_EQ(sample.interval, 3);
    EXPECT_LT(cube.ErrorPx(sample), 0.6) << "line " << sample.line;
  }
  // At the distance from other lines that long lines have, the middles of the lines alone are left.
  EXPECT_LT(cube.Sample({.min_gate_if_sparse_px = 2.0}).size(), samples.size());
}

// Fewer events for each piece do not make the samples fewer.
TEST(LineSamplerTest, TheCutWithTheMostSamplesIsUsed) {
  const SmallCube cube;
  const size_t usual = cube.Sample({.min_samples = 0}).size();
  EXPECT_GT(usual, 0u);
  EXPECT_GE(cube.Sample({.min_samples = 1000, .min_events_if_sparse = 1e6}).size(), usual);
}

}  // namespace
}  // namespace evpose
