// SPDX-License-Identifier: Apache-2.0

// evpose evaluate --align and --time-offset: a reference in another frame and on another clock.
#pragma once

#include <optional>
#include <ostream>
#include <string>

#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "core/calibration/hand_eye.h"
#include "core/geometry/trajectory.h"

namespace evpose::client {

struct AlignmentArguments {
  std::string align = "none";
  std::string time_offset = "0";
  std::string truth_of = "auto";

  void AddTo(CLI::App& app);
  // Returns the alignment of the truth with an estimate; nullopt if none is wanted. Errors: wrong usage, and those of
  // SolveHandEye().
  absl::StatusOr<std::optional<HandEye>> Solve(const Trajectory& truth, const Trajectory& estimate) const;
  bool is_rigid() const { return align == "rigid"; }
};

Json AlignmentJson(const AlignmentArguments& arguments, const std::optional<HandEye>& alignment);
// Prints the lines below the table, for one estimate.
void PrintAlignment(const AlignmentArguments& arguments, const std::string& name, const HandEye& alignment,
                    std::ostream& out);

}  // namespace evpose::client
