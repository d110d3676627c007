// SPDX-License-Identifier: Apache-2.0

// Initial values of the parts of a session, from the state with which it starts.
#pragma once

#include <cstdint>
#include <string>

#include "absl/time/time.h"
#include "server/sessions/durability/checkpoint_policy.h"
#include "server/sessions/durability/session_committer.h"
#include "server/sessions/stream/stream_gate.h"
#include "server/sessions/types/session_state.h"

namespace evpose::server {

// Number of the first pose that the store still has, or of the next one to be made.
uint64_t FirstPoseSeq(const SessionBeginning& beginning);
// Number of the last pose that was made or stored: the store may have poses beyond the checkpoint.
uint64_t LastPoseSeq(const SessionBeginning& beginning);
// State of the store.
SessionCommitter::Progress PersistedAt(const SessionBeginning& beginning);
// `resume_token`: empty for a resumed session: its client may have seen more poses than the store has. `now`: the
// time of detachment when the stored record says that a stream is attached.
StreamGate::Start GateStart(const SessionBeginning& beginning, std::string resume_token, absl::Time now);
CheckpointPolicy::Checkpoint LastCheckpoint(const SessionBeginning& beginning);

}  // namespace evpose::server
