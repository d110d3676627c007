// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/first_pose_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/experiments/frustum_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

// The frustum of a cone, which has no straight edge.
std::string ConeObj() { return FrustumObj(64, 55.0, 30.0, 90.0); }

class FirstPoseBenchTest : public testing::Test {
 protected:
  FirstPoseBenchOptions OptionsFor(const std::string& name, const std::string& content) const {
    const std::string path = directory_.File(name);
    EXPECT_TRUE(WriteFile(path, content).ok());
    FirstPoseBenchOptions options;
    options.bench.models = {{name, path, 1e-3, ""}};
    options.bench.num_seeds = 1;
    options.bench.duration_us = 200'000;
    options.bench.camera = "vga";
    options.num_starts = 2;
    options.watch_us = 120'000;
    return options;
  }

  const TemporaryDirectory directory_;
};

TEST_F(FirstPoseBenchTest, FindsAModelWithoutStraightEdges) {
  std::vector<FirstPoseBenchRow> rows;
  const absl::Status status =
      RunFirstPoseBench(OptionsFor("cone.obj", ConeObj()), [&](const FirstPoseBenchRow& row) { rows.push_back(row); });
  ASSERT_TRUE(status.ok()) << status;
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_EQ(rows[0].error, "");
  EXPECT_EQ(rows[0].num_views, 31u) << "a meridian";
  ASSERT_EQ(rows[0].starts.size(), 2u);
  ASSERT_EQ(rows[0].trials.size(), 2u);
  for (const FirstPoseStart& start : rows[0].starts) {
    EXPECT_GT(start.moved_us, 0);
    EXPECT_TRUE(start.is_found()) << start.right_us;
    EXPECT_GE(start.searches, 1u);
  }
  EXPECT_EQ(rows[0].starts[1].t_start_us - rows[0].starts[0].t_start_us, 80'000);
  for (const SearchTrial& trial : rows[0].trials) {
    EXPECT_TRUE(trial.has_moved);
    EXPECT_GE(trial.rank, 0);
    EXPECT_EQ(trial.scores.size(), static_cast<size_t>(trial.num_poses));
  }
}

TEST_F(FirstPoseBenchTest, EveryPoseInTheRecordingsOfAnotherModelIsWrong) {
  FirstPoseBenchOptions options = OptionsFor("cone.obj", ConeObj());
  // The same surface under another name, so that poses are found.
  options.shown = OptionsFor("twin.obj", ConeObj()).bench.models[0];
  std::vector<FirstPoseBenchRow> rows;
  const absl::Status status = RunFirstPoseBench(options, [&](const FirstPoseBenchRow& row) { rows.push_back(row); });
  ASSERT_TRUE(status.ok()) << status;
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_EQ(rows[0].model.name, "cone.obj");
  for (const FirstPoseStart& start : rows[0].starts) {
    EXPECT_FALSE(start.is_found());
    EXPECT_GT(start.wrong_at_us, 0);
    EXPECT_GT(start.longest_wrong_us, 10'000);
  }
  for (const SearchTrial& trial : rows[0].trials) EXPECT_EQ(trial.rank, -1);
}

TEST_F(FirstPoseBenchTest, ModelThatCannotBePreparedHasTheReason) {
  std::vector<FirstPoseBenchRow> rows;
  const FirstPoseBenchOptions options = OptionsFor("broken.obj", "v 1 2 3\nf 1 2 3\n");
  ASSERT_TRUE(RunFirstPoseBench(options, [&](const FirstPoseBenchRow& row) { rows.push_back(row); }).ok());
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_THAT(rows[0].error, HasSubstr("broken.obj"));
}

TEST_F(FirstPoseBenchTest, ValidatesItsOptions) {
  FirstPoseBenchOptions options = OptionsFor("cone.obj", "");
  EXPECT_TRUE(options.Validate().ok());
  options.watch_us = 300'000;
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("watch_us"));
  options.watch_us = 100'000;
  options.num_starts = 0;
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("num_starts"));
  options.num_starts = 1;
  options.shown = options.bench.models[0];
  options.explains = true;
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("explains"));
}

}  // namespace
}  // namespace evpose
