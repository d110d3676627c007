// SPDX-License-Identifier: Apache-2.0

// The options of all commands that read a model file.
#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/cli/console/cli_context.h"
#include "core/models/object_model.h"
#include "evpose/client.h"

namespace evpose::client {

// A model file in a format that servers read, and how they are to read it.
struct ModelUpload {
  std::string bytes;
  UploadOptions options;
  std::vector<std::string> notices;  // notices of the conversion
};

struct ModelReadingArguments {
  double metres_per_unit = 1.0;
  double crease_angle_deg = 30.0;
  std::string surface = "smooth";

  // Adds --scale, --crease-angle and --surface, in the group of inputs. If `model` is given, they are refused without
  // that option.
  void AddTo(CLI::App& app, CLI::Option* model = nullptr);
  // Reads a model file of any format, and states on standard error if that takes long. Errors: those of
  // LoadModelFile().
  absl::StatusOr<ObjectModel> Load(const CliContext& context, const std::string& path) const;
  // The same without a message, for callers that print what they do.
  absl::StatusOr<ObjectModel> LoadSilently(const std::string& path) const;
  // As Load(), for an upload. Errors: those of ReadModelFile().
  absl::StatusOr<ModelUpload> ReadForUpload(const CliContext& context, const std::string& path) const;
};

// Uploads a model, and states on standard error if that takes long. The notices of the result begin with those of the
// conversion. Errors: those of Client::UploadModel(), reworded for the owner of the file `path` (ModelError()).
absl::StatusOr<ModelInfo> UploadModel(const CliContext& context, Client& client, const std::string& path,
                                      const ModelUpload& model);

}  // namespace evpose::client
