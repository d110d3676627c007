// SPDX-License-Identifier: Apache-2.0

// The report of evpose doctor.
#pragma once

#include <cstddef>
#include <map>
#include <ostream>
#include <string>
#include <vector>

#include "client/cli/common/command.h"
#include "core/diagnosis/finding.h"

namespace evpose::client {

struct DoctorReport {
  std::vector<std::string> subjects;  // what was examined, one line for each
  std::vector<Finding> findings;
  // Subjects that are printed before the finding of this index: those after it are about this subject.
  std::map<size_t, std::string> later_subjects = {};

  Json ToJson() const;
  void Print(std::ostream& out) const;
  // The names of the checks with this verdict, separated by commas.
  std::string Names(Verdict verdict) const;
};

}  // namespace evpose::client
