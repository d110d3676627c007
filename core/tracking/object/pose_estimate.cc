// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/pose_estimate.h"

#include <array>
#include <utility>

namespace evpose {

std::string_view TrackStateName(TrackState state) {
  static constexpr std::array<std::string_view, kNumTrackStates> kNames = {"INITIALIZING", "TRACKING", "DEGRADED",
                                                                           "LOST", "AMBIGUOUS"};
  static_assert(!kNames.back().empty());
  return kNames[static_cast<size_t>(state)];
}

std::string_view InitializationStatusName(InitializationStatus status) {
  static constexpr std::array<std::string_view, static_cast<size_t>(kLastInitializationStatus) + 1> kNames = {
      "NOT_NEEDED", "WAITING_FOR_EVENTS", "TOO_FEW_LINES",     "NO_POSE_FITS", "VERIFYING",
      "AMBIGUOUS",  "NOT_SEARCHABLE",     "NOT_ENOUGH_MOTION", "TOO_SMALL",    "NOT_SUPPORTED"};
  static_assert(!kNames.back().empty());
  return kNames[static_cast<size_t>(status)];
}

InitializationStatus MostFrequentResult(const SearchCounts& searches) {
  // The results have the order of the steps of a search.
  const std::pair<uint64_t, InitializationStatus> results[] = {
      {searches.no_signal, InitializationStatus::kWaitingForEvents},
      {searches.too_small, InitializationStatus::kTooSmall},
      {searches.too_few_lines, InitializationStatus::kTooFewLines},
      {searches.not_enough_motion, InitializationStatus::kNotEnoughMotion},
      {searches.no_pose_fits, InitializationStatus::kNoPoseFits},
      {searches.poses_found, InitializationStatus::kNotSupported},
  };
  auto most = results[0];
  for (const auto& result : results) {
    if (result.first > 0 && result.first >= most.first) most = result;
  }
  return most.second;
}

}  // namespace evpose
