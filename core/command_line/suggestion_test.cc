// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/suggestion.h"

#include <gtest/gtest.h>

namespace evpose {
namespace {

const std::vector<std::string> kCommands = {"replay", "render", "info", "watch", "sessions", "server"};

TEST(SuggestionTest, FindsAMisspelledName) {
  EXPECT_EQ(NearestName("reply", kCommands), "replay");
  EXPECT_EQ(NearestName("repaly", kCommands), "replay") << "exchanged letters count once";
  EXPECT_EQ(NearestName("session", kCommands), "sessions");
  EXPECT_EQ(NearestName("wacth", kCommands), "watch");
  EXPECT_EQ(NearestName("sess", kCommands), "sessions") << "the beginning of a name";
}

TEST(SuggestionTest, SuggestsNothingForAnotherWord) {
  EXPECT_EQ(NearestName("frobnicate", kCommands), "");
  EXPECT_EQ(NearestName("", kCommands), "");
  EXPECT_EQ(NearestName("x", kCommands), "");
  EXPECT_EQ(NearestName(std::string(100'000, 'r'), kCommands), "");
}

}  // namespace
}  // namespace evpose
