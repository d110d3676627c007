// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/gate_state.h"

#include <gtest/gtest.h>

#include <set>
#include <string>

namespace evpose::server {
namespace {

constexpr WriterState kWriters[] = {WriterState::kDetached, WriterState::kAttaching, WriterState::kAttached,
                                    WriterState::kClosed};
constexpr InputState kInputs[] = {InputState::kOpen, InputState::kEnding, InputState::kEnded};
constexpr GateEvent kEvents[] = {GateEvent::kAttach,    GateEvent::kAttachPersisted, GateEvent::kDetach,
                                 GateEvent::kEndPushed, GateEvent::kEndProcessed,    GateEvent::kClose};

// The table of server/sessions/README.md: rows are states, columns events in the order of GateEvent.
constexpr WriterState kDetached = WriterState::kDetached, kAttaching = WriterState::kAttaching,
                      kAttached = WriterState::kAttached, kClosed = WriterState::kClosed;
constexpr WriterState kNextWriter[kNumWriterStates][kNumGateEvents] = {
    {kAttaching, kDetached, kDetached, kDetached, kDetached, kClosed},
    {kAttaching, kAttached, kDetached, kAttaching, kAttaching, kClosed},
    {kAttaching, kAttached, kDetached, kAttached, kAttached, kClosed},
    {kClosed, kClosed, kClosed, kClosed, kClosed, kClosed}};
constexpr InputState kOpen = InputState::kOpen, kEnding = InputState::kEnding, kEnded = InputState::kEnded;
constexpr InputState kNextInput[kNumInputStates][kNumGateEvents] = {
    {kOpen, kOpen, kOpen, kEnding, kOpen, kOpen},
    {kEnding, kEnding, kEnding, kEnding, kEnded, kEnding},
    {kEnded, kEnded, kEnded, kEnded, kEnded, kEnded}};

TEST(GateStateTest, FollowsTheTable) {
  for (const WriterState writer : kWriters) {
    for (const InputState input : kInputs) {
      for (const GateEvent event : kEvents) {
        GateState expected = {kNextWriter[static_cast<int>(writer)][static_cast<int>(event)],
                              kNextInput[static_cast<int>(input)][static_cast<int>(event)]};
        if (writer == kClosed && event == GateEvent::kEndPushed) expected.input = input;  // nothing may be pushed
        EXPECT_EQ(NextState({writer, input}, event), expected)
            << WriterStateName(writer) << " " << InputStateName(input) << " " << GateEventName(event);
      }
    }
  }
}

TEST(GateStateTest, NamesAreDistinct) {
  std::set<std::string_view> names;
  for (const WriterState state : kWriters) names.insert(WriterStateName(state));
  for (const InputState state : kInputs) names.insert(InputStateName(state));
  for (const GateEvent event : kEvents) names.insert(GateEventName(event));
  EXPECT_EQ(names.size(), static_cast<size_t>(kNumWriterStates + kNumInputStates + kNumGateEvents));
  EXPECT_FALSE(names.contains(""));
}

}  // namespace
}  // namespace evpose::server
