// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/check_lines.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose {
namespace {

using testing::HasSubstr;

ObjectModel Lines(const std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>>& ends) {
  ObjectModel model;
  for (const auto& [p1, p2] : ends) model.lines.push_back({p1, p2, {}});
  model.diameter_m = 1.0;
  return model;
}

std::string Refusal(const ObjectModel& model) {
  const absl::Status status = CheckLinesDeterminePose(model);
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  return std::string(status.message());
}

TEST(CheckLinesTest, ThreeLinesInGeneralAreEnough) {
  EXPECT_TRUE(
      CheckLinesDeterminePose(Lines({{{0, 0, 0}, {1, 0, 0}}, {{0, 0, 0}, {0, 1, 0}}, {{1, 0, 0}, {1, 0, 1}}})).ok());
  EXPECT_TRUE(
      CheckLinesDeterminePose(Lines({{{0, 0, 0}, {1, 0, 0}}, {{0, 1, 0}, {1, 1, 0}}, {{0, 0, 0}, {0, 1, 0}}})).ok());
}

TEST(CheckLinesTest, CollinearPiecesAndDuplicatesAreOneLine) {
  EXPECT_THAT(Refusal(Lines({})), HasSubstr("0 distinct lines"));
  EXPECT_THAT(Refusal(Lines({{{0, 0, 0}, {.4, 0, 0}}, {{1, 0, 0}, {.5, 0, 0}}, {{0, 0, 0}, {0, 1, 0}}})),
              HasSubstr("2 distinct lines"));
  EXPECT_THAT(Refusal(Lines({{{0, 0, 0}, {1, 0, 0}}, {{1, 0, 0}, {0, 0, 0}}, {{0, 0, 0}, {0, 1, 0}}})),
              HasSubstr("2 distinct lines"));
}

TEST(CheckLinesTest, ParallelLinesGiveNoPose) {
  EXPECT_THAT(Refusal(Lines({{{0, 0, 0}, {1, 0, 0}}, {{0, 1, 0}, {1, 1, 0}}, {{1, 0, 1}, {0, 0, 1}}})),
              HasSubstr("parallel"));
}

TEST(CheckLinesTest, LinesThroughOnePointGiveNoDistance) {
  EXPECT_THAT(Refusal(Lines({{{0, 0, 0}, {1, 0, 0}}, {{0, 0, 0}, {0, 1, 0}}, {{0, 0, .2}, {0, 0, 1}}})),
              HasSubstr("meet in one point"));
}

}  // namespace
}  // namespace evpose
