// SPDX-License-Identifier: Apache-2.0

// Tests that decoding and tracking allocate no memory after the first windows.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <new>
#include <string>
#include <vector>

#include "core/events/decoder.h"
#include "core/experiments/speed/speed_recordings.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"
#include "tests/bench/allocation_counter.h"

namespace evpose::bench {
namespace {

// Prevents the compiler from removing an allocation whose result is not used.
void Use(const void* memory) { asm volatile("" : : "g"(memory) : "memory"); }

TEST(AllocationCounterTest, CountsEveryWay) {
  size_t count = 0;
  const auto counts = [&count](const AllocationCounter& counter) {
    const bool is_more = counter.count() > count;
    count = counter.count();
    return is_more;
  };
  const AllocationCounter counter;
  EXPECT_EQ(counter.count(), 0u);
  const auto number = std::make_unique<int>(1);
  Use(number.get());
  EXPECT_TRUE(counts(counter)) << "operator new";
  struct alignas(64) Wide {
    char bytes[64];
  };
  const auto wide = std::make_unique<Wide>();
  Use(wide.get());
  EXPECT_TRUE(counts(counter)) << "operator new with an alignment";
  const Eigen::MatrixXd matrix(20, 20);
  Use(matrix.data());
  EXPECT_TRUE(counts(counter)) << "Eigen";
  std::vector<int> list(1000);
  Use(list.data());
  EXPECT_TRUE(counts(counter)) << "a list";
  list.clear();
  list.resize(1000);
  EXPECT_FALSE(counts(counter)) << "existing capacity is reused";
  EXPECT_NE(counter.FirstOrigin(), "");
}

class TrackingAllocations : public ::testing::TestWithParam<const char*> {
 protected:
  static constexpr int64_t kWarmUpUs = 150'000;
  static constexpr int64_t kDurationUs = 500'000;
  static constexpr size_t kPieceBytes = size_t{16} * 1024;
};

TEST_P(TrackingAllocations, NoneForAWindow) {
  const SpeedRecording recording = MakeSpeedRecording(std::string(GetParam()), kDurationUs).value();
  const std::vector<uint8_t> bytes = EncodeRecording(recording, Encoding::kEvt3).value();
  const auto decoder = MakeEventDecoder(Encoding::kEvt3, recording.geometry).value();
  // A rival is a new track with tables of its own.
  TrackerOptions options;
  options.initialization.tilt_view_rad = 3.0;
  const auto tracker =
      Tracker::Create(recording.model, recording.camera, options, recording.initial_camera_from_object).value();
  const int64_t warm_us = recording.events.front().t_us + kWarmUpUs;
  DecodedEvents decoded;
  // More than the number of windows.
  std::vector<PoseEstimate> poses;
  poses.reserve(2 * kDurationUs / WindowOptions().min_interval_us);
  std::unique_ptr<AllocationCounter> counter;
  size_t warm_poses = 0;
  const absl::Span<const uint8_t> all = bytes;
  for (size_t begin = 0; begin < all.size(); begin += kPieceBytes) {
    if (counter == nullptr && !poses.empty() && poses.back().t_us > warm_us) {
      warm_poses = poses.size();
      counter = std::make_unique<AllocationCounter>();
    }
    decoded.events.clear();
    decoded.time_marks.clear();
    decoder->Decode(all.subspan(begin, kPieceBytes), decoded);
    tracker->AddEvents(decoded.events, poses);
  }
  ASSERT_NE(counter, nullptr);
  EXPECT_EQ(counter->count(), 0u) << "the first one is at\n" << counter->FirstOrigin();
  EXPECT_GT(poses.size(), warm_poses + 300);
  for (size_t i = warm_poses; i < poses.size(); ++i) EXPECT_EQ(poses[i].state, TrackState::kTracking) << i;
}

INSTANTIATE_TEST_SUITE_P(MillionEventsPerSecond, TrackingAllocations, ::testing::Values("1", "10"));

}  // namespace
}  // namespace evpose::bench
