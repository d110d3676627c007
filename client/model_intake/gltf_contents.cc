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

constexpr absl::string_view kDraco = "KHR_draco_mesh_compression";
constexpr absl::string_view kQuantization = "KHR_mesh_quantization";
constexpr absl::string_view kMeshopt = "meshopt_compression";  // with the prefix EXT_ or KHR_
constexpr int64_t kMaxPrimitiveMode = 6;                       // triangle fan

absl::string_view RemedyFor(absl::string_view extension) {
  if (extension == kQuantization) {
    return "export without quantization (gltfpack -noq, or gltf-transform dequantize)";
  }
  if (absl::StrContains(extension, kMeshopt)) return "export without compression (gltfpack without -c and -cc)";
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

const Json& Extension(const Json& json, absl::string_view name) {
  return Member(Member(json, "extensions"), std::string(name).c_str());
}

// The element of the list `name` with this index; null if it is absent.
const Json& Element(const Json& document, const char* name, const Json& index) {
  static const Json kNone;
  const Json& list = Member(document, name);
  const bool is_known = list.is_array() && index.is_number_unsigned() && index.get<size_t>() < list.size();
  return is_known ? list[index.get<size_t>()] : kNone;
}

// The compression need not be required: a file may have the same numbers in a second, uncompressed buffer, which is
// read. Without that buffer, Assimp would report a missing "uri".
absl::Status CheckMeshopt(const Json& document, bool is_glb) {
  const Json& views = Member(document, "bufferViews");
  if (!views.is_array()) return absl::OkStatus();
  for (const Json& view : views) {
    for (const char* name : {"EXT_meshopt_compression", "KHR_meshopt_compression"}) {
      if (Extension(view, name).is_null()) continue;
      const Json& index = Member(view, "buffer");
      const bool is_glb_chunk = is_glb && index.is_number_unsigned() && index.get<size_t>() == 0;
      if (is_glb_chunk || !Member(Element(document, "buffers", index), "uri").is_null()) continue;
      return absl::InvalidArgumentError(absl::StrCat("has only data that are compressed by the glTF extension ", name,
                                                     ", which is not read: ", RemedyFor(name)));
    }
  }
  return absl::OkStatus();
}

bool HasFloats(const Json& document, const Json& accessor) {
  const Json& found = Element(document, "accessors", accessor);
  if (found.is_null()) return true;  // Assimp reports it
  const Json& type = Member(found, "componentType");
  return type.is_number_integer() && type.get<int64_t>() == kFloat;
}

absl::Status CheckAttributes(const Json& document, const Json& attributes, GltfContents& result) {
  if (!attributes.is_object()) return absl::OkStatus();
  for (const auto& [name, accessor] : attributes.items()) {
    if (HasFloats(document, accessor)) continue;
    if (absl::StartsWith(name, "TEXCOORD_")) result.are_images_read = false;
    if (name != "POSITION" && name != "NORMAL") continue;
    return absl::InvalidArgumentError(
        absl::StrCat("the numbers of ", name, " are whole numbers, which the glTF extension ", kQuantization,
                     " permits, but only floating-point numbers are read: ", RemedyFor(kQuantization)));
  }
  return absl::OkStatus();
}

// Assimp decodes compressed triangles only if the file lists the extension.
absl::Status CheckDraco(const Json& document, const Json& primitive, GltfContents& result) {
  if (Extension(primitive, kDraco).is_null()) return absl::OkStatus();
  const std::vector<std::string> used = Names(Member(document, "extensionsUsed"));
  result.has_draco = std::find(used.begin(), used.end(), kDraco) != used.end();
  const Json& position = Element(document, "accessors", Member(Member(primitive, "attributes"), "POSITION"));
  if (result.has_draco || position.is_null() || !Member(position, "bufferView").is_null()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("has triangles that are compressed by the glTF extension ", kDraco,
                                                 ", but does not list it in extensionsUsed: export it again, without "
                                                 "compression"));
}

absl::Status CheckPrimitive(const Json& document, const Json& primitive, GltfContents& result) {
  const Json& mode = Member(primitive, "mode");
  if (!mode.is_null() && !(mode.is_number_unsigned() && mode.get<int64_t>() <= kMaxPrimitiveMode)) {
    return absl::InvalidArgumentError(
        absl::StrCat("a primitive of a mesh has the mode ", Escaped(mode.dump()),
                     ", but glTF defines 0 (points) to 6 (triangle fan): export the model again"));
  }
  EVPOSE_RETURN_IF_ERROR(CheckDraco(document, primitive, result));
  return CheckAttributes(document, Member(primitive, "attributes"), result);
}

bool IsNotZero(const Json& number) { return number.is_number() && number.get<double>() != 0.0; }

absl::Status CheckMeshes(const Json& document, GltfContents& result) {
  const Json& meshes = Member(document, "meshes");
  if (!meshes.is_array()) return absl::OkStatus();
  bool is_morphed = false;
  for (const Json& mesh : meshes) {
    const Json& primitives = Member(mesh, "primitives");
    const Json& weights = Member(mesh, "weights");
    if (!primitives.is_array()) continue;
    is_morphed = is_morphed || (weights.is_array() && std::any_of(weights.begin(), weights.end(), IsNotZero));
    for (const Json& primitive : primitives) EVPOSE_RETURN_IF_ERROR(CheckPrimitive(document, primitive, result));
  }
  if (is_morphed) {
    result.notices.push_back(
        "the weights of morph targets are not applied: the meshes have the shape that they have with all weights zero; "
        "export the model without morph targets if it has another shape");
  }
  return absl::OkStatus();
}

// A skin moves the points of a mesh with the nodes that it names as joints.
void NoteSkins(const Json& document, std::vector<std::string>& notices) {
  const Json& nodes = Member(document, "nodes");
  if (!nodes.is_array()) return;
  const bool has_skin = std::any_of(nodes.begin(), nodes.end(), [](const Json& node) {
    return !Member(node, "skin").is_null() && !Member(node, "mesh").is_null();
  });
  if (!has_skin) return;
  notices.push_back(
      "skins are not applied: the meshes have the shape and the place that they have without joints; export the model "
      "without a skeleton if it is posed otherwise");
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
  EVPOSE_RETURN_IF_ERROR(CheckMeshopt(document, text.data() != contents.data()));
  EVPOSE_RETURN_IF_ERROR(CheckMeshes(document, result));
  NoteSkins(document, result.notices);
  if (!result.are_images_read && !Member(document, "images").empty()) {
    result.notices.push_back(
        "the edges of the images are not used: texture coordinates that are not floating-point numbers are not read; "
        "export without quantization");
  }
  return result;
}

}  // namespace evpose::client
