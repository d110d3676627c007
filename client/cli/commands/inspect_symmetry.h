// SPDX-License-Identifier: Apache-2.0

// Prints the symmetries and the near-symmetries of a model (evpose models inspect), as text and as JSON.
#pragma once

#include <ostream>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "client/cli/common/command.h"
#include "core/evaluation/near_symmetries.h"
#include "core/models/object_model.h"

namespace evpose::client {

Json SymmetryJson(const ObjectModel& model);
Json NearSymmetriesJson(absl::Span<const NearSymmetry> near);
// Prints lines that begin with "symmetry" and, if there are near ones, "near".
void PrintSymmetries(const ObjectModel& model, absl::Span<const NearSymmetry> near, std::ostream& out);
// Appends what near-symmetries mean for the user, and what helps.
void AddNearSymmetryWarning(absl::Span<const NearSymmetry> near, std::vector<std::string>& warnings);

}  // namespace evpose::client
