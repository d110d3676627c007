// SPDX-License-Identifier: Apache-2.0
#include "client/cli/first_steps.h"

#include "absl/strings/str_cat.h"
#include "core/command_line/wrap.h"

namespace evpose::client {
namespace {

struct FirstStep {
  const char* purpose;
  const char* command;
};

constexpr FirstStep kFirstSteps[] = {
    {"Make a recording of an event camera, with the model, the camera and the true poses of the object:",
     "evpose simulate --object cube --camera vga --duration 0.5 --out cube"},
    {"Find and track the object in a recording:",
     "evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out cube/poses.tum"},
    {"See the events with the object at the poses found, on a page in the browser:",
     "evpose view cube/recording.raw --poses cube/poses.tum --model cube/model.obj --camera cube/camera.yaml"}};

}  // namespace

std::string FirstSteps(size_t width) {
  constexpr size_t kIndentation = 2;
  std::string text = "evpose finds and tracks known objects in the events of an event camera.\n";
  const auto append = [&text](const std::vector<std::string>& lines, size_t indentation) {
    for (const std::string& line : lines) absl::StrAppend(&text, std::string(indentation, ' '), line, "\n");
  };
  for (const FirstStep& step : kFirstSteps) {
    absl::StrAppend(&text, "\n");
    append(WrapWords(step.purpose, width), 0);
    append(WrapCommand(step.command, width - kIndentation), kIndentation);
  }
  absl::StrAppend(&text, "\n");
  append(WrapWords("evpose --help lists all commands, and evpose COMMAND --help describes one of them.", width), 0);
  return text;
}

}  // namespace evpose::client
