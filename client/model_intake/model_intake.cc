// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/model_intake.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <iterator>
#include <optional>
#include <system_error>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "client/model_intake/scene_reader.h"
#include "client/model_intake/step_conversion.h"
#include "client/model_intake/texture_lines.h"
#include "core/base/byte_order.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/mesh/loading/text_lines.h"
#include "core/mesh/mesh_repair.h"
#include "server/models/mesh_message.h"

namespace evpose::client {
namespace {

std::string Mebibytes(uint64_t bytes) {
  return absl::StrFormat("%.3g MiB", std::ldexp(static_cast<double>(bytes), -20));
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
void NoteSize(const RawMesh& mesh, double metres_per_unit, std::vector<std::string>& notices) {
  RawMesh in_metres;
  for (const Eigen::Vector3d& point : mesh.points) in_metres.points.push_back(metres_per_unit * point);
  NoteImplausibleSize(in_metres, metres_per_unit, notices);
}

// The mesh as a file that a server accepts.
absl::StatusOr<ModelFile> EncodeFile(const RawMesh& mesh, std::vector<std::string> notices, size_t max_bytes) {
  ModelFile file{evpose::ModelFormat::kMesh, server::EncodeMesh(mesh), std::move(notices)};
  if (file.bytes.size() <= max_bytes) return file;
  return absl::InvalidArgumentError(absl::StrFormat("its mesh takes %s, but a server accepts %s: simplify the model",
                                                    Mebibytes(file.bytes.size()), Mebibytes(max_bytes)));
}

absl::StatusOr<ModelFile> ConvertScene(const std::string& path, SceneFormat format, double metres_per_unit,
                                       size_t max_bytes) {
  EVPOSE_ASSIGN_OR_RETURN(Scene scene, ReadScene(path, format, ModelOptions().max_triangles));
  if (format == SceneFormat::kOff) {
    NoteSize(scene.mesh, metres_per_unit, scene.notices);
  } else {
    NoteScale(metres_per_unit, scene.notices);
  }
  EVPOSE_RETURN_IF_ERROR(AddTextureLines(scene));
  return EncodeFile(scene.mesh, std::move(scene.notices), max_bytes);
}

// Whether an OBJ names materials, which may have images. If it has line elements, these are all lines of the object:
// then images are not needed.
bool MayHaveImages(absl::string_view text) {
  bool has_materials = false;
  LineReader lines(absl::StripPrefix(text, "\xEF\xBB\xBF"));
  std::vector<absl::string_view> words;
  while (const std::optional<absl::string_view> line = lines.Next()) {
    SplitWords(*line, words);
    if (words.empty()) continue;
    if (words[0] == "l") return false;
    has_materials = has_materials || words[0] == "mtllib";
  }
  return has_materials;
}

// Replaces an OBJ by a mesh with the edges of its images, if it has any.
absl::StatusOr<ModelFile> AddImages(const std::string& path, double metres_per_unit, size_t max_bytes, ModelFile file) {
  // A file that the server can read is not refused because of its materials.
  absl::StatusOr<Scene> scene = ReadScene(path, SceneFormat::kObj, ModelOptions().max_triangles);
  const absl::Status status = scene.ok() ? AddTextureLines(*scene) : scene.status();
  if (!status.ok()) {
    file.notices.push_back(absl::StrCat("the images of the model are not used: ", status.message()));
    return file;
  }
  if (scene->mesh.lines.empty()) {
    file.notices.insert(file.notices.end(), scene->notices.begin(), scene->notices.end());
    return file;
  }
  NoteSize(scene->mesh, metres_per_unit, scene->notices);
  return EncodeFile(scene->mesh, std::move(scene->notices), max_bytes);
}

// Replaces the points at each position by the first of them, and keeps the order.
void SharePoints(RawMesh& mesh) {
  absl::flat_hash_map<std::array<double, 3>, uint32_t> numbers;
  std::vector<uint32_t> number_of;
  std::vector<Eigen::Vector3d> points;
  for (const Eigen::Vector3d& point : mesh.points) {
    const auto [found, is_new] = numbers.try_emplace({point.x(), point.y(), point.z()}, numbers.size());
    if (is_new) points.push_back(point);
    number_of.push_back(found->second);
  }
  for (auto& triangle : mesh.triangles) {
    for (uint32_t& corner : triangle) corner = number_of[corner];
  }
  mesh.points = std::move(points);
}

// Converts a file that is larger than what a server accepts. Text takes up to ten times the space of the mesh in it.
absl::StatusOr<ModelFile> ConvertLargeFile(const ModelFile& large, double metres_per_unit, size_t max_bytes) {
  EVPOSE_ASSIGN_OR_RETURN(RawMesh mesh, evpose::ReadMesh(AsBytes(large.bytes), large.format, ModelOptions()));
  if (!mesh.lines.empty()) {
    return absl::InvalidArgumentError(
        absl::StrFormat("has line elements (l) and %s, but such files are read up to %s: remove the line elements, or "
                        "simplify the model",
                        Mebibytes(large.bytes.size()), Mebibytes(max_bytes)));
  }
  SharePoints(mesh);
  std::vector<std::string> notices;
  TakeNotices(mesh, notices);
  NoteSize(mesh, metres_per_unit, notices);
  return EncodeFile(mesh, std::move(notices), max_bytes);
}

// OBJ, PLY and STL.
absl::StatusOr<ModelFile> ReadServerFormat(const std::string& path, evpose::ModelFormat format, double metres_per_unit,
                                           size_t max_bytes) {
  std::error_code error;
  if (const uintmax_t size = std::filesystem::file_size(path, error); !error && size > kMaxModelFileBytes) {
    return absl::InvalidArgumentError(
        absl::StrFormat("has %s, but at most %s are read: simplify the model, or export it as binary STL or PLY",
                        Mebibytes(size), Mebibytes(kMaxModelFileBytes)));
  }
  EVPOSE_ASSIGN_OR_RETURN(std::string bytes, ReadFile(path, kMaxModelFileBytes));
  if (bytes.empty()) return absl::InvalidArgumentError("the model file is empty");
  const bool may_have_images = format == evpose::ModelFormat::kObj && MayHaveImages(bytes);
  ModelFile file{format, std::move(bytes), {}};
  if (file.bytes.size() > max_bytes) {
    EVPOSE_ASSIGN_OR_RETURN(file, ConvertLargeFile(file, metres_per_unit, max_bytes));
  }
  if (!may_have_images) return file;
  return AddImages(path, metres_per_unit, max_bytes, std::move(file));
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

absl::StatusOr<ModelFile> ReadKnownFormat(const std::string& path, double metres_per_unit, size_t max_bytes) {
  EVPOSE_RETURN_IF_ERROR(CheckIsFile(path));
  const std::string extension = ExtensionOf(path);
  if (IsStep(extension)) {
    EVPOSE_ASSIGN_OR_RETURN(ConvertedModel model, ConvertStep(path));
    ModelFile file{evpose::ModelFormat::kMesh, std::move(model.mesh), std::move(model.notices)};
    NoteScale(metres_per_unit, file.notices);
    return file;
  }
  if (const std::optional<SceneFormat> format = SceneFormatOf(extension)) {
    return ConvertScene(path, *format, metres_per_unit, max_bytes);
  }
  const absl::StatusOr<evpose::ModelFormat> format = evpose::ModelFormatFromPath(path);
  if (!format.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat("unknown model format; the name must end in .obj, .ply, .stl, .gltf, .glb, .dae, .off, .3mf, "
                     ".step, .stp, .iges or .igs"));
  }
  return ReadServerFormat(path, *format, metres_per_unit, max_bytes);
}

}  // namespace

bool IsModelFile(const std::string& path) {
  const std::string extension = ExtensionOf(path);
  return IsStep(extension) || SceneFormatOf(extension).has_value() || ModelFormatFromPath(path).ok();
}

absl::StatusOr<ModelFile> ReadModelFile(const std::string& path, double metres_per_unit, size_t max_bytes) {
  absl::StatusOr<ModelFile> file = ReadKnownFormat(path, metres_per_unit, max_bytes);
  if (!file.ok()) return AtPath(path, file.status());
  return file;
}

absl::StatusOr<ObjectModel> LoadModelFile(const std::string& path, const ModelOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const ModelFile file, ReadModelFile(path, options.metres_per_unit, options.max_bytes));
  absl::StatusOr<ObjectModel> model = server::ParseModelFile(AsBytes(file.bytes), file.format, options);
  if (!model.ok()) return AtPath(path, model.status());
  model->notices.insert(model->notices.begin(), file.notices.begin(), file.notices.end());
  return model;
}

}  // namespace evpose::client
