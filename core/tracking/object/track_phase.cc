// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/track_phase.h"

#include <array>
#include <cstddef>

namespace evpose {

std::string_view TrackPhaseName(TrackPhase phase) {
  static constexpr std::array<std::string_view, kNumTrackPhases> kNames = {
      "TENTATIVE", "CONFIRMED", "COASTING", "OCCLUDED", "DOUBTFUL", "UNSUPPORTED", "LOST"};
  static_assert(!kNames.back().empty());
  return kNames[static_cast<size_t>(phase)];
}

TrackPhase NextPhase(TrackPhase phase, TrackInput input) {
  if (phase == TrackPhase::kLost) return TrackPhase::kLost;
  const bool is_tentative = phase == TrackPhase::kTentative;
  // Few events and occlusion carry no evidence: the result of the last test remains in force.
  const bool was_supported =
      phase == TrackPhase::kConfirmed || phase == TrackPhase::kCoasting || phase == TrackPhase::kOccluded;
  switch (input) {
    case TrackInput::kSupport:
      return TrackPhase::kConfirmed;
    case TrackInput::kPartialSupport:
      return TrackPhase::kDoubtful;
    case TrackInput::kFewEvents:
      return was_supported ? TrackPhase::kCoasting : phase;
    case TrackInput::kOcclusion:
      return was_supported ? TrackPhase::kOccluded : phase;
    case TrackInput::kContradiction:
      return is_tentative ? phase : TrackPhase::kUnsupported;
    case TrackInput::kTimeout:
      return phase == TrackPhase::kUnsupported ? TrackPhase::kLost : phase;
    case TrackInput::kFailure:
    case TrackInput::kRejection:
      break;
  }
  return TrackPhase::kLost;
}

TrackState ReportedState(TrackPhase phase) {
  if (phase == TrackPhase::kTentative) return TrackState::kInitializing;
  if (phase == TrackPhase::kConfirmed) return TrackState::kTracking;
  return phase == TrackPhase::kLost ? TrackState::kLost : TrackState::kDegraded;
}

TestCoverage NextCoverage(TestCoverage coverage, TrackInput input, bool is_most_testable) {
  return input == TrackInput::kSupport && is_most_testable ? TestCoverage::kMost : coverage;
}

std::string_view ObjectPhaseName(ObjectPhase phase) {
  static constexpr std::array<std::string_view, kNumObjectPhases> kNames = {
      "SEARCHING",           "VERIFYING_GIVEN", "VERIFYING_GIVEN_COMPETING", "VERIFYING",
      "VERIFYING_COMPETING", "PUBLISHED",       "PUBLISHED_COMPETING"};
  static_assert(!kNames.back().empty());
  return kNames[static_cast<size_t>(phase)];
}

namespace {

ObjectPhase WithSingle(ObjectPhase phase) {
  if (phase == ObjectPhase::kVerifyingGivenCompeting) return ObjectPhase::kVerifyingGiven;
  if (phase == ObjectPhase::kVerifyingCompeting) return ObjectPhase::kVerifying;
  if (phase == ObjectPhase::kPublishedCompeting) return ObjectPhase::kPublished;
  return phase;
}

// A published pose that has been the only one keeps its precedence over challengers.
ObjectPhase WithChallengers(ObjectPhase phase) {
  if (phase == ObjectPhase::kVerifyingGiven) return ObjectPhase::kVerifyingGivenCompeting;
  if (phase == ObjectPhase::kVerifying) return ObjectPhase::kVerifyingCompeting;
  return phase;
}

}  // namespace

ObjectPhase NextPhase(ObjectPhase phase, ObjectInput input) {
  switch (input) {
    case ObjectInput::kGivenPose:
      return ObjectPhase::kVerifyingGiven;
    case ObjectInput::kPosesFound:
      return phase == ObjectPhase::kSearching ? ObjectPhase::kVerifyingCompeting : phase;
    case ObjectInput::kChallengers:
      return WithChallengers(phase);
    case ObjectInput::kRivals:
      return phase == ObjectPhase::kPublished ? ObjectPhase::kPublishedCompeting : phase;
    case ObjectInput::kSingleLeft:
      return WithSingle(phase);
    case ObjectInput::kPublication:
      if (phase == ObjectPhase::kSearching) return phase;
      return IsCompeting(phase) ? ObjectPhase::kPublishedCompeting : ObjectPhase::kPublished;
    case ObjectInput::kFirstRejected:
      // Among competing hypotheses the next one takes the place of the first one.
      return IsLoss(phase, input) ? ObjectPhase::kVerifyingCompeting : phase;
    case ObjectInput::kAllRejected:
    case ObjectInput::kUnconfirmed:
    case ObjectInput::kReset:
      break;
  }
  return ObjectPhase::kSearching;
}

bool IsPublished(ObjectPhase phase) {
  return phase == ObjectPhase::kPublished || phase == ObjectPhase::kPublishedCompeting;
}

bool IsGiven(ObjectPhase phase) {
  return phase == ObjectPhase::kVerifyingGiven || phase == ObjectPhase::kVerifyingGivenCompeting;
}

bool IsCompeting(ObjectPhase phase) {
  return phase == ObjectPhase::kVerifyingGivenCompeting || phase == ObjectPhase::kVerifyingCompeting ||
         phase == ObjectPhase::kPublishedCompeting;
}

bool IsLoss(ObjectPhase phase, ObjectInput input) {
  switch (input) {
    case ObjectInput::kFirstRejected:
      return IsGiven(phase) || phase == ObjectPhase::kPublished;
    case ObjectInput::kAllRejected:
      return IsGiven(phase) || IsPublished(phase);
    case ObjectInput::kUnconfirmed:
      return true;  // also before the first window, in which the given pose becomes a hypothesis
    default:
      return false;
  }
}

Acquisition NextAcquisition(Acquisition acquisition, ObjectPhase phase, ObjectInput input) {
  if (input == ObjectInput::kReset) return Acquisition::kFirst;
  return IsLoss(phase, input) ? Acquisition::kAfterLoss : acquisition;
}

TrackState ReportedState(Acquisition acquisition) {
  return acquisition == Acquisition::kFirst ? TrackState::kInitializing : TrackState::kLost;
}

}  // namespace evpose
