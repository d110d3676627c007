// SPDX-License-Identifier: Apache-2.0

// Computes the initial values of the parts of a session from the state with which it starts.
#pragma once

#include <cstdint>
#include <string>

#include "absl/time/time.h"
#include "server/sessions/durability/checkpoint_policy.h"
#include "server/sessions/durability/session_committer.h"
#include "server/sessions/stream/stream_gate.h"
#include "server/sessions/types/session_state.h"

namespace evpose::server {

// Returns the number of the first pose that the store still has, or else of the next one to be made.
uint64_t FirstPoseSeq(const SessionBeginning& beginning);
// Returns the number of the last pose that was made or stored. The store may have poses beyond the checkpoint.
uint64_t LastPoseSeq(const SessionBeginning& beginning);
// Returns what the store has.
SessionCommitter::Progress PersistedAt(const SessionBeginning& beginning);
// `resume_token` is empty for a resumed session, whose client may have seen more poses than the store has. `now` is
// taken as the time of detachment if the stored record states that a stream is attached.
StreamGate::Start GateStart(const SessionBeginning& beginning, std::string resume_token, absl::Time now);
CheckpointPolicy::Checkpoint LastCheckpoint(const SessionBeginning& beginning);

}  // namespace evpose::server
