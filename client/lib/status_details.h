// SPDX-License-Identifier: Apache-2.0

// The details of a server's error in addition to its code and message, as payloads of the status.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/time/time.h"

namespace evpose::client {

struct StatusDetails {
  std::string reason;       // reason of ErrorInfo, for example "FENCED"; empty for errors of the network
  std::string field;        // first field of BadRequest, for example "attach.last_pose_seq"
  absl::Duration retry_in;  // delay of RetryInfo; zero: none
};

void SetDetails(absl::Status& status, const StatusDetails& details);
StatusDetails GetDetails(const absl::Status& status);

}  // namespace evpose::client
