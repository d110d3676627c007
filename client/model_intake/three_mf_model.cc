// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/three_mf_model.h"

#include <algorithm>
#include <iterator>
#include <pugixml.hpp>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Extensions that a part may require. Materials have no effect on the surface, and sets of triangles name parts of it.
constexpr absl::string_view kReadExtensions[] = {"http://schemas.microsoft.com/3dmanufacturing/production/2015/06",
                                                 "http://schemas.microsoft.com/3dmanufacturing/material/2015/02",
                                                 "http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07"};

std::vector<absl::string_view> Words(absl::string_view text) {
  return absl::StrSplit(text, absl::ByAnyChar(" \t\r\n"), absl::SkipEmpty());
}

absl::Status CheckExtensions(const pugi::xml_node& model) {
  for (const absl::string_view prefix : Words(model.attribute("requiredextensions").as_string())) {
    const absl::string_view name = model.attribute(absl::StrCat("xmlns:", prefix).c_str()).as_string();
    if (std::find(std::begin(kReadExtensions), std::end(kReadExtensions), name) != std::end(kReadExtensions)) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("requires the 3MF extension ", Escaped(name.empty() ? prefix : name, 100),
                     ", which is not read; export the object as triangles without it, or as STL or STEP"));
  }
  return absl::OkStatus();
}

// The attribute `path` of the production extension, whose prefix is up to the file.
std::string PathOf(const pugi::xml_node& node) {
  for (const pugi::xml_attribute& attribute : node.attributes()) {
    if (absl::EndsWith(attribute.name(), ":path")) return attribute.as_string();
  }
  return "";
}

absl::StatusOr<ThreeMfComponent> ReadComponent(const pugi::xml_node& node) {
  ThreeMfComponent component;
  component.part = PathOf(node);
  component.object = node.attribute("objectid").as_int(-1);
  const absl::string_view text = node.attribute("transform").as_string();
  if (text.empty()) return component;
  const std::vector<absl::string_view> words = Words(text);
  if (words.size() != 12) {
    return absl::InvalidArgumentError(absl::StrCat("a transform has ", words.size(), " numbers instead of 12"));
  }
  for (int i = 0; i < 12; ++i) {
    // The file has row vectors: p' = p M.
    if (!absl::SimpleAtod(words[static_cast<size_t>(i)], &component.placed.matrix()(i % 3, i / 3))) {
      return absl::InvalidArgumentError(
          absl::StrCat("a transform has ", Quoted(words[static_cast<size_t>(i)]), ", which is not a number"));
    }
  }
  return component;
}

absl::Status ReadMesh(const pugi::xml_node& mesh, ThreeMfObject& object) {
  for (const pugi::xml_node& vertex : mesh.child("vertices").children("vertex")) {
    Eigen::Vector3d& point = object.points.emplace_back();
    for (int i = 0; i < 3; ++i) {
      constexpr const char* kNames[] = {"x", "y", "z"};
      if (!absl::SimpleAtod(vertex.attribute(kNames[i]).as_string(), &point[i])) {
        return absl::InvalidArgumentError(
            absl::StrCat("vertex ", object.points.size() - 1, " has no number ", kNames[i]));
      }
    }
  }
  for (const pugi::xml_node& triangle : mesh.child("triangles").children("triangle")) {
    std::array<uint32_t, 3>& corners = object.triangles.emplace_back();
    for (size_t i = 0; i < 3; ++i) {
      constexpr const char* kNames[] = {"v1", "v2", "v3"};
      const absl::string_view index = triangle.attribute(kNames[i]).as_string();
      if (!absl::SimpleAtoi(index, &corners[i]) || corners[i] >= object.points.size()) {
        return absl::InvalidArgumentError(absl::StrCat("triangle ", object.triangles.size() - 1, " has ", kNames[i],
                                                       "=", Quoted(index), ", but its object has ",
                                                       object.points.size(), " vertices"));
      }
    }
  }
  for (const pugi::xml_node& child : mesh.children()) {
    object.has_beams = object.has_beams || absl::EndsWith(child.name(), ":beamlattice");
  }
  return absl::OkStatus();
}

absl::StatusOr<ThreeMfObject> ReadObject(const pugi::xml_node& node) {
  ThreeMfObject object;
  const absl::string_view type = node.attribute("type").as_string("model");
  object.is_model = type != "support" && type != "solidsupport" && type != "other";
  EVPOSE_RETURN_IF_ERROR(ReadMesh(node.child("mesh"), object));
  for (const pugi::xml_node& child : node.child("components").children("component")) {
    EVPOSE_ASSIGN_OR_RETURN(object.components.emplace_back(), ReadComponent(child));
  }
  return object;
}

}  // namespace

absl::StatusOr<ThreeMfPart> ParseThreeMfPart(const std::string& text) {
  pugi::xml_document document;
  const pugi::xml_parse_result parsed = document.load_buffer(text.data(), text.size());
  if (!parsed) return absl::InvalidArgumentError(absl::StrCat("byte ", parsed.offset, ": ", parsed.description()));
  const pugi::xml_node model = document.child("model");
  EVPOSE_RETURN_IF_ERROR(CheckExtensions(model));
  ThreeMfPart part;
  part.unit = model.attribute("unit").as_string();
  for (const pugi::xml_node& node : model.child("resources").children("object")) {
    const int id = node.attribute("id").as_int(-1);
    absl::StatusOr<ThreeMfObject> object = ReadObject(node);
    if (!object.ok()) {
      return absl::InvalidArgumentError(absl::StrCat("object ", id, ": ", object.status().message()));
    }
    part.objects[id] = *std::move(object);
  }
  for (const pugi::xml_node& node : model.child("build").children("item")) {
    EVPOSE_ASSIGN_OR_RETURN(part.build.emplace_back(), ReadComponent(node));
  }
  return part;
}

}  // namespace evpose::client
