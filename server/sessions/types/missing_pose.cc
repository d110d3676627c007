// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/missing_pose.h"

#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "core/tracking/object/event_extent.h"

namespace evpose::server {
namespace {

uint64_t NumSearches(const SearchCounts& searches) {
  const auto& [no_signal, too_small, too_few_lines, not_enough_motion, no_pose_fits, poses_found] = searches;
  return no_signal + too_small + too_few_lines + not_enough_motion + no_pose_fits + poses_found;
}

// Returns " (of 12 searches, 9 ..., 3 ...)"; empty unless the searches had different results.
std::string ListSearches(const SearchCounts& searches) {
  const std::pair<uint64_t, absl::string_view> results[] = {
      {searches.no_signal, "without events above the noise"},
      {searches.too_small, "with the events in too small a region"},
      {searches.too_few_lines, "with fewer than three lines"},
      {searches.not_enough_motion, "without enough motion"},
      {searches.no_pose_fits, "without a pose that fits the edges"},
      {searches.poses_found, "with poses that the events did not support"},
  };
  std::vector<std::string> parts;
  for (const auto& [count, text] : results) {
    if (count > 0) parts.push_back(absl::StrCat(count, " ", text));
  }
  if (parts.size() < 2) return "";
  return absl::StrCat(" (of ", NumSearches(searches), " searches, ", absl::StrJoin(parts, ", "), ")");
}

std::string ExplainStatus(const InitializationReport& report) {
  switch (report.status) {
    case InitializationStatus::kNotNeeded:
      break;
    case InitializationStatus::kWaitingForEvents:
      if (NumSearches(report.searches) == 0) return "too few events: no object is in view, or it does not move";
      return "no region of the image has more events than the noise: no object is in view, or it does not move";
    case InitializationStatus::kTooSmall:
      return absl::StrCat("the object is too small in the image: the events lie within ", report.extent_px,
                          " px, and an object needs about ", kMinSearchExtentPx, " px to be found");
    case InitializationStatus::kTooFewLines:
      return absl::StrCat("too few lines in the events: ", report.num_lines,
                          ", and three are needed; an object at rest produces none");
    case InitializationStatus::kNotEnoughMotion:
      return "not enough motion: the edges in the events move by less than a pixel";
    case InitializationStatus::kNoPoseFits:
      return absl::StrCat("no pose fits the edges in the events (lines: ", report.num_lines,
                          ", searches so far: ", report.attempts,
                          "); are the model, its scale and the camera the right ones?");
    case InitializationStatus::kNotSupported:
      if (report.attempts == 0) return "the events do not support the pose that was given";
      return absl::StrCat("poses were found, but the events supported none of them (searches that found poses: ",
                          report.searches.poses_found, "); are the model, its scale and the camera the right ones?");
    case InitializationStatus::kVerifying:
      return "the events have not confirmed the first pose yet";
    case InitializationStatus::kAmbiguous:
      if (report.num_poses < 2) return "another pose may explain the events, and its comparison has not begun yet";
      return absl::StrCat(report.num_poses, " poses are compatible with the events");
    case InitializationStatus::kNotSearchable:
      return "no edge of the model is visible from any side; give the initial pose, or reset the pose";
  }
  return "";
}

absl::string_view ExplainLoss(LossCause cause) {
  switch (cause) {
    case LossCause::kNone:
      break;
    case LossCause::kContradicted:
      return "the events contradicted the pose";
    case LossCause::kUncertain:
      return "the events did not determine the pose any more";
    case LossCause::kOutOfView:
      return "the object left the image";
    case LossCause::kBetterPose:
      return "another pose explains the events better";
    case LossCause::kOccupied:
      return "another object with the same model is tracked at its place";
    case LossCause::kUnconfirmed:
      return "the stream ended before the events confirmed the given pose";
  }
  return "the pose was rejected";
}

}  // namespace

std::string ExplainMissingPose(const ObjectHealth& object) {
  const InitializationReport& report = object.initialization;
  const std::string reason = absl::StrCat(ExplainStatus(report), ListSearches(report.searches));
  switch (object.state) {
    case TrackState::kTracking:
    case TrackState::kDegraded:
      return "";
    case TrackState::kAmbiguous:
    case TrackState::kInitializing:
      return reason;
    case TrackState::kLost:
      break;
  }
  const std::string loss = absl::StrFormat("lost at %.6f s because %s", static_cast<double>(report.lost_at_us) * 1e-6,
                                           ExplainLoss(report.loss_cause));
  // The rejection of the pose is the loss itself and no further reason.
  const bool is_about_loss = report.status == InitializationStatus::kNotSupported && NumSearches(report.searches) == 0;
  return is_about_loss ? loss : absl::StrCat(loss, "; since then: ", reason);
}

}  // namespace evpose::server
