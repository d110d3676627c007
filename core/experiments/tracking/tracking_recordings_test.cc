// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_recordings.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <vector>

namespace evpose {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class TrackingRecordingsTest : public ::testing::Test {
 protected:
  TrackingRecordingsTest() : run_(*SimulationPreset("cube", "vga", 2.0)) {
    run_.duration_us = 40'000;
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    directory_ = (fs::path(::testing::TempDir()) / (std::string("evpose_recordings_") + info->name())).string();
    fs::remove_all(directory_);
  }

  // Returns the events, and whether they were simulated.
  std::vector<Event> Play(bool* is_simulated = nullptr, absl::Status* status = nullptr) {
    std::vector<Event> events;
    bool asked = false;
    const absl::Status played = PlayRun(
        run_, directory_,
        [&](absl::Span<const Event> batch) {
          events.insert(events.end(), batch.begin(), batch.end());
          return absl::OkStatus();
        },
        [&](double) { return asked = true; });
    if (is_simulated != nullptr) *is_simulated = asked;
    if (status != nullptr) {
      *status = played;
    } else {
      EXPECT_TRUE(played.ok()) << played;
    }
    return events;
  }

  SimulationOptions run_;
  std::string directory_;
};

TEST_F(TrackingRecordingsTest, KeptEventsAreTheSimulatedOnes) {
  bool is_simulated = false;
  const std::vector<Event> first = Play(&is_simulated);
  EXPECT_TRUE(is_simulated);
  const std::vector<Event> again = Play(&is_simulated);
  EXPECT_FALSE(is_simulated);
  EXPECT_EQ(first, again);
  EXPECT_GT(first.size(), 1000u);
  directory_.clear();
  EXPECT_EQ(Play(), first);
}

TEST_F(TrackingRecordingsTest, ARecordingOfOtherOptionsIsReplaced) {
  Play();
  run_.seed = 2;
  bool is_simulated = false;
  const std::vector<Event> other = Play(&is_simulated);
  EXPECT_TRUE(is_simulated);
  EXPECT_EQ(Play(&is_simulated), other);
  EXPECT_FALSE(is_simulated);
}

TEST_F(TrackingRecordingsTest, ACutRecordingIsMadeAgain) {
  const std::vector<Event> whole = Play();
  const fs::path recording = fs::path(directory_) / "recording.raw";
  fs::resize_file(recording, fs::file_size(recording) - 2);
  bool is_simulated = false;
  EXPECT_EQ(Play(&is_simulated), whole);
  EXPECT_TRUE(is_simulated);
}

TEST_F(TrackingRecordingsTest, ARecordingOfFewerEventsIsAnError) {
  Play();
  // The file keeps its length, but has no events in its second half.
  const fs::path recording = fs::path(directory_) / "recording.raw";
  const auto size = fs::file_size(recording);
  fs::resize_file(recording, size / 4 * 2);
  fs::resize_file(recording, size);
  absl::Status status;
  Play(nullptr, &status);
  EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(std::string(status.message()), HasSubstr(directory_));
}

TEST_F(TrackingRecordingsTest, StopsAndLeavesNothing) {
  const auto never = [](absl::Span<const Event>) { return absl::InternalError("not reached"); };
  const absl::Status status = PlayRun(run_, directory_, never, [](double) { return false; });
  EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
  EXPECT_FALSE(fs::exists(fs::path(directory_) / "recording.raw"));
  EXPECT_FALSE(fs::exists(fs::path(directory_) / "simulation.txt"));
}

}  // namespace
}  // namespace evpose
