// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/track_phase.h"

#include <gtest/gtest.h>

#include <array>

namespace evpose {
namespace {

using T = TrackPhase;

// The table of core/tracking/README.md, by phase; columns in the order of TrackInput.
constexpr std::array<std::array<T, kNumTrackInputs>, kNumTrackPhases> kTrackTable = {{
    // support, partial support, few events, contradiction, occlusion, timeout, failure, rejection
    {T::kConfirmed, T::kDoubtful, T::kTentative, T::kTentative, T::kTentative, T::kTentative, T::kLost, T::kLost},
    {T::kConfirmed, T::kDoubtful, T::kCoasting, T::kUnsupported, T::kOccluded, T::kConfirmed, T::kLost, T::kLost},
    {T::kConfirmed, T::kDoubtful, T::kCoasting, T::kUnsupported, T::kOccluded, T::kCoasting, T::kLost, T::kLost},
    {T::kConfirmed, T::kDoubtful, T::kCoasting, T::kUnsupported, T::kOccluded, T::kOccluded, T::kLost, T::kLost},
    {T::kConfirmed, T::kDoubtful, T::kDoubtful, T::kUnsupported, T::kDoubtful, T::kDoubtful, T::kLost, T::kLost},
    {T::kConfirmed, T::kDoubtful, T::kUnsupported, T::kUnsupported, T::kUnsupported, T::kLost, T::kLost, T::kLost},
    {T::kLost, T::kLost, T::kLost, T::kLost, T::kLost, T::kLost, T::kLost, T::kLost},
}};

TEST(TrackPhaseTest, EveryTransitionIsThatOfTheTable) {
  for (int phase = 0; phase < kNumTrackPhases; ++phase) {
    for (int input = 0; input < kNumTrackInputs; ++input) {
      EXPECT_EQ(NextPhase(static_cast<T>(phase), static_cast<TrackInput>(input)), kTrackTable[phase][input])
          << TrackPhaseName(static_cast<T>(phase)) << ", input " << input;
    }
  }
}

TEST(TrackPhaseTest, ReportsTheStateOfTheApi) {
  EXPECT_EQ(ReportedState(T::kTentative), TrackState::kInitializing);
  EXPECT_EQ(ReportedState(T::kConfirmed), TrackState::kTracking);
  for (const T phase : {T::kCoasting, T::kOccluded, T::kDoubtful, T::kUnsupported}) {
    EXPECT_EQ(ReportedState(phase), TrackState::kDegraded) << TrackPhaseName(phase);
  }
  EXPECT_EQ(ReportedState(T::kLost), TrackState::kLost);
}

TEST(TestCoverageTest, OnlySupportOfATestOfMostLinesRaisesIt) {
  for (int i = 0; i < kNumTrackInputs; ++i) {
    const auto input = static_cast<TrackInput>(i);
    const bool is_support = input == TrackInput::kSupport;
    EXPECT_EQ(NextCoverage(TestCoverage::kPart, input, true), is_support ? TestCoverage::kMost : TestCoverage::kPart);
    EXPECT_EQ(NextCoverage(TestCoverage::kPart, input, false), TestCoverage::kPart);
    for (const bool is_most_testable : {false, true}) {
      EXPECT_EQ(NextCoverage(TestCoverage::kMost, input, is_most_testable), TestCoverage::kMost) << "it is final";
    }
  }
}

using O = ObjectPhase;

// The table of core/tracking/README.md, by phase; columns in the order of ObjectInput.
constexpr std::array<std::array<O, kNumObjectInputs>, kNumObjectPhases> kObjectTable = {{
    // given pose, poses found, challengers, rivals, single left, publication, first rejected, all rejected,
    // unconfirmed, reset
    {O::kVerifyingGiven, O::kVerifyingCompeting, O::kSearching, O::kSearching, O::kSearching, O::kSearching,
     O::kSearching, O::kSearching, O::kSearching, O::kSearching},
    {O::kVerifyingGiven, O::kVerifyingGiven, O::kVerifyingGivenCompeting, O::kVerifyingGiven, O::kVerifyingGiven,
     O::kPublished, O::kVerifyingCompeting, O::kSearching, O::kSearching, O::kSearching},
    {O::kVerifyingGiven, O::kVerifyingGivenCompeting, O::kVerifyingGivenCompeting, O::kVerifyingGivenCompeting,
     O::kVerifyingGiven, O::kPublishedCompeting, O::kVerifyingCompeting, O::kSearching, O::kSearching, O::kSearching},
    {O::kVerifyingGiven, O::kVerifying, O::kVerifyingCompeting, O::kVerifying, O::kVerifying, O::kPublished,
     O::kVerifying, O::kSearching, O::kSearching, O::kSearching},
    {O::kVerifyingGiven, O::kVerifyingCompeting, O::kVerifyingCompeting, O::kVerifyingCompeting, O::kVerifying,
     O::kPublishedCompeting, O::kVerifyingCompeting, O::kSearching, O::kSearching, O::kSearching},
    {O::kVerifyingGiven, O::kPublished, O::kPublished, O::kPublishedCompeting, O::kPublished, O::kPublished,
     O::kVerifyingCompeting, O::kSearching, O::kSearching, O::kSearching},
    {O::kVerifyingGiven, O::kPublishedCompeting, O::kPublishedCompeting, O::kPublishedCompeting, O::kPublished,
     O::kPublishedCompeting, O::kPublishedCompeting, O::kSearching, O::kSearching, O::kSearching},
}};

// Where first rejected, all rejected and unconfirmed are losses, by phase. No other input is one.
constexpr std::array<std::array<bool, 3>, kNumObjectPhases> kLossTable = {{
    {false, false, true},
    {true, true, true},
    {true, true, true},
    {false, false, true},
    {false, false, true},
    {true, true, true},
    {false, true, true},
}};
constexpr int kFirstLossInput = static_cast<int>(ObjectInput::kFirstRejected);

TEST(ObjectPhaseTest, EveryTransitionIsThatOfTheTable) {
  for (int phase = 0; phase < kNumObjectPhases; ++phase) {
    for (int input = 0; input < kNumObjectInputs; ++input) {
      EXPECT_EQ(NextPhase(static_cast<O>(phase), static_cast<ObjectInput>(input)), kObjectTable[phase][input])
          << ObjectPhaseName(static_cast<O>(phase)) << ", input " << input;
    }
  }
}

TEST(ObjectPhaseTest, EveryLossIsThatOfTheTable) {
  for (int phase = 0; phase < kNumObjectPhases; ++phase) {
    for (int input = 0; input < kNumObjectInputs; ++input) {
      const int column = input - kFirstLossInput;
      const bool expected = column >= 0 && column < 3 && kLossTable[phase][column];
      EXPECT_EQ(IsLoss(static_cast<O>(phase), static_cast<ObjectInput>(input)), expected)
          << ObjectPhaseName(static_cast<O>(phase)) << ", input " << input;
    }
  }
}

TEST(AcquisitionTest, ChangesWithLossesAndResetsAlone) {
  for (const Acquisition before : {Acquisition::kFirst, Acquisition::kAfterLoss}) {
    for (int phase = 0; phase < kNumObjectPhases; ++phase) {
      for (int i = 0; i < kNumObjectInputs; ++i) {
        const auto input = static_cast<ObjectInput>(i);
        Acquisition expected = before;
        if (IsLoss(static_cast<O>(phase), input)) expected = Acquisition::kAfterLoss;
        if (input == ObjectInput::kReset) expected = Acquisition::kFirst;
        EXPECT_EQ(NextAcquisition(before, static_cast<O>(phase), input), expected)
            << ObjectPhaseName(static_cast<O>(phase)) << ", input " << i;
      }
    }
  }
}

TEST(AcquisitionTest, ReportsTheStateOfTheApi) {
  EXPECT_EQ(ReportedState(Acquisition::kFirst), TrackState::kInitializing);
  EXPECT_EQ(ReportedState(Acquisition::kAfterLoss), TrackState::kLost);
}

TEST(ObjectPhaseTest, PropertiesOfThePhases) {
  for (int i = 0; i < kNumObjectPhases; ++i) {
    const O phase = static_cast<O>(i);
    EXPECT_EQ(IsPublished(phase), phase == O::kPublished || phase == O::kPublishedCompeting);
    EXPECT_EQ(IsGiven(phase), phase == O::kVerifyingGiven || phase == O::kVerifyingGivenCompeting);
    EXPECT_EQ(IsCompeting(phase), ObjectPhaseName(phase).find("COMPETING") != std::string_view::npos);
  }
}

}  // namespace
}  // namespace evpose
