// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/gltf_contents.h"

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <nlohmann/json.hpp>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/byte_order.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

using Json = nlohmann::json;

// A GLB file: "glTF", version, length of the file; then chunks: length, type, data. Little endian.
constexpr absl::string_view kGlbMagic = "glTF";
constexpr size_t kGlbHeaderBytes = 12, kChunkHeaderBytes = 8;
constexpr uint32_t kJsonChunk = 0x4E4F534A;
constexpr int64_t kFloat = 5126;  // componentType of single precision

// Extensions that a file may require. Assimp decodes Draco; the others affect colours, light and images. An image that
// cannot be decoded gives a notice.
constexpr absl::string_view kReadExtensions[] = {
    "KHR_draco_mesh_compression", "KHR_lights_punctual", "KHR_texture_transform", "KHR_texture_basisu",
    "EXT_texture_webp",           "EXT_texture_avif",    "MSFT_texture_dds",      "KHR_xmp_json_ld"};
constexpr absl::string_view kMaterialExtensions = "KHR_materials_";
constexpr absl::string_view kInstances = "EXT_mesh_gpu_instancing";

absl::string_view RemedyFor(absl::string_view extension) {
  if (extension == "KHR_mesh_quantization") return "export without quantization";
  if (absl::StrContains(extension, "meshopt")) return "export without compression";
  return "export the model without it, or as STL, 3MF or STEP";
}

uint32_t Word(absl::string_view bytes, size_t offset) {
  return LoadLittleEndian<uint32_t>(reinterpret_cast<const uint8_t*>(bytes.data()) + offset);
}

absl::StatusOr<absl::string_view> JsonOfGlb(absl::string_view contents) {
  if (contents.size() < kGlbHeaderBytes + kChunkHeaderBytes) return absl::InvalidArgumentError("is cut off");
  const uint32_t version = Word(contents, 4), bytes = Word(contents, 8);
  if (version != 2) {
    return absl::InvalidArgumentError(absl::StrCat("is glTF ", version, "; only glTF 2.0 is read: export it again"));
  }
  const uint32_t json_bytes = Word(contents, kGlbHeaderBytes);
  const size_t begin = kGlbHeaderBytes + kChunkHeaderBytes;
  if (bytes > contents.size() || json_bytes > contents.size() - begin) {
    return absl::InvalidArgumentError(
        absl::StrCat("is cut off: it states ", bytes, " bytes, but has ", contents.size()));
  }
  if (Word(contents, kGlbHeaderBytes + 4) != kJsonChunk) {
    return absl::InvalidArgumentError("its first chunk is not JSON, as GLB demands");
  }
  return contents.substr(begin, json_bytes);
}

// The member of an object; null if `json` is no object or has none.
const Json& Member(const Json& json, const char* name) {
  static const Json kNone;
  if (!json.is_object()) return kNone;
  const auto found = json.find(name);
  return found == json.end() ? kNone : *found;
}

// The strings in a list; other values are left out.
std::vector<std::string> Names(const Json& list) {
  std::vector<std::string> names;
  if (!list.is_array()) return names;
  for (const Json& name : list) {
    if (name.is_string()) names.push_back(name.get<std::string>());
  }
  return names;
}

absl::Status CheckExtensions(const Json& document, std::vector<std::string>& notices) {
  for (const std::string& name : Names(Member(document, "extensionsRequired"))) {
    if (absl::StartsWith(name, kMaterialExtensions)) continue;
    if (std::find(std::begin(kReadExtensions), std::end(kReadExtensions), name) != std::end(kReadExtensions)) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("requires the glTF extension ", Escaped(name), ", which is not read: ", RemedyFor(name)));
  }
  const std::vector<std::string> used = Names(Member(document, "extensionsUsed"));
  if (std::find(used.begin(), used.end(), kInstances) != used.end()) {
    notices.push_back(
        absl::StrCat("the instances of meshes (", kInstances, ") are not read: each such mesh is taken once"));
  }
  return absl::OkStatus();
}

bool HasFloats(const Json& document, const Json& accessor) {
  const Json& accessors = Member(document, "accessors");
  if (!accessors.is_array() || !accessor.is_number_unsigned() || accessor.get<size_t>() >= accessors.size()) {
    return true;  // Assimp reports it
  }
  const Json& type = Member(accessors[accessor.get<size_t>()], "componentType");
  return type.is_number_integer() && type.get<int64_t>() == kFloat;
}

absl::Status CheckNumbers(const Json& document, GltfContents& result) {
  const Json& meshes = Member(document, "meshes");
  if (!meshes.is_array()) return absl::OkStatus();
  for (const Json& mesh : meshes) {
    const Json& primitives = Member(mesh, "primitives");
    if (!primitives.is_array()) continue;
    for (const Json& primitive : primitives) {
      const Json& attributes = Member(primitive, "attributes");
      if (!attributes.is_object()) continue;
      for (const auto& [name, accessor] : attributes.items()) {
        if (HasFloats(document, accessor)) continue;
        if (absl::StartsWith(name, "TEXCOORD_")) result.are_images_read = false;
        if (name != "POSITION" && name != "NORMAL") continue;
        return absl::InvalidArgumentError(
            absl::StrCat("the numbers of ", name,
                         " are not floating-point numbers, which alone are read: export without "
                         "quantization"));
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<GltfContents> CheckGltf(absl::string_view contents) {
  absl::string_view text = contents;
  if (absl::StartsWith(contents, kGlbMagic)) {
    EVPOSE_ASSIGN_OR_RETURN(text, JsonOfGlb(contents));
  }
  const Json document = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!document.is_object()) return absl::InvalidArgumentError("its JSON is malformed or cut off");
  const Json& version = Member(Member(document, "asset"), "version");
  if (version.is_string() && !absl::StartsWith(version.get<std::string>(), "2.")) {
    return absl::InvalidArgumentError(
        absl::StrCat("is glTF ", Escaped(version.get<std::string>()), "; only glTF 2.0 is read: export it again"));
  }
  GltfContents result;
  EVPOSE_RETURN_IF_ERROR(CheckExtensions(document, result.notices));
  EVPOSE_RETURN_IF_ERROR(CheckNumbers(document, result));
  if (!result.are_images_read && !Member(document, "images").empty()) {
    result.notices.push_back(
        "the edges of the images are not used: texture coordinates that are not floating-point numbers are not read; "
        "export without quantization");
  }
  return result;
}

}  // namespace evpose::client
