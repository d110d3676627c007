// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/comparison_stage.h"

#include <gtest/gtest.h>

#include <array>
#include <string>
#include <vector>

#include "core/tracking/object/saved_state_testing.h"

namespace evpose {
namespace {

using Stage = ComparisonStage;

// The table of core/tracking/README.md, by stage; columns in the order of ComparisonInput.
constexpr std::array<std::array<Stage, kNumComparisonInputs>, kNumComparisonStages> kTable = {{
    // rival, later search, last window
    {Stage::kStarted, Stage::kCompared, Stage::kRefined},
    {Stage::kStarted, Stage::kCompared, Stage::kCompared},
    {Stage::kStarted, Stage::kCompared, Stage::kUndecided},
    {Stage::kStarted, Stage::kCompared, Stage::kUndecided},
}};

TEST(ComparisonStageTest, EveryTransitionIsThatOfTheTable) {
  for (int stage = 0; stage < kNumComparisonStages; ++stage) {
    for (int input = 0; input < kNumComparisonInputs; ++input) {
      EXPECT_EQ(NextStage(static_cast<Stage>(stage), static_cast<ComparisonInput>(input)), kTable[stage][input])
          << stage << ", input " << input;
    }
  }
}

TEST(ComparisonProgressTest, ARivalIsRefinedForEightWindowsAndComparedForEightMore) {
  ComparisonProgress progress;
  progress.Enter(ComparisonInput::kRival);
  std::vector<Stage> stages;
  for (int window = 0; window < 18; ++window) {
    stages.push_back(progress.stage());
    EXPECT_EQ(progress.is_settled(), window >= 8) << window;
    EXPECT_EQ(progress.has_been_compared(), window >= 9) << window;
    progress.OnWindow();
  }
  std::vector<Stage> expected(3, Stage::kStarted);
  expected.insert(expected.end(), 5, Stage::kRefined);
  expected.insert(expected.end(), 8, Stage::kCompared);
  expected.insert(expected.end(), 2, Stage::kUndecided);
  EXPECT_EQ(stages, expected);
}

TEST(ComparisonProgressTest, APoseOfALaterSearchIsComparedFromTheStart) {
  ComparisonProgress progress;
  EXPECT_EQ(progress.stage(), Stage::kUndecided) << "as the poses of the first search";
  progress.Enter(ComparisonInput::kLaterSearch);
  for (int window = 0; window < 8; ++window) {
    EXPECT_EQ(progress.stage(), Stage::kCompared) << window;
    EXPECT_EQ(progress.has_been_compared(), window > 0) << window;
    progress.OnWindow();
  }
  EXPECT_EQ(progress.stage(), Stage::kUndecided);
}

TEST(ComparisonProgressTest, IsSavedAsTheWindowsUntilItIsUndecided) {
  ComparisonProgress progress;
  progress.Enter(ComparisonInput::kRival);
  for (int left = 16; left >= 0; --left) {
    const std::string bytes = Saved(progress);
    EXPECT_EQ(bytes, std::string({static_cast<char>(left), 0, 0, 0}));
    ComparisonProgress loaded;
    ASSERT_TRUE(IsRestored(bytes, loaded)) << left;
    // It continues identically.
    for (ComparisonProgress original = progress; original.stage() != Stage::kUndecided;) {
      EXPECT_EQ(loaded.stage(), original.stage()) << left;
      original.OnWindow();
      loaded.OnWindow();
    }
    EXPECT_EQ(loaded.stage(), Stage::kUndecided) << left;
    progress.OnWindow();
  }
}

TEST(ComparisonProgressTest, AFactorMultipliesTheWindowsOfEachStage) {
  constexpr int kFactor = 10;
  ComparisonProgress progress(kFactor);
  progress.Enter(ComparisonInput::kRival);
  for (int window = 0; window < 16 * kFactor; ++window) {
    EXPECT_EQ(progress.is_settled(), window >= 8 * kFactor) << window;
    ComparisonProgress loaded(kFactor);
    ASSERT_TRUE(IsRestored(Saved(progress), loaded)) << window;
    EXPECT_EQ(loaded.stage(), progress.stage()) << window;
    progress.OnWindow();
  }
  EXPECT_EQ(progress.stage(), Stage::kUndecided);
}

TEST(ComparisonProgressTest, RefusesMoreWindowsThanThereAre) {
  for (const std::string& bytes : {std::string({17, 0, 0, 0}), std::string({-1, -1, -1, -1})}) {
    ComparisonProgress progress;
    StateReader reader(bytes);
    reader(progress);
    EXPECT_FALSE(reader.ok());
    EXPECT_EQ(progress.stage(), Stage::kUndecided);
  }
}

}  // namespace
}  // namespace evpose
