// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/real_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/simulation/simulator.h"

namespace evpose {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class RealBenchTest : public testing::Test {
 protected:
  // A folder with a simulated recording and its reference, truth.tum.
  void AddRecording(const std::string& folder, const char* object, int64_t duration_us) {
    SimulationOptions simulation = *SimulationPreset(object, "vga", 2.0);
    simulation.duration_us = duration_us;
    ASSERT_TRUE(SimulateToDirectory(simulation, Path(folder)).ok());
  }
  std::string Path(const std::string& name) const { return directory_.File(name); }
  RealBenchOptions Options() const {
    RealBenchOptions options;
    options.directory = directory_.path();
    options.num_starts = 2;
    options.max_duration_us = 0;
    return options;
  }
  absl::Status Run(const RealBenchOptions& options) {
    RealBenchListener listener;
    listener.on_row = [this](const RealBenchRow& row) { rows_.push_back(row); };
    listener.on_foreign = [this](const ForeignBenchRow& row) { foreign_.push_back(row); };
    return RunRealBench(options, listener);
  }
  // The message of a run that fails with this code.
  std::string Failure(absl::StatusCode code) {
    const absl::Status status = Run(Options());
    EXPECT_EQ(status.code(), code) << status;
    return std::string(status.message());
  }

  // Cases run in parallel processes, so that each has its own directory.
  const TemporaryDirectory directory_;
  std::vector<RealBenchRow> rows_;
  std::vector<ForeignBenchRow> foreign_;
};

TEST_F(RealBenchTest, FindsTracksAndSearchesForAbsentObjects) {
  AddRecording("cube", "cube", 200'000);
  AddRecording("craft", "spacecraft", 60'000);
  fs::create_directory(Path("others"));
  fs::rename(Path("craft/recording.raw"), Path("others/craft.raw"));
  fs::remove_all(Path("craft"));
  RealBenchOptions options = Options();
  options.num_absent_starts = 3;
  const absl::Status status = Run(options);
  ASSERT_TRUE(status.ok()) << status;

  ASSERT_EQ(rows_.size(), 1u);
  EXPECT_EQ(rows_[0].recording, "cube");
  for (const std::vector<RealRun>* runs : {&rows_[0].searched, &rows_[0].given}) {
    ASSERT_EQ(runs->size(), 2u);
    for (const RealRun& run : *runs) {
      EXPECT_TRUE(run.is_found());
      EXPECT_FALSE(run.is_first_wrong);
      EXPECT_LT(run.wait_s, 0.1);
      EXPECT_GT(run.compute_to_tracking_s, 0.0);
      EXPECT_GE(run.compute_s, run.compute_to_tracking_s);
      EXPECT_EQ(run.longest_wrong_s, 0.0);
      EXPECT_GT(run.right_ratio, 0.5);
      EXPECT_LT(run.median_error_px, 1.0);
      EXPECT_EQ(run.losses, 0u);
    }
    const auto span_s = [&](int i) { return (*runs)[i].duration_s; };
    EXPECT_NEAR(span_s(1) / span_s(0), 1.0 - 0.75 / 2, 1e-4) << "the starts are spread over three quarters";
    const RealSummary summary = SummariseRealRuns(*runs);
    EXPECT_EQ(summary.num_found, 2);
    EXPECT_EQ(summary.num_wrong, 0);
    EXPECT_GE(summary.worst_wait_s, summary.median_wait_s);
  }

  ASSERT_EQ(foreign_.size(), 3u);
  for (const ForeignBenchRow& row : foreign_) {
    EXPECT_EQ(row.recording, "others/craft");
    EXPECT_EQ(row.object, "cube");
    EXPECT_FALSE(row.run.is_found());
    EXPECT_EQ(row.run.tracking_s, 0.0);
  }
  EXPECT_NEAR(foreign_[2].run.duration_s / foreign_[0].run.duration_s, 0.5, 1e-4);
}

TEST_F(RealBenchTest, TheSameObjectIsNotForeignToItself) {
  AddRecording("first", "cube", 30'000);
  fs::copy(Path("first"), Path("second"));
  RealBenchOptions options = Options();
  options.has_starts = false;
  ASSERT_TRUE(Run(options).ok());
  EXPECT_TRUE(foreign_.empty());
  EXPECT_EQ(ReadRealDirectory(directory_.path())->objects.size(), 1u);
}

TEST_F(RealBenchTest, WrongReferenceIsCountedAsAWrongPose) {
  AddRecording("cube", "cube", 150'000);
  Trajectory reference = *ReadTumTrajectory(Path("cube/truth.tum"));
  for (StampedPose& pose : reference) pose.camera_from_object.translation_m.x() += 0.05;
  ASSERT_TRUE(WriteTumTrajectory(Path("cube/truth.tum"), reference).ok());
  RealBenchOptions options = Options();
  options.num_starts = 1;
  ASSERT_TRUE(Run(options).ok());
  ASSERT_EQ(rows_.size(), 1u);
  const RealRun& run = rows_[0].searched[0];
  ASSERT_TRUE(run.is_found());
  EXPECT_TRUE(run.is_first_wrong);
  EXPECT_GT(run.longest_wrong_s, 0.05);
  EXPECT_EQ(run.right_ratio, 0.0);
}

TEST_F(RealBenchTest, MissingFilesAreNamed) {
  EXPECT_THAT(Failure(absl::StatusCode::kNotFound), HasSubstr("no folder"));
  AddRecording("cube", "cube", 30'000);
  fs::rename(Path("cube/truth.tum"), Path("truth.tum"));
  EXPECT_THAT(Failure(absl::StatusCode::kNotFound), HasSubstr("cube/recording.tum"));
  fs::rename(Path("truth.tum"), Path("cube/recording.tum"));
  fs::rename(Path("cube/camera.yaml"), Path("camera.yaml"));
  EXPECT_THAT(Failure(absl::StatusCode::kNotFound), HasSubstr("cube/camera.yaml"));
  fs::rename(Path("camera.yaml"), Path("cube/camera.yaml"));
  fs::rename(Path("cube/recording.raw"), Path("recording.raw"));
  EXPECT_THAT(Failure(absl::StatusCode::kNotFound), HasSubstr("cube/*.raw"));
}

TEST_F(RealBenchTest, ReferenceOfAnotherTimeIsAnError) {
  AddRecording("cube", "cube", 30'000);
  Trajectory reference = *ReadTumTrajectory(Path("cube/truth.tum"));
  for (StampedPose& pose : reference) pose.t_us += 10'000'000;
  ASSERT_TRUE(WriteTumTrajectory(Path("cube/truth.tum"), reference).ok());
  EXPECT_THAT(Failure(absl::StatusCode::kInvalidArgument), HasSubstr("but its reference has poses from"));
}

TEST_F(RealBenchTest, ValidatesItsOptions) {
  RealBenchOptions options = Options();
  EXPECT_TRUE(options.Validate().ok());
  options.num_starts = 0;
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("num_starts"));
  options = Options();
  options.bound_px = std::nan("");
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("bound_px"));
  options = Options();
  options.has_starts = options.has_foreign = false;
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("has_starts"));
  AddRecording("cube", "cube", 30'000);
  options = Options();
  options.names = {"teapot"};
  EXPECT_THAT(std::string(Run(options).message()), HasSubstr("known are: cube"));
}

}  // namespace
}  // namespace evpose
