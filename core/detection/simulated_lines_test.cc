// SPDX-License-Identifier: Apache-2.0

// Compares both detectors with the visible model lines, on simulated recordings of the five objects with 5 % noise
// events.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <string>
#include <tuple>

#include "core/baselines/first_pose/lsd_detector.h"
#include "core/detection/detection_trial_testing.h"
#include "core/detection/plane_detector.h"
#include "core/numerics/random.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

using testing::DetectionScore;
using testing::EventsUntil;
using testing::ObjectRecording;
using testing::RecordObject;
using testing::Score;

constexpr SensorGeometry kSensor = {1280, 720};
constexpr int kRecordings = 10;
constexpr int kTimesPerRecording = 2;
constexpr int64_t kDurationUs = 60'000;
constexpr size_t kMaxEvents = 100'000;

struct BothScores {
  DetectionScore planes;
  DetectionScore lsd;
};

// Scores both detectors at random times of recordings with different paths and attitudes. For both, the required motion
// of a line counts from the beginning of the plane detector's stretch.
BothScores ScoreObject(const std::string& object, double speed_scale) {
  const auto planes = MakePlaneLineDetector({}, kSensor).value();
  const auto lsd = MakeLsdLineDetector({}, kSensor).value();
  BothScores scores;
  Random random(17);
  for (int k = 0; k < kRecordings; ++k) {
    const ObjectRecording recording = RecordObject(object, speed_scale, kDurationUs, 1000 + k);
    for (int time = 0; time < kTimesPerRecording; ++time) {
      const int64_t t_us =
          recording.truth.front().t_us + static_cast<int64_t>(random.Uniform(0.85, 0.999) * kDurationUs);
      const absl::Span<const PixelEvent> events = EventsUntil(recording, t_us, kMaxEvents);
      const LineDetection found = planes->Detect(events);
      scores.planes.Add(Score(recording, found, found.t_begin_us));
      scores.lsd.Add(Score(recording, lsd->Detect(events), found.t_begin_us));
    }
  }
  return scores;
}

double ShareBeyond(const DetectionScore& score, double limit_px) {
  size_t count = 0;
  for (const double beyond : score.beyond_end_px) count += beyond > limit_px;
  return static_cast<double>(count) / static_cast<double>(score.beyond_end_px.size());
}

class SimulatedLines : public ::testing::TestWithParam<std::tuple<const char*, double>> {};

TEST_P(SimulatedLines, PlanesFindTheObject) {
  const auto [object, speed_scale] = GetParam();
  const BothScores scores = ScoreObject(object, speed_scale);
  const DetectionScore& planes = scores.planes;
  RecordProperty("planes_recall", std::to_string(planes.recall()));
  RecordProperty("planes_precision", std::to_string(planes.precision()));
  RecordProperty("planes_median_error_px", std::to_string(UpperMedianOr(planes.error_px, 0.0)));
  RecordProperty("lsd_recall", std::to_string(scores.lsd.recall()));
  RecordProperty("lsd_precision", std::to_string(scores.lsd.precision()));
  RecordProperty("lsd_median_error_px", std::to_string(UpperMedianOr(scores.lsd.error_px, 0.0)));

  EXPECT_GT(planes.visible_px, 10'000.0);  // the trial has visible lines
  EXPECT_GE(planes.recall(), 0.88);
  EXPECT_GE(planes.precision(), 0.90);
  EXPECT_LE(UpperMedianOr(planes.error_px, 0.0), 0.45);
  EXPECT_LE(std::abs(UpperMedianOr(planes.offset_px, 0.0)), 0.3);
  EXPECT_LE(ShareBeyond(planes, 5.0), 0.05);  // lines that extend beyond a corner
  // The plane detector finds more lines than LSD, more precisely, and with more accurate ends.
  EXPECT_GT(planes.recall(), scores.lsd.recall());
  EXPECT_GT(planes.precision(), scores.lsd.precision());
  EXPECT_LT(UpperMedianOr(planes.error_px, 0.0), UpperMedianOr(scores.lsd.error_px, 0.0));
  EXPECT_GT(scores.lsd.recall(), 0.5);
}

INSTANTIATE_TEST_SUITE_P(Objects, SimulatedLines,
                         ::testing::Combine(::testing::Values("cube", "cuboid", "planar", "book", "spacecraft"),
                                            ::testing::Values(1.0)),
                         [](const auto& object) { return std::string(std::get<0>(object.param)); });

}  // namespace
}  // namespace evpose
