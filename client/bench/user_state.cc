// SPDX-License-Identifier: Apache-2.0
#include "client/bench/user_state.h"

#include <array>
#include <cstddef>
#include <tuple>

namespace evpose::client {

UserState NextState(UserState state, UserInput input) {
  using State = UserState;
  using Input = UserInput;
  constexpr std::tuple<State, Input, State> kTransitions[] = {
      {State::kWaiting, Input::kCreate, State::kCreating}, {State::kWaiting, Input::kStop, State::kOver},
      {State::kCreating, Input::kCreated, State::kBroken}, {State::kCreating, Input::kRefused, State::kWaiting},
      {State::kCreating, Input::kStop, State::kOver},      {State::kBroken, Input::kAttach, State::kAttaching},
      {State::kBroken, Input::kDelete, State::kDeleting},  {State::kAttaching, Input::kAttached, State::kStreaming},
      {State::kAttaching, Input::kLost, State::kBroken},   {State::kAttaching, Input::kDelete, State::kDeleting},
      {State::kStreaming, Input::kLost, State::kBroken},   {State::kStreaming, Input::kDelete, State::kDeleting},
      {State::kDeleting, Input::kDeleted, State::kWaiting}};
  for (const auto& [from, possible, to] : kTransitions) {
    if (from == state && possible == input) return to;
  }
  return state;
}

}  // namespace evpose::client
