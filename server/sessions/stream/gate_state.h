// SPDX-License-Identifier: Apache-2.0

// The states of a session that depend on its streams, with their only transition function. The table is in
// server/sessions/README.md.
#pragma once

#include <string_view>

namespace evpose::server {

enum class WriterState {
  kDetached,   // no stream: the session expires some time after
  kAttaching,  // a stream has attached; the store does not have its lifecycle record yet
  kAttached,   // the stream's lifecycle record has been persisted
  kClosed,     // deleted, fenced by another server, or without a store; final
};
inline constexpr int kNumWriterStates = 4;
std::string_view WriterStateName(WriterState state);  // "DETACHED", ...

enum class InputState {
  kOpen,    // more items may come
  kEnding,  // the end has been queued
  kEnded,   // the end has been processed; final
};
inline constexpr int kNumInputStates = 3;
std::string_view InputStateName(InputState state);  // "OPEN", ...

enum class GateEvent {
  kAttach,           // a stream attaches; it fences the stream before
  kAttachPersisted,  // the store has the lifecycle record of the stream
  kDetach,           // the attached stream has ended
  kEndPushed,        // the stream has sent its end
  kEndProcessed,     // the worker has processed the end
  kClose,            // the session no longer exists here
};
inline constexpr int kNumGateEvents = 6;
std::string_view GateEventName(GateEvent event);  // "attach", ...

// The two are independent: streams attach to a session that has ended to read its poses, and a session may be closed
// while its end is being processed.
struct GateState {
  WriterState writer = WriterState::kDetached;
  InputState input = InputState::kOpen;

  friend bool operator==(const GateState&, const GateState&) = default;
};

// The state after `event`; the same state where the event does not apply.
GateState NextState(GateState state, GateEvent event);

// A change of the state, for the log.
struct GateTransition {
  GateState from;
  GateState to;
  GateEvent event = GateEvent::kAttach;
};

}  // namespace evpose::server
