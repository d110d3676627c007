// SPDX-License-Identifier: Apache-2.0

// The bundles of evpose doctor: computes the poses of a bundle, and compares them with those in it.
#pragma once

#include <optional>
#include <ostream>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "client/diagnosis/bundle.h"

namespace evpose::client {

// Returns the poses that this program computes from a bundle, in a server inside this process, as JSON lines. `name` is
// the name of the bundle in errors and messages. Errors: those of the parts of the bundle, and of tracking; CANCELLED
// after an interrupt.
absl::StatusOr<std::string> TrackBundle(const Bundle& bundle, const std::string& name, const CliContext& context);

// Two lists of poses as JSON lines, compared by their bytes.
struct PoseComparison {
  size_t num_expected = 0;
  size_t num_found = 0;
  size_t num_different = 0;         // poses that differ from the one at the same place of the other list
  std::string first_difference;     // empty if the lists are identical
  double largest_distance_m = 0.0;  // between poses at the same place of both lists
  double largest_angle_rad = 0.0;

  bool is_identical() const { return first_difference.empty(); }
  Json ToJson() const;
};
// Compares two lists of poses. Errors: INVALID_ARGUMENT with `name` and the line for a line that is not a pose.
absl::StatusOr<PoseComparison> ComparePoses(const std::string& expected, const std::string& found,
                                            const std::string& name);

// evpose doctor --replay. Error: FAILED_PRECONDITION if the poses differ.
absl::Status ReplayBundle(const std::string& path, bool is_json, CliContext& context);

}  // namespace evpose::client
