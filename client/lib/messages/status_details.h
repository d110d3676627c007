// SPDX-License-Identifier: Apache-2.0

// The details of a server's error in addition to its code and message, as payloads of the status.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace evpose::client {

struct StatusDetails {
  std::string reason;       // reason of ErrorInfo, for example "FENCED"; empty for errors of the network
  std::string field;        // first field of BadRequest, for example "attach.last_pose_seq"
  std::string field_error;  // what is wrong with the field, without its name; empty if the server does not state it
  absl::Duration retry_in;  // delay of RetryInfo; zero: none
};

void SetDetails(absl::Status& status, const StatusDetails& details);
StatusDetails GetDetails(const absl::Status& status);
// Returns an error with the code and the details of `status` and another message.
absl::Status WithMessage(const absl::Status& status, absl::string_view message);

}  // namespace evpose::client
