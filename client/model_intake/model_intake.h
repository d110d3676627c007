// SPDX-License-Identifier: Apache-2.0

// Model files of all formats that the client accepts, as the formats that a server accepts
// (client/model_intake/README.md).
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/models/object_model.h"

namespace evpose::client {

// The formats, for descriptions of options.
inline constexpr char kModelFormats[] = "OBJ, PLY, STL, glTF, GLB, DAE, OFF, 3MF, STEP or IGES";

// Whether the extension of the name is that of one of these formats.
bool IsModelFile(const std::string& path);

struct ModelFile {
  evpose::ModelFormat format = evpose::ModelFormat::kObj;
  std::string bytes;                 // in that format
  std::vector<std::string> notices;  // for the user: what of the file is not used, and why
};

// Reads a model file. The extension of its name determines the format. The bytes of OBJ, PLY and STL files are returned
// unchanged, except for an OBJ with images, whose edges become lines, and for large files. Other formats are converted
// to kMesh. Units that the file states are converted to metres. Errors have the path: those of ReadFile();
// INVALID_ARGUMENT for an unknown extension, a file that is empty, malformed, of another format or too large, and an
// unknown unit; FAILED_PRECONDITION if the program that converts the format is not installed. `metres_per_unit` is not
// applied: it is for the notice about an implausible size of a converted file that states no unit (of OBJ, PLY and STL
// files ParseModelFile() notices it). The bytes are at most `max_bytes`, what a server accepts: an OBJ, PLY or STL file
// that is larger is converted to kMesh, which shares the points of its triangles.
absl::StatusOr<ModelFile> ReadModelFile(const std::string& path, double metres_per_unit = 1.0,
                                        size_t max_bytes = ModelOptions().max_bytes);

// Returns the model that a server makes of the file with these options, with the notices of ReadModelFile() before its
// own. Errors have the path: those of ReadModelFile() and of ParseModelFile().
absl::StatusOr<ObjectModel> LoadModelFile(const std::string& path, const ModelOptions& options = {});

}  // namespace evpose::client
