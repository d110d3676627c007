// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/track_reactor_phase.h"

#include <gtest/gtest.h>

#include <set>

namespace evpose::server {
namespace {

using Phase = StreamPhase;

constexpr Phase kPhases[] = {Phase::kAwaitingAttach, Phase::kAttaching, Phase::kConfirming, Phase::kOpen,
                             Phase::kEnding,         Phase::kDraining,  Phase::kFailing,    Phase::kFinished};
constexpr StreamInput kInputs[] = {StreamInput::kAttachReceived, StreamInput::kAttached,    StreamInput::kOwnershipLost,
                                   StreamInput::kConfirmed,      StreamInput::kEndReceived, StreamInput::kHalfClosed,
                                   StreamInput::kFailure,        StreamInput::kFinish};

// The table of server/rpc/README.md: all changes of the phase.
struct Change {
  Phase from;
  StreamInput input;
  Phase to;
};
constexpr Change kChanges[] = {
    {Phase::kAwaitingAttach, StreamInput::kAttachReceived, Phase::kAttaching},
    {Phase::kAwaitingAttach, StreamInput::kFailure, Phase::kFailing},
    {Phase::kAwaitingAttach, StreamInput::kFinish, Phase::kFinished},
    {Phase::kAttaching, StreamInput::kAttached, Phase::kConfirming},
    {Phase::kAttaching, StreamInput::kFailure, Phase::kFailing},
    {Phase::kConfirming, StreamInput::kOwnershipLost, Phase::kAttaching},
    {Phase::kConfirming, StreamInput::kConfirmed, Phase::kOpen},
    {Phase::kConfirming, StreamInput::kFailure, Phase::kFailing},
    {Phase::kOpen, StreamInput::kEndReceived, Phase::kEnding},
    {Phase::kOpen, StreamInput::kHalfClosed, Phase::kDraining},
    {Phase::kOpen, StreamInput::kFailure, Phase::kFailing},
    {Phase::kEnding, StreamInput::kFailure, Phase::kFailing},
    {Phase::kEnding, StreamInput::kFinish, Phase::kFinished},
    {Phase::kDraining, StreamInput::kFailure, Phase::kFailing},
    {Phase::kDraining, StreamInput::kFinish, Phase::kFinished},
    {Phase::kFailing, StreamInput::kFinish, Phase::kFinished},
};

TEST(StreamPhaseTest, FollowsTheTable) {
  for (const Phase phase : kPhases) {
    for (const StreamInput input : kInputs) {
      Phase expected = phase;
      for (const Change& change : kChanges) {
        if (change.from == phase && change.input == input) expected = change.to;
      }
      EXPECT_EQ(NextPhase(phase, input), expected) << StreamPhaseName(phase) << " input " << static_cast<int>(input);
    }
  }
}

TEST(StreamPhaseTest, ReadsOnlyWhereMessagesAreExpected) {
  for (const Phase phase : kPhases) {
    const bool may_read = phase == Phase::kAwaitingAttach || phase == Phase::kOpen || phase == Phase::kEnding;
    EXPECT_EQ(MayRead(phase), may_read) << StreamPhaseName(phase);
  }
}

TEST(StreamPhaseTest, NamesAreDistinct) {
  std::set<std::string_view> names;
  for (const Phase phase : kPhases) names.insert(StreamPhaseName(phase));
  EXPECT_EQ(names.size(), static_cast<size_t>(kNumStreamPhases));
  EXPECT_FALSE(names.contains(""));
}

}  // namespace
}  // namespace evpose::server
