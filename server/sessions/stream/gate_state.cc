// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/gate_state.h"

#include <array>
#include <cstddef>

namespace evpose::server {

std::string_view WriterStateName(WriterState state) {
  constexpr std::array<std::string_view, kNumWriterStates> kNames = {"DETACHED", "ATTACHING", "ATTACHED", "CLOSED"};
  return kNames[static_cast<size_t>(state)];
}

std::string_view InputStateName(InputState state) {
  constexpr std::array<std::string_view, kNumInputStates> kNames = {"OPEN", "ENDING", "ENDED"};
  return kNames[static_cast<size_t>(state)];
}

std::string_view GateEventName(GateEvent event) {
  constexpr std::array<std::string_view, kNumGateEvents> kNames = {"attach",     "attach_persisted", "detach",
                                                                   "end_pushed", "end_processed",    "close"};
  return kNames[static_cast<size_t>(event)];
}

GateState NextState(GateState state, GateEvent event) {
  const bool is_closed = state.writer == WriterState::kClosed;
  switch (event) {
    case GateEvent::kAttach:
      if (!is_closed) state.writer = WriterState::kAttaching;
      break;
    case GateEvent::kAttachPersisted:
      if (state.writer == WriterState::kAttaching) state.writer = WriterState::kAttached;
      break;
    case GateEvent::kDetach:
      if (!is_closed) state.writer = WriterState::kDetached;
      break;
    case GateEvent::kEndPushed:
      if (!is_closed && state.input == InputState::kOpen) state.input = InputState::kEnding;
      break;
    case GateEvent::kEndProcessed:
      if (state.input == InputState::kEnding) state.input = InputState::kEnded;
      break;
    case GateEvent::kClose:
      state.writer = WriterState::kClosed;
      break;
  }
  return state;
}

}  // namespace evpose::server
