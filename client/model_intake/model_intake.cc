// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/model_intake.h"

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <iterator>
#include <optional>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/model_intake/scene_reader.h"
#include "client/model_intake/step_conversion.h"
#include "client/model_intake/texture_lines.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/mesh/loading/text_lines.h"
#include "core/mesh/mesh_repair.h"
#include "server/models/mesh_message.h"

namespace evpose::client {
namespace {

absl::Span<const uint8_t> AsBytes(const std::string& text) {
  return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
}

absl::Status AtPath(const std::string& path, const absl::Status& status) {
  if (status.ok() || absl::StartsWith(status.message(), path)) return status;
  return absl::Status(status.code(), absl::StrCat(path, ": ", status.message()));
}

// Adds a notice if the user scales a file that states its unit.
void NoteScale(double metres_per_unit, std::vector<std::string>& notices) {
  if (metres_per_unit == 1.0) return;
  notices.push_back(absl::StrFormat(
      "the file states its unit, in which it was read: --scale %g scales the object in addition", metres_per_unit));
}

// Adds a notice if the size is implausible. It is called if the file does not state the unit of its numbers.
void NoteSize(double metres_per_unit, Scene& scene) {
  RawMesh in_metres;
  for (const Eigen::Vector3d& point : scene.mesh.points) in_metres.points.push_back(metres_per_unit * point);
  NoteImplausibleSize(in_metres, metres_per_unit, scene.notices);
}

absl::StatusOr<ModelFile> ConvertScene(const std::string& path, SceneFormat format, double metres_per_unit) {
  EVPOSE_ASSIGN_OR_RETURN(Scene scene, ReadScene(path, format, ModelOptions().max_triangles));
  if (format == SceneFormat::kOff) {
    NoteSize(metres_per_unit, scene);
  } else {
    NoteScale(metres_per_unit, scene.notices);
  }
  EVPOSE_RETURN_IF_ERROR(AddTextureLines(scene));
  return ModelFile{evpose::ModelFormat::kMesh, server::EncodeMesh(scene.mesh), std::move(scene.notices)};
}

// Replaces an OBJ by a mesh with the edges of its images, if it has any. Line elements are all lines of the object:
// then images are not needed.
absl::StatusOr<ModelFile> ReadObjFile(const std::string& path, double metres_per_unit, ModelFile file) {
  bool has_materials = false, has_lines = false;
  LineReader lines(file.bytes);
  std::vector<absl::string_view> words;
  while (const std::optional<absl::string_view> line = lines.Next()) {
    SplitWords(*line, words);
    has_materials = has_materials || (!words.empty() && words[0] == "mtllib");
    has_lines = has_lines || (!words.empty() && words[0] == "l");
  }
  if (!has_materials || has_lines) return file;
  // A file that the server can read is not refused because of its materials.
  absl::StatusOr<Scene> scene = ReadScene(path, SceneFormat::kObj, ModelOptions().max_triangles);
  if (!scene.ok()) {
    file.notices.push_back(absl::StrCat("the images of the model are not used: ", scene.status().message()));
    return file;
  }
  EVPOSE_RETURN_IF_ERROR(AddTextureLines(*scene));
  file.notices = scene->notices;
  if (scene->mesh.lines.empty()) return file;
  NoteSize(metres_per_unit, *scene);
  return ModelFile{evpose::ModelFormat::kMesh, server::EncodeMesh(scene->mesh), std::move(scene->notices)};
}

constexpr const char* kStepExtensions[] = {".step", ".stp", ".igs", ".iges"};
constexpr std::pair<const char*, SceneFormat> kSceneExtensions[] = {{".gltf", SceneFormat::kGltf},
                                                                    {".glb", SceneFormat::kGlb},
                                                                    {".dae", SceneFormat::kDae},
                                                                    {".off", SceneFormat::kOff},
                                                                    {".3mf", SceneFormat::k3mf}};

std::string ExtensionOf(const std::string& path) {
  return absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
}

bool IsStep(const std::string& extension) {
  return std::find(std::begin(kStepExtensions), std::end(kStepExtensions), extension) != std::end(kStepExtensions);
}

std::optional<SceneFormat> SceneFormatOf(const std::string& extension) {
  for (const auto& [name, format] : kSceneExtensions) {
    if (extension == name) return format;
  }
  return std::nullopt;
}

absl::StatusOr<ModelFile> ReadKnownFormat(const std::string& path, double metres_per_unit) {
  EVPOSE_RETURN_IF_ERROR(CheckIsFile(path));
  const std::string extension = ExtensionOf(path);
  if (IsStep(extension)) {
    EVPOSE_ASSIGN_OR_RETURN(ConvertedModel model, ConvertStep(path));
    ModelFile file{evpose::ModelFormat::kMesh, std::move(model.mesh), std::move(model.notices)};
    NoteScale(metres_per_unit, file.notices);
    return file;
  }
  if (const std::optional<SceneFormat> format = SceneFormatOf(extension)) {
    return ConvertScene(path, *format, metres_per_unit);
  }
  const absl::StatusOr<evpose::ModelFormat> format = evpose::ModelFormatFromPath(path);
  if (!format.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat("unknown model format; the name must end in .obj, .ply, .stl, .gltf, .glb, .dae, .off, .3mf, "
                     ".step, .stp, .iges or .igs"));
  }
  EVPOSE_ASSIGN_OR_RETURN(std::string bytes, ReadFile(path, ModelOptions().max_bytes));
  if (bytes.empty()) return absl::InvalidArgumentError("the model file is empty");
  ModelFile file{*format, std::move(bytes), {}};
  return *format == evpose::ModelFormat::kObj ? ReadObjFile(path, metres_per_unit, std::move(file)) : file;
}

}  // namespace

bool IsModelFile(const std::string& path) {
  const std::string extension = ExtensionOf(path);
  return IsStep(extension) || SceneFormatOf(extension).has_value() || ModelFormatFromPath(path).ok();
}

absl::StatusOr<ModelFile> ReadModelFile(const std::string& path, double metres_per_unit) {
  absl::StatusOr<ModelFile> file = ReadKnownFormat(path, metres_per_unit);
  if (!file.ok()) return AtPath(path, file.status());
  return file;
}

absl::StatusOr<ObjectModel> LoadModelFile(const std::string& path, const ModelOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const ModelFile file, ReadModelFile(path, options.metres_per_unit));
  absl::StatusOr<ObjectModel> model = server::ParseModelFile(AsBytes(file.bytes), file.format, options);
  if (!model.ok()) return AtPath(path, model.status());
  model->notices.insert(model->notices.begin(), file.notices.begin(), file.notices.end());
  return model;
}

}  // namespace evpose::client
