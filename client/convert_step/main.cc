// SPDX-License-Identifier: Apache-2.0

// evpose-convert-step: converts a STEP or IGES file into a serialized Mesh (proto/evpose/v1/mesh.proto).
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <iostream>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "client/convert_step/step_reader.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "server/models/mesh_message.h"

namespace {

constexpr int kFailed = 1;
constexpr int kUsage = 2;

constexpr char kHelp[] =
    "Usage: evpose-convert-step FILE [OUTPUT]\n"
    "Converts a STEP or IGES file into the Mesh of evpose's API, in metres; without OUTPUT, on standard output.\n"
    "evpose runs it for files named .step, .stp, .iges or .igs.\n";

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
  const int standard_output = RedirectReports();
  EVPOSE_ASSIGN_OR_RETURN(const evpose::RawMesh mesh, evpose::client::ReadStep(input));
  const std::string message = evpose::server::EncodeMesh(mesh);
  return output.empty() ? WriteAll(standard_output, message) : evpose::WriteFile(output, message);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 2 && absl::string_view(argv[1]) == "--help") {
    std::cout << kHelp;
    return 0;
  }
  if (argc < 2 || argc > 3) {
    std::cerr << kHelp;
    return kUsage;
  }
  const absl::Status status = Convert(argv[1], argc == 3 ? argv[2] : "");
  if (status.ok()) return 0;
  std::cerr << "evpose-convert-step: " << status.message() << std::endl;
  return kFailed;
}
