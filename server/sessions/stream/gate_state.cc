// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/gate_state.h"

namespace evpose::server {

std::string_view WriterStateName(WriterState state) {
  switch (state) {
    case WriterState::kDetached:
      return "DETACHED";
    case WriterState::kAttaching:
      return "ATTACHING";
    case WriterState::kAttached:
      return "ATTACHED";
    case WriterState::kClosed:
      return "CLOSED";
  }
  return "";
}

std::string_view InputStateName(InputState state) {
  switch (state) {
    case InputState::kOpen:
      return "OPEN";
    case InputState::kEnding:
      return "ENDING";
    case InputState::kEnded:
      return "ENDED";
  }
  return "";
}

std::string_view GateEventName(GateEvent event) {
  switch (event) {
    case GateEvent::kAttach:
      return "attach";
    case GateEvent::kAttachPersisted:
      return "attach_persisted";
    case GateEvent::kDetach:
      return "detach";
    case GateEvent::kEndPushed:
      return "end_pushed";
    case GateEvent::kEndProcessed:
      return "end_processed";
    case GateEvent::kClose:
      return "close";
  }
  return "";
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
