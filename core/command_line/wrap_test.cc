// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/wrap.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

TEST(WrapTest, BreaksProseAtSpaces) {
  EXPECT_THAT(WrapWords("one two  three\nfour", 9), ElementsAre("one two", "three", "four"));
  EXPECT_THAT(WrapWords("incomprehensible word", 5), ElementsAre("incomprehensible", "word"));
  EXPECT_THAT(WrapWords("  ", 5), IsEmpty());
}

TEST(WrapTest, ContinuesACommandOnTheNextLine) {
  EXPECT_THAT(WrapCommand("evpose info a.raw", 80), ElementsAre("evpose info a.raw"));
  EXPECT_THAT(WrapCommand("evpose info a.raw --json", 16), ElementsAre("evpose info \\", "  a.raw --json"));
}

TEST(WrapTest, DoesNotBreakBeforeTheValueOfAnOption) {
  EXPECT_THAT(WrapCommand("evpose info --camera a.yaml --json | sort", 20),
              ElementsAre("evpose info \\", "  --camera a.yaml \\", "  --json | sort"));
}

TEST(WrapTest, DoesNotBreakInsideQuotes) {
  EXPECT_THAT(WrapCommand("a \"b c  d\" 'e \" f' g", 6),
              ElementsAre("a \\", "  \"b c  d\" \\", "  'e \" f' \\", "  g"));
}

}  // namespace
}  // namespace evpose
