// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/doctor_server.h"

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/cli/console/wait_message.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Returns whether the cause is an interrupt or a file of the user, and not the server.
bool IsOwnFailure(const absl::Status& status) {
  return absl::IsNotFound(status) || absl::IsInvalidArgument(status) || absl::IsCancelled(status);
}

absl::StatusOr<std::vector<Finding>> ExamineServer(const ServerArguments& server, const ServerNeeds& needs,
                                                   const CliContext& context) {
  const absl::StatusOr<std::unique_ptr<Client>> client = server.Connect(context);
  if (!client.ok()) {
    if (IsOwnFailure(client.status())) return client.status();
    return DescribeUnconnected(server.address, client.status());
  }
  const WaitMessage wait(context, absl::StrCat("the checks of the connection to ", server.address));
  absl::StatusOr<std::vector<Finding>> findings = CheckServer(**client, needs);
  if (findings.ok()) return findings;
  return DescribeUnconnected(server.address, findings.status());
}

}  // namespace

absl::Status ExamineServers(const ServerArguments& servers, const ServerNeeds& needs, const CliContext& context,
                            DoctorReport& report) {
  const std::vector<std::string> addresses = absl::StrSplit(servers.address, ',');
  for (const std::string& address : addresses) {
    ServerArguments server = servers;
    server.address = address;
    EVPOSE_ASSIGN_OR_RETURN(std::vector<Finding> findings, ExamineServer(server, needs, context));
    report.later_subjects[report.findings.size()] = "server " + address;
    for (Finding& finding : findings) {
      if (addresses.size() > 1) finding.text = absl::StrCat(address, ": ", finding.text);
      report.findings.push_back(std::move(finding));
    }
  }
  return absl::OkStatus();
}

}  // namespace evpose::client
