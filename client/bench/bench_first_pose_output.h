// SPDX-License-Identifier: Apache-2.0

// The results of `evpose bench models --first-pose` as text and JSON.
#pragma once

#include <ostream>
#include <vector>

#include "client/cli/common/command.h"
#include "core/experiments/first_pose/first_pose_bench.h"

namespace evpose::client {

// Explains the columns of the table, for the help text.
extern const char kFirstPoseTableHelp[];

void PrintFirstPoseHeader(std::ostream& out);
void PrintFirstPoseRow(const FirstPoseBenchRow& row, std::ostream& out);
// Prints the share of the starts that are found, and the longest time with a wrong pose, with its model.
void PrintFirstPoseSummary(const std::vector<FirstPoseBenchRow>& rows, std::ostream& out);
// Help text of --explain: the causes for which a start has no right pose.
extern const char kStartCauseHelp[];
// Prints for each model the number of starts by cause.
void PrintStartCauses(const std::vector<FirstPoseBenchRow>& rows, std::ostream& out);
Json FirstPoseJson(const std::vector<FirstPoseBenchRow>& rows, const FirstPoseBenchOptions& options);

}  // namespace evpose::client
