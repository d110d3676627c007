// SPDX-License-Identifier: Apache-2.0
#include "client/convert_hdf5/hdf5_arguments.h"

#include "core/base/version.h"
#include "core/command_line/help.h"

namespace evpose::client {

std::unique_ptr<CLI::App> MakeHdf5Parser(Hdf5Arguments& arguments) {
  auto app = std::make_unique<CLI::App>("Read or write a recording in HDF5 for evpose", "evpose-hdf5");
  app->set_version_flag("--version", VersionLine("evpose-hdf5"));
  app->option_defaults()->group(kInputGroup);
  app->add_option("action", arguments.action,
                  "What to do. read: write the events of FILE to standard output; write: write those of standard input "
                  "to FILE, as Metavision does (ECF)")
      ->type_name("NAME")
      ->check(CLI::IsMember({"read", "write"}))
      ->required();
  app->add_option("file", arguments.path, "Recording in HDF5")->type_name("FILE")->required();
  app->footer(
      "Usage:\n  read FILE\n  write FILE\n\n"
      "evpose runs this program for recordings in HDF5; it is seldom called by users. Standard input and output have "
      "the records by which both exchange events, triggers and losses.\n\n"
      "Exit status:\n"
      "  0  All was read or written\n"
      "  1  Failure; the reason is on standard error\n"
      "  2  Wrong usage\n\n"
      "Example:\n"
      "  evpose-hdf5 read recording.hdf5 | evpose-hdf5 write copy.hdf5");
  UseHelp(*app);
  return app;
}

}  // namespace evpose::client
