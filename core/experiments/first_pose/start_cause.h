// SPDX-License-Identifier: Apache-2.0

// Why a tracker that was started without a prior did not find the right pose in time.
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "core/experiments/first_pose/first_pose_run.h"
#include "core/initialization/templates/template_search.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {

// The causes, in the order in which they are tested. The first one that applies is the cause.
enum class StartCause {
  kFound,
  kNotMoved,      // the image of the object never moves by 2 px
  kTurnNotShown,  // the events do not distinguish turns about the axis of a nearly round object (TurnEvidence())
  kNotSupported,  // a tracker that is given the true pose is not TRACKING in the same time either
  kNotRanked,     // no search returns the right pose, even if it is proposed
  kNotProposed,   // no search returns it, but one does if it is proposed: no view near it was aligned
  kUndecided,     // a search returns it, but it competes with others until the end
  kNotConfirmed,  // a search returns it, but it is DEGRADED, rejected or too late
};
inline constexpr int kNumStartCauses = static_cast<int>(StartCause::kNotConfirmed) + 1;
std::string_view StartCauseName(StartCause cause);  // "found", "not moved", "turn not shown", ...

// What a tracker reported in a start, in numbers of poses.
struct ReportedStates {
  int tracking = 0, tracking_right = 0;
  int degraded = 0, degraded_right = 0;
  int ambiguous = 0, ambiguous_right = 0;
  int ambiguous_among = 0;  // the right pose is among the alternatives
};

struct StartExplanation {
  StartCause cause = StartCause::kFound;
  std::vector<double> turn_sigmas;  // of TurnEvidence()
  // Microseconds until a tracker that is given the true pose is TRACKING and right; -1: never.
  int64_t given_right_us = -1;
  // Rank of the right pose in searches at kSearchTimesUs after the start, and if it is proposed, too; -1: not returned.
  std::vector<int> ranks, proposed_ranks;
};

// Standard deviations by which the events of an interval prefer the true poses to those that are turned about the axis
// of a nearly round object, in steps of 2 pi / kTemplateTurns without the one by zero. The test is that between two
// poses (core/tracking/README.md, section 2), with the true motion. Empty for other objects. With less than
// decision_sigma no tracker with this test can find the turn.
std::vector<double> TurnEvidence(const FirstPoseRun& run, const TrackerOptions& options, int64_t begin_us,
                                 int64_t end_us);

// Index of the first of these poses from which tracking finds the true one: within 6 degrees and 3 % of the depth,
// modulo the symmetries. -1: none.
int RankOfRight(const FirstPoseRun& run, const TemplateMatches& found);

// Explains a start without a right pose in [start_us, end_us), `moved`: whether the object moves in it. Errors: those
// of Tracker::Create().
absl::StatusOr<StartExplanation> ExplainStart(const FirstPoseRun& run, const TrackerOptions& options, int64_t start_us,
                                              int64_t end_us, bool moved, const ReportedStates& states);

}  // namespace evpose
