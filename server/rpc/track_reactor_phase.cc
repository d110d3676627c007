// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/track_reactor_phase.h"

#include <array>
#include <cstddef>

namespace evpose::server {

std::string_view StreamPhaseName(StreamPhase phase) {
  constexpr std::array<std::string_view, kNumStreamPhases> kNames = {
      "AWAITING_ATTACH", "ATTACHING", "CONFIRMING", "OPEN", "ENDING", "DRAINING", "FAILING", "FINISHED"};
  return kNames[static_cast<size_t>(phase)];
}

StreamPhase NextPhase(StreamPhase phase, StreamInput input) {
  using Phase = StreamPhase;
  const auto change = [phase](Phase from, Phase to) { return phase == from ? to : phase; };
  switch (input) {
    case StreamInput::kAttachReceived:
      return change(Phase::kAwaitingAttach, Phase::kAttaching);
    case StreamInput::kAttached:
      return change(Phase::kAttaching, Phase::kConfirming);
    case StreamInput::kOwnershipLost:
      return change(Phase::kConfirming, Phase::kAttaching);
    case StreamInput::kConfirmed:
      return change(Phase::kConfirming, Phase::kOpen);
    case StreamInput::kEndReceived:
      return change(Phase::kOpen, Phase::kEnding);
    case StreamInput::kHalfClosed:
      return change(Phase::kOpen, Phase::kDraining);
    case StreamInput::kFailure:
      return phase == Phase::kFinished ? phase : Phase::kFailing;
    case StreamInput::kFinish: {
      // While the session is attached to, or has more to send, a stream finishes only with an error.
      const bool has_more = phase == Phase::kAttaching || phase == Phase::kConfirming || phase == Phase::kOpen;
      return has_more ? phase : Phase::kFinished;
    }
  }
  return phase;
}

bool MayRead(StreamPhase phase) {
  return phase == StreamPhase::kAwaitingAttach || phase == StreamPhase::kOpen || phase == StreamPhase::kEnding;
}

}  // namespace evpose::server
