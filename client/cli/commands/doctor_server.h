// SPDX-License-Identifier: Apache-2.0

// The part of evpose doctor that examines servers.
#pragma once

#include "absl/status/status.h"
#include "client/cli/commands/doctor_report.h"
#include "client/cli/common/command.h"
#include "client/diagnosis/server_checks.h"

namespace evpose::client {

// Appends the findings of each of the servers of --server. Errors: those of the files of the connection (TLS, token),
// and CANCELLED after an interrupt. A server that cannot be used is a finding.
absl::Status ExamineServers(const ServerArguments& servers, const ServerNeeds& needs, const CliContext& context,
                            DoctorReport& report);

}  // namespace evpose::client
