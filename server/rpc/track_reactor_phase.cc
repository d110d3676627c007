// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/track_reactor_phase.h"

#include <array>
#include <cstddef>
#include <tuple>

namespace evpose::server {

std::string_view StreamPhaseName(StreamPhase phase) {
  constexpr std::array<std::string_view, kNumStreamPhases> kNames = {
      "AWAITING_ATTACH", "ATTACHING", "CONFIRMING", "OPEN", "ENDING", "DRAINING", "FAILING", "FINISHED"};
  return kNames[static_cast<size_t>(phase)];
}

StreamPhase NextPhase(StreamPhase phase, StreamInput input) {
  using Phase = StreamPhase;
  using Input = StreamInput;
  if (input == Input::kFailure) return phase == Phase::kFinished ? phase : Phase::kFailing;
  if (input == Input::kFinish) {
    // While the session is attached to, or has more to send, a stream finishes only with an error.
    const bool has_more = phase == Phase::kAttaching || phase == Phase::kConfirming || phase == Phase::kOpen;
    return has_more ? phase : Phase::kFinished;
  }
  constexpr std::tuple<Input, Phase, Phase> kTransitions[] = {
      {Input::kAttachReceived, Phase::kAwaitingAttach, Phase::kAttaching},
      {Input::kAttached, Phase::kAttaching, Phase::kConfirming},
      {Input::kOwnershipLost, Phase::kConfirming, Phase::kAttaching},
      {Input::kConfirmed, Phase::kConfirming, Phase::kOpen},
      {Input::kEndReceived, Phase::kOpen, Phase::kEnding},
      {Input::kHalfClosed, Phase::kOpen, Phase::kDraining}};
  for (const auto& [possible, from, to] : kTransitions) {
    if (possible == input && from == phase) return to;
  }
  return phase;
}

bool MayRead(StreamPhase phase) {
  return phase == StreamPhase::kAwaitingAttach || phase == StreamPhase::kOpen || phase == StreamPhase::kEnding;
}

}  // namespace evpose::server
