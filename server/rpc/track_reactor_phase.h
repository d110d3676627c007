// SPDX-License-Identifier: Apache-2.0

// The phases of one Track stream (TrackReactor), with their only transition function. The table is in
// server/rpc/README.md.
#pragma once

#include <string_view>

namespace evpose::server {

enum class StreamPhase {
  kAwaitingAttach,  // the first message is read; the attach timeout runs
  kAttaching,       // the session is found or resumed from the store; nothing is read or written
  kConfirming,      // attached; the response `attached` waits until the store has the lifecycle record
  kOpen,            // messages are read, responses written
  kEnding,          // the client has sent `end`: the summary follows the last response
  kDraining,        // the client has half-closed without `end`: the stream finishes when everything is persisted
  kFailing,         // the stream finishes with an error as soon as the write in flight is done
  kFinished,        // the call has been finished; final
};
inline constexpr int kNumStreamPhases = 8;
std::string_view StreamPhaseName(StreamPhase phase);  // "AWAITING_ATTACH", ...

enum class StreamInput {
  kAttachReceived,  // the client has sent `attach`
  kAttached,        // the session has accepted the stream
  kOwnershipLost,   // another server on the same store holds the session: it is reclaimed
  kConfirmed,       // the response `attached` is written
  kEndReceived,     // the client has sent `end`, and the session has accepted it
  kHalfClosed,      // the client sends no more
  kFailure,         // an error, a cancellation, or a call of End
  kFinish,          // the final status is sent
};

// The phase after `input`; the same phase where the input does not apply.
StreamPhase NextPhase(StreamPhase phase, StreamInput input);

// Messages of the client are read in this phase.
bool MayRead(StreamPhase phase);

}  // namespace evpose::server
