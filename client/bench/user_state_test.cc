// SPDX-License-Identifier: Apache-2.0
#include "client/bench/user_state.h"

#include <gtest/gtest.h>

#include <utility>
#include <vector>

namespace evpose::client {
namespace {

using State = UserState;
using Input = UserInput;

State After(const std::vector<Input>& inputs) {
  State state = State::kWaiting;
  for (const Input input : inputs) state = NextState(state, input);
  return state;
}

TEST(UserStateTest, ASessionFollowsAnother) {
  const std::vector<std::pair<Input, State>> steps = {
      {Input::kCreate, State::kCreating},  {Input::kRefused, State::kWaiting},    {Input::kCreate, State::kCreating},
      {Input::kCreated, State::kBroken},   {Input::kAttach, State::kAttaching},   {Input::kLost, State::kBroken},
      {Input::kAttach, State::kAttaching}, {Input::kAttached, State::kStreaming}, {Input::kLost, State::kBroken},
      {Input::kAttach, State::kAttaching}, {Input::kAttached, State::kStreaming}, {Input::kDelete, State::kDeleting},
      {Input::kDeleted, State::kWaiting},  {Input::kStop, State::kOver}};
  std::vector<Input> inputs;
  for (const auto& [input, state] : steps) {
    inputs.push_back(input);
    EXPECT_EQ(After(inputs), state) << inputs.size();
  }
}

TEST(UserStateTest, ASessionThatExistsIsDeletedBeforeTheEnd) {
  for (const State state : {State::kBroken, State::kAttaching, State::kStreaming}) {
    EXPECT_EQ(NextState(state, Input::kDelete), State::kDeleting);
    EXPECT_EQ(NextState(state, Input::kStop), state);
  }
  EXPECT_EQ(NextState(State::kDeleting, Input::kStop), State::kDeleting);
}

TEST(UserStateTest, OverIsFinal) {
  for (int input = 0; input < kNumUserInputs; ++input) {
    EXPECT_EQ(NextState(State::kOver, static_cast<Input>(input)), State::kOver) << input;
  }
}

}  // namespace
}  // namespace evpose::client
