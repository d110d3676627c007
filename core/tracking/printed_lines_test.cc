// SPDX-License-Identifier: Apache-2.0

// Tracking of an object with printed lines that its model lacks, on ideal events.
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

constexpr double kPrintedEdgeM = 0.15;

// A cube with four printed lines in each direction on each face. They are at least 35 mm from the parallel edges and
// thus outside the gates of these edges, except on a face that is seen at a grazing angle.
ObjectModel PrintedCube() {
  constexpr double kHalfLengthM = 0.05;
  ObjectModel cube = *testing::MakeCube(kPrintedEdgeM);
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {-1.0, 1.0}) {
      const Eigen::Vector3d normal = side * Eigen::Vector3d::Unit(axis);
      for (const int step : {1, 2}) {
        const Eigen::Vector3d along = kHalfLengthM * Eigen::Vector3d::Unit((axis + step) % 3);
        for (const double across_m : {-0.04, -0.015, 0.015, 0.04}) {
          const Eigen::Vector3d middle =
              0.5 * kPrintedEdgeM * normal + across_m * Eigen::Vector3d::Unit((axis + 3 - step) % 3);
          cube.lines.push_back({middle - along, middle + along, {normal}, EdgeKind::kPainted});
        }
      }
    }
  }
  return cube;
}

struct PrintedRun {
  std::vector<PoseEstimate> estimates;
  std::unique_ptr<Tracker> tracker;

  size_t NumTracking() const {
    return std::count_if(estimates.begin(), estimates.end(),
                         [](const PoseEstimate& estimate) { return estimate.state == TrackState::kTracking; });
  }
};

// Tracks the cube without its print from a given pose.
PrintedRun FollowWithoutPrint(const std::vector<Event>& events) {
  PrintedRun run;
  run.tracker = Tracker::Create(Cube(kPrintedEdgeM), kCamera, WithoutInitialization(), kStart).value();
  run.tracker->AddEvents(events, run.estimates);
  run.tracker->Finish(run.estimates);
  return run;
}

const testing::Motion kPrintedMotion = testing::ConstantTwist(kStart, Twist(0.25, 0.1, 0.05, 0.8, -0.6, 0.4));

TEST(PrintedLinesTest, DoNotContradictAPose) {
  constexpr int64_t kDurationUs = 200'000;
  const std::vector<Event> events = EventsOf(PrintedCube(), kPrintedMotion, 0, kDurationUs);
  ASSERT_GT(events.size(), 2 * EventsOf(*Cube(kPrintedEdgeM), kPrintedMotion, 0, kDurationUs).size());
  const PrintedRun run = FollowWithoutPrint(events);
  ASSERT_GT(run.estimates.size(), 150u);
  EXPECT_EQ(run.tracker->losses(), 0u);
  const auto first = std::find_if(run.estimates.begin(), run.estimates.end(),
                                  [](const PoseEstimate& estimate) { return estimate.state == TrackState::kTracking; });
  ASSERT_NE(first, run.estimates.end());
  EXPECT_LT(first->t_us, 30'000);
  for (auto estimate = first; estimate != run.estimates.end(); ++estimate) {
    EXPECT_EQ(estimate->state, TrackState::kTracking) << estimate->t_us;
    const RigidTransform truth = kPrintedMotion(1e-6 * static_cast<double>(estimate->t_us));
    EXPECT_LT((estimate->camera_from_object.translation_m - truth.translation_m).norm(), 4e-3) << estimate->t_us;
    EXPECT_LT(RotationAngle(estimate->camera_from_object.rotation, truth.rotation), 0.02) << estimate->t_us;
  }
}

TEST(PrintedLinesTest, DoNotSupportAPose) {
  ObjectModel print = PrintedCube();
  std::erase_if(print.lines, [](const ModelLine& line) { return line.kind != EdgeKind::kPainted; });
  const std::vector<Event> events = EventsOf(print, kPrintedMotion, 0, 40'000);
  ASSERT_GT(events.size(), 10'000u);
  EXPECT_EQ(FollowWithoutPrint(events).NumTracking(), 0u);
}

}  // namespace
}  // namespace evpose
