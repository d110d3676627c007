// SPDX-License-Identifier: Apache-2.0
#include "client/convert_step/step_arguments.h"

#include "core/base/version.h"
#include "core/command_line/help.h"

namespace evpose::client {

std::unique_ptr<CLI::App> MakeStepParser(StepArguments& arguments) {
  auto app = std::make_unique<CLI::App>("Convert a STEP or IGES file into a mesh for evpose", "evpose-convert-step");
  app->set_version_flag("--version", VersionLine("evpose-convert-step"));
  app->option_defaults()->group(kInputGroup);
  app->add_option("file", arguments.input, "Model to read: .step, .stp, .iges or .igs")->type_name("FILE")->required();
  app->option_defaults()->group(kOutputGroup);
  app->add_option("output", arguments.output, "Mesh to write. Default: standard output")->type_name("FILE");
  app->footer(
      "evpose runs this program for models in STEP and IGES; it is seldom called by users. The output is the message "
      "Mesh of evpose's API, in metres, with the edges of the surfaces.\n\n"
      "Exit status:\n"
      "  0  The mesh was written\n"
      "  1  The file could not be read or written; the reason is on standard error\n"
      "  2  Wrong usage\n\n"
      "Example:\n"
      "  evpose-convert-step part.step part.mesh");
  UseHelp(*app);
  return app;
}

}  // namespace evpose::client
