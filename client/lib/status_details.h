// SPDX-License-Identifier: Apache-2.0

// What a server says beside an error's code and words, kept in the status.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/time/time.h"

namespace evpose::client {

struct StatusDetails {
  std::string reason;       // of ErrorInfo, "FENCED"; empty: none, as with what the network itself reports
  std::string field;        // the first of BadRequest, "attach.last_pose_seq"
  absl::Duration retry_in;  // of RetryInfo; zero: none
};

void SetDetails(absl::Status& status, const StatusDetails& details);
StatusDetails GetDetails(const absl::Status& status);

}  // namespace evpose::client
