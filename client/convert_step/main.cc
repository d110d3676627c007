// SPDX-License-Identifier: Apache-2.0

// evpose-convert-step: converts a STEP or IGES file into a serialized Mesh (proto/evpose/v1/mesh.proto).
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <system_error>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "client/convert_step/step_arguments.h"
#include "client/convert_step/step_reader.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/command_line/help.h"
#include "server/models/mesh_message.h"

namespace {

// OpenCASCADE prints reports on standard output. Returns a descriptor of the former standard output.
int RedirectReports() {
  const int output = dup(STDOUT_FILENO);
  const int nowhere = open("/dev/null", O_WRONLY | O_CLOEXEC);
  dup2(nowhere, STDOUT_FILENO);
  close(nowhere);
  return output;
}

absl::Status WriteAll(int descriptor, absl::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t count = write(descriptor, bytes.data(), bytes.size());
    if (count < 0) return absl::ErrnoToStatus(errno, "standard output cannot be written");
    bytes.remove_prefix(static_cast<size_t>(count));
  }
  return absl::OkStatus();
}

// `output` is empty for standard output.
absl::Status Convert(const std::string& input, const std::string& output) {
  std::error_code error;
  if (!output.empty() && std::filesystem::equivalent(input, output, error)) {
    return absl::InvalidArgumentError(output + ": is the file to read, which would be overwritten: give another name");
  }
  const int standard_output = RedirectReports();
  EVPOSE_ASSIGN_OR_RETURN(const evpose::client::StepModel model, evpose::client::ReadStep(input));
  for (const std::string& notice : model.notices) std::cerr << "notice: " << notice << '\n';
  const std::string message = evpose::server::EncodeMesh(model.mesh);
  return output.empty() ? WriteAll(standard_output, message) : evpose::WriteFile(output, message);
}

absl::StatusOr<int> Run(int argc, char** argv) {
  evpose::client::StepArguments arguments;
  const std::unique_ptr<CLI::App> parser = evpose::client::MakeStepParser(arguments);
  if (const std::optional<int> answer = evpose::ParseOrAnswer(*parser, argc, argv)) return *answer;
  EVPOSE_RETURN_IF_ERROR(Convert(arguments.input, arguments.output));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  return evpose::RunProgram("evpose-convert-step", [argc, argv] { return Run(argc, argv); });
}
