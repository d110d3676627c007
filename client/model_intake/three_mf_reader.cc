// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/three_mf_reader.h"

#include <minizip/unzip.h>

#include <Eigen/Geometry>
#include <map>
#include <memory>
#include <pugixml.hpp>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Uncompressed; as kMaxFileBytes of scene_reader.cc, and for the same reason.
constexpr size_t kMaxModelBytes = size_t{512} << 20;
// Components within components; assemblies have a few levels. It bounds the recursion.
constexpr int kMaxDepth = 16;
// Largest number of placed components. Nested ones multiply, so that a small file could have billions.
constexpr size_t kMaxPlacements = 100'000;

// Section 3.4 of the specification: ST_Unit. The default is the millimetre.
constexpr std::pair<absl::string_view, double> k3mfUnits[] = {
    {"micron", 1e-6}, {"millimeter", 1e-3}, {"centimeter", 1e-2}, {"inch", 0.0254}, {"foot", 0.3048}, {"meter", 1.0}};

absl::StatusOr<double> MetresPerUnit(absl::string_view unit) {
  for (const auto& [name, metres] : k3mfUnits) {
    if (unit == name) return metres;
  }
  return absl::InvalidArgumentError(
      absl::StrCat("its unit \"", unit.substr(0, 40),
                   "\" is unknown; 3MF has micron, millimeter, centimeter, inch, foot and meter"));
}

// The model in the archive.
absl::StatusOr<std::string> ReadModelPart(const std::string& path) {
  const auto close = [](void* archive) { unzClose(archive); };
  const std::unique_ptr<void, decltype(close)> archive(unzOpen(path.c_str()), close);
  if (archive == nullptr) return absl::InvalidArgumentError("is no 3MF file: it is no archive, or it is cut off");
  for (int status = unzGoToFirstFile(archive.get()); status == UNZ_OK; status = unzGoToNextFile(archive.get())) {
    char name[256] = {};
    unz_file_info info;
    unzGetCurrentFileInfo(archive.get(), &info, name, sizeof(name) - 1, nullptr, 0, nullptr, 0);
    if (!absl::EndsWithIgnoreCase(name, ".model")) continue;
    if (info.uncompressed_size > kMaxModelBytes) return absl::InvalidArgumentError(absl::StrCat(name, " is too large"));
    std::string model(info.uncompressed_size, '\0');
    const bool is_open = unzOpenCurrentFile(archive.get()) == UNZ_OK;
    const int size =
        is_open ? unzReadCurrentFile(archive.get(), model.data(), static_cast<unsigned>(model.size())) : -1;
    if (size < 0 || static_cast<size_t>(size) != model.size() || unzCloseCurrentFile(archive.get()) != UNZ_OK) {
      return absl::InvalidArgumentError(absl::StrCat(name, " in the archive cannot be read"));
    }
    return model;
  }
  return absl::InvalidArgumentError("is no 3MF file: its archive has no .model file");
}

struct Component {
  int object = 0;
  Eigen::Affine3d placed = Eigen::Affine3d::Identity();
};

struct Object {
  std::vector<Eigen::Vector3d> points;
  std::vector<std::array<uint32_t, 3>> triangles;
  std::vector<Component> components;
};

absl::StatusOr<Component> ReadComponent(const pugi::xml_node& node) {
  Component component;
  component.object = node.attribute("objectid").as_int(-1);
  const absl::string_view text = node.attribute("transform").as_string();
  if (text.empty()) return component;
  const std::vector<absl::string_view> words = absl::StrSplit(text, absl::ByAnyChar(" \t\r\n"), absl::SkipEmpty());
  if (words.size() != 12) return absl::InvalidArgumentError("a transform does not have 12 numbers");
  for (int i = 0; i < 12; ++i) {
    // The file has row vectors: p' = p M.
    if (!absl::SimpleAtod(words[static_cast<size_t>(i)], &component.placed.matrix()(i % 3, i / 3))) {
      return absl::InvalidArgumentError(absl::StrCat("a transform has \"", words[static_cast<size_t>(i)], "\""));
    }
  }
  return component;
}

