// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/step_conversion.h"

#include <memory>
#include <optional>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "absl/types/span.h"
#include "client/programs/child_process.h"
#include "client/programs/program_path.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr char kConverter[] = "evpose-convert-step";

constexpr size_t kReadBytes = size_t{64} * 1024;  // the capacity of a pipe

}  // namespace

absl::StatusOr<ConvertedModel> RunConverter(const std::string& program, const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<ChildProcess> process,
                          ChildProcess::Start(program, {PathArgument(path)}));
  ConvertedModel model;
  std::vector<uint8_t> buffer(kReadBytes);
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const size_t count, process->Read(absl::MakeSpan(buffer)));
    if (count == 0) break;
    model.mesh.append(buffer.begin(), buffer.begin() + static_cast<int64_t>(count));
  }
  EVPOSE_RETURN_IF_ERROR(process->Wait());
  const std::string errors = process->ErrorText();
  for (absl::string_view line : absl::StrSplit(errors, '\n')) {
    if (absl::ConsumePrefix(&line, "notice: ")) model.notices.emplace_back(line);
  }
  return model;
}

absl::StatusOr<ConvertedModel> ConvertStep(const std::string& path) {
  EVPOSE_RETURN_IF_ERROR(CheckIsFile(path));
  const std::optional<std::string> program = FindProgram(kConverter, "../convert_step");
  if (program.has_value()) return RunConverter(*program, path);
  return absl::FailedPreconditionError(
      absl::StrCat("STEP and IGES files need the program ", kConverter,
                   ", which is neither beside this program nor in the PATH: install the Debian package ", kConverter,
                   " (component step of cmake --install), or export the model as STL, 3MF or glTF"));
}

}  // namespace evpose::client
