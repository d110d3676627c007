// SPDX-License-Identifier: Apache-2.0

// The phases of one hypothesis (PoseTrack) and of one object (ObjectTracker), with their only transition functions. The
// tables are in core/tracking/README.md, section 3.
#pragma once

#include <cstdint>
#include <functional>
#include <string_view>
#include <variant>

#include "core/tracking/object/pose_estimate.h"

namespace evpose {

// One hypothesis about the pose.
enum class TrackPhase {
  kTentative,    // the events have not supported the pose yet; it is not reported
  kConfirmed,    // the latest test result is significant support
  kCoasting,     // supported before, and too few events since
  kOccluded,     // supported before, and hidden by other tracked objects since
  kDoubtful,     // part of the object is supported, but too little for a confirmation
  kUnsupported,  // there are enough events, and they do not support the pose
  kLost,         // rejected; final
};
inline constexpr int kNumTrackPhases = 7;           // number of enumerators; likewise below
std::string_view TrackPhaseName(TrackPhase phase);  // "TENTATIVE", ...

// Events that may change the phase of a hypothesis.
enum class TrackInput {
  kSupport,         // significant support of enough of the object
  kPartialSupport,  // significant support of a part of it
  kFewEvents,       // no more events than the background explains
  kContradiction,   // enough events, without support
  kOcclusion,       // other tracked objects hide all of it, or so much that the rest cannot be tested
  kTimeout,         // contradicted for HealthOptions::lost_after_us
  kFailure,         // no usable fit, or an uncertainty above HealthOptions::max_uncertainty_px
  kRejection,       // removed from the hypotheses: a competing one is better or equal, or see LossCause
};
inline constexpr int kNumTrackInputs = 8;

// Returns the phase after `input`, by the table of the README; `phase` itself if nothing changes.
TrackPhase NextPhase(TrackPhase phase, TrackInput input);

// Whether a hypothesis has a pose that may be reported: it has left the tentative phase, and has not been rejected.
inline bool HasEstimate(TrackPhase phase) { return phase != TrackPhase::kTentative && phase != TrackPhase::kLost; }

// The state that is reported while this hypothesis is published.
TrackState ReportedState(TrackPhase phase);

// How much of the object has been tested while its pose was supported. When most of it has been tested, a smaller
// supported part keeps the pose (HealthOptions::keep_support_ratio). Stored as one byte.
enum class TestCoverage : uint8_t {
  kPart,  // no supporting result tested HealthOptions::min_tested_ratio of the lines: the rest may contradict the pose
  kMost,  // a supporting result has tested this share of the lines; the coverage stays
};
// Returns the coverage after `input`. `is_most_testable`: the result behind it tested min_tested_ratio of the lines.
TestCoverage NextCoverage(TestCoverage coverage, TrackInput input, bool is_most_testable);

// Phase of one object: the state of the search for its pose and of its publication.
enum class ObjectPhase {
  kSearching,                // no hypothesis
  kVerifyingGiven,           // one hypothesis, a pose that the user gave; not reported
  kVerifyingGivenCompeting,  // the same, beside poses from a search
  kVerifying,                // one hypothesis from a search; not reported
  kVerifyingCompeting,       // several; not reported
  kPublished,                // the first hypothesis is reported; it has been the only one at least once
  kPublishedCompeting,       // the first hypothesis is reported, but which of several is right is not decided
};
inline constexpr int kNumObjectPhases = 7;
std::string_view ObjectPhaseName(ObjectPhase phase);  // "SEARCHING", ...

// Events that may change the phase of an object.
enum class ObjectInput {
  kGivenPose,      // a pose was given: it becomes the only hypothesis
  kPosesFound,     // a search found poses
  kChallengers,    // a search found poses beside the present ones
  kRivals,         // another pose may have the image of the published one (rivals.h)
  kSingleLeft,     // one hypothesis is left
  kPublication,    // the first hypothesis is reported from now on
  kFirstRejected,  // the first hypothesis was rejected, and others are left
  kAllRejected,    // none is left
  kUnconfirmed,    // the stream has ended before the events have supported the pose that the user gave
  kReset,          // the user discards the present pose
};
inline constexpr int kNumObjectInputs = 10;

// Returns the phase after `input`, by the table of the README; `phase` itself if nothing changes.
ObjectPhase NextPhase(ObjectPhase phase, ObjectInput input);

// Whether the pose of the first hypothesis is reported.
bool IsPublished(ObjectPhase phase);
// Whether the pose that is being verified was given by the user.
bool IsGiven(ObjectPhase phase);
// Whether several hypotheses compete and none of them takes precedence.
bool IsCompeting(ObjectPhase phase);

// Whether the object is lost by `input`: a published or given pose is rejected, and no rival takes its place.
bool IsLoss(ObjectPhase phase, ObjectInput input);

// Whether a search for the object is its first one or follows a loss.
enum class Acquisition {
  kFirst,      // the object has not been lost since the start or the latest reset
  kAfterLoss,  // the object has been lost since then
};
// Returns the acquisition after `input` in `phase`, by the table of the README.
Acquisition NextAcquisition(Acquisition acquisition, ObjectPhase phase, ObjectInput input);

// The state that is reported while no pose is published.
TrackState ReportedState(Acquisition acquisition);

// Change of the phase of a hypothesis, or of an object.
template <typename Phase>
struct Transition {
  Phase from{};
  Phase to{};
};
using TrackTransition = Transition<TrackPhase>;
using ObjectTransition = Transition<ObjectPhase>;

// A change of the phase of one object, or of one of its hypotheses, for logs and metrics.
struct PhaseTransition {
  uint32_t object_index = 0;
  int64_t t_us = 0;  // sensor time: the end of the window that caused it
  std::variant<TrackTransition, ObjectTransition> change;
};

// Called in the thread that feeds the tracker, in the order of the transitions.
using PhaseListener = std::function<void(const PhaseTransition&)>;

// Calls a listener with the transitions of one object. Nothing that it does may influence the estimates.
struct PhaseReporter {
  uint32_t object_index = 0;
  PhaseListener listener;  // null: nothing is reported

  template <typename Phase>
  void Report(Phase from, Phase to, int64_t t_us) const {
    if (listener && from != to) listener({object_index, t_us, Transition<Phase>{from, to}});
  }
};

}  // namespace evpose