absl::StatusOr<Object> ReadObject(const pugi::xml_node& node) {
  Object object;
  for (const pugi::xml_node& vertex : node.child("mesh").child("vertices").children("vertex")) {
    Eigen::Vector3d& point = object.points.emplace_back();
    for (int i = 0; i < 3; ++i) {
      constexpr const char* kNames[] = {"x", "y", "z"};
      if (!absl::SimpleAtod(vertex.attribute(kNames[i]).as_string(), &point[i])) {
        return absl::InvalidArgumentError(
            absl::StrCat("vertex ", object.points.size() - 1, " has no number ", kNames[i]));
      }
    }
  }
  for (const pugi::xml_node& triangle : node.child("mesh").child("triangles").children("triangle")) {
    std::array<uint32_t, 3>& corners = object.triangles.emplace_back();
    for (size_t i = 0; i < 3; ++i) {
      constexpr const char* kNames[] = {"v1", "v2", "v3"};
      if (!absl::SimpleAtoi(triangle.attribute(kNames[i]).as_string(), &corners[i]) ||
          corners[i] >= object.points.size()) {
        return absl::InvalidArgumentError(absl::StrCat("triangle ", object.triangles.size() - 1, " has ", kNames[i],
                                                       "=\"", triangle.attribute(kNames[i]).as_string(),
                                                       "\", but its object has ", object.points.size(), " vertices"));
      }
    }
  }
  for (const pugi::xml_node& child : node.child("components").children("component")) {
    EVPOSE_ASSIGN_OR_RETURN(const Component component, ReadComponent(child));
    object.components.push_back(component);
  }
  return object;
}

class Builder {
 public:
  Builder(const std::map<int, Object>& objects, double metres_per_unit, size_t max_triangles)
      : objects_(objects), metres_per_unit_(metres_per_unit), counter_({.max_triangles = max_triangles}) {
    out_.mesh.lines_are_all = false;
  }

  absl::Status Add(const Component& component, const Eigen::Affine3d& parent, int depth) {
    const auto found = objects_.find(component.object);
    if (found == objects_.end()) return absl::InvalidArgumentError("builds an object that is not in it");
    if (depth > kMaxDepth || ++placements_ > kMaxPlacements) {
      return absl::InvalidArgumentError("has too many components, or components that contain themselves");
    }
    const Eigen::Affine3d placed = parent * component.placed;
    const Object& object = found->second;
    const auto first = static_cast<uint32_t>(out_.mesh.points.size());
    const bool is_mirrored = placed.linear().determinant() < 0.0;
    for (auto [a, b, c] : object.triangles) {
      EVPOSE_RETURN_IF_ERROR(counter_.AddFace(3));
      if (is_mirrored) std::swap(b, c);
      out_.mesh.triangles.push_back({first + a, first + b, first + c});
    }
    if (!object.triangles.empty()) {
      for (const Eigen::Vector3d& point : object.points) {
        out_.mesh.points.push_back(metres_per_unit_ * (placed * point));
        if (!out_.mesh.points.back().allFinite()) return absl::InvalidArgumentError("a coordinate is not finite");
      }
    }
    for (const Component& child : object.components) EVPOSE_RETURN_IF_ERROR(Add(child, placed, depth + 1));
    return absl::OkStatus();
  }

  absl::StatusOr<Scene> Take() {
    if (out_.mesh.triangles.empty()) return absl::InvalidArgumentError("builds no triangle");
    return std::move(out_);
  }

 private:
  const std::map<int, Object>& objects_;
  const double metres_per_unit_;
  ElementCounter counter_;
  size_t placements_ = 0;
  Scene out_;
};

}  // namespace

absl::StatusOr<Scene> Read3mf(const std::string& path, size_t max_triangles) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadModelPart(path));
  pugi::xml_document document;
  const pugi::xml_parse_result parsed = document.load_buffer(text.data(), text.size());
  if (!parsed) {
    return absl::InvalidArgumentError(absl::StrCat("its model, byte ", parsed.offset, ": ", parsed.description()));
  }
  const pugi::xml_node model = document.child("model");
  EVPOSE_ASSIGN_OR_RETURN(const double metres_per_unit, MetresPerUnit(model.attribute("unit").as_string("millimeter")));
  std::map<int, Object> objects;
  for (const pugi::xml_node& node : model.child("resources").children("object")) {
    EVPOSE_ASSIGN_OR_RETURN(objects[node.attribute("id").as_int(-1)], ReadObject(node));
  }
  Builder builder(objects, metres_per_unit, max_triangles);
  for (const pugi::xml_node& node : model.child("build").children("item")) {
    EVPOSE_ASSIGN_OR_RETURN(const Component item, ReadComponent(node));
    EVPOSE_RETURN_IF_ERROR(builder.Add(item, Eigen::Affine3d::Identity(), 0));
  }
  return builder.Take();
}

}  // namespace evpose::client
