// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/three_mf_reader.h"

#include <map>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "client/model_intake/three_mf_archive.h"
#include "client/model_intake/three_mf_model.h"
#include "core/base/counted.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Components within components; assemblies have a few levels. It bounds the recursion.
constexpr int kMaxDepth = 16;
// Largest number of placed components. Nested ones multiply, so that a small file could have billions.
constexpr size_t kMaxPlacements = 100'000;

// Section 3.4 of the specification: ST_Unit.
constexpr absl::string_view kDefaultUnit = "millimeter";
constexpr std::pair<absl::string_view, double> k3mfUnits[] = {
    {"micron", 1e-6}, {"millimeter", 1e-3}, {"centimeter", 1e-2}, {"inch", 0.0254}, {"foot", 0.3048}, {"meter", 1.0}};

absl::StatusOr<double> MetresPerUnit(absl::string_view unit) {
  for (const auto& [name, metres] : k3mfUnits) {
    if (unit == name) return metres;
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "its unit \"", Escaped(unit), "\" is unknown; 3MF has micron, millimeter, centimeter, inch, foot and meter"));
}

absl::Status InPart(absl::string_view part, const absl::Status& status) {
  return absl::Status(status.code(), absl::StrCat(Escaped(part, 100), ": ", status.message()));
}

// Builds the object of a file, and reads its parts when a component first names them.
class Builder {
 public:
  Builder(ThreeMfArchive archive, size_t max_triangles)
      : archive_(std::move(archive)), counter_({.max_triangles = max_triangles}) {
    out_.mesh.lines_are_all = false;
  }

  absl::StatusOr<Scene> Build() {
    EVPOSE_ASSIGN_OR_RETURN(const std::string start, archive_.StartPart());
    EVPOSE_ASSIGN_OR_RETURN(const ThreeMfPart* const part, PartOf(start));
    unit_ = part->unit.empty() ? std::string(kDefaultUnit) : part->unit;
    EVPOSE_ASSIGN_OR_RETURN(metres_per_unit_, MetresPerUnit(unit_));
    for (const ThreeMfComponent& item : part->build) {
      EVPOSE_RETURN_IF_ERROR(Add(item, start, Eigen::Affine3d::Identity(), 0));
    }
    Note(num_skipped_, "object", "of the types support, solidsupport or other not used");
    Note(num_beams_, "beam lattice", "not used");
    if (out_.mesh.triangles.empty()) {
      return absl::InvalidArgumentError(
          num_skipped_ > 0 ? "builds no triangle apart from supports and auxiliary objects" : "builds no triangle");
    }
    return std::move(out_);
  }

 private:
  absl::StatusOr<const ThreeMfPart*> PartOf(const std::string& name) {
    const auto [found, is_new] = parts_.try_emplace(absl::AsciiStrToLower(name));
    if (!is_new) return &found->second;
    EVPOSE_ASSIGN_OR_RETURN(const std::string text, archive_.Read(name));
    absl::StatusOr<ThreeMfPart> part = ParseThreeMfPart(text);
    if (!part.ok()) return InPart(name, part.status());
    if (!unit_.empty() && !part->unit.empty() && part->unit != unit_) {
      return InPart(name, absl::InvalidArgumentError(
                              absl::StrCat("its unit \"", Escaped(part->unit), "\" differs from \"", Escaped(unit_),
                                           "\" of the start part; export the model with one unit")));
    }
    found->second = *std::move(part);
    return &found->second;
  }

  // `component` is in the part with the name `from`.
  absl::Status Add(const ThreeMfComponent& component, const std::string& from, const Eigen::Affine3d& parent,
                   int depth) {
    const std::string& name = component.part.empty() ? from : component.part;
    if (depth > kMaxDepth || ++num_placements_ > kMaxPlacements) {
      return absl::InvalidArgumentError("has too many components, or components that contain themselves");
    }
    EVPOSE_ASSIGN_OR_RETURN(const ThreeMfPart* const part, PartOf(name));
    const auto found = part->objects.find(component.object);
    if (found == part->objects.end()) {
      return InPart(name, absl::InvalidArgumentError(absl::StrCat("has no object ", component.object,
                                                                  ", which a build item or a component "
                                                                  "names")));
    }
    const Eigen::Affine3d placed = parent * component.placed;
    EVPOSE_RETURN_IF_ERROR(AddMesh(found->second, placed));
    for (const ThreeMfComponent& child : found->second.components) {
      EVPOSE_RETURN_IF_ERROR(Add(child, name, placed, depth + 1));
    }
    return absl::OkStatus();
  }

  // The type of an object without a mesh of its own is ignored: its components have theirs (specification, 4).
  absl::Status AddMesh(const ThreeMfObject& object, const Eigen::Affine3d& placed) {
    num_beams_ += object.has_beams ? 1 : 0;
    if (object.triangles.empty()) return absl::OkStatus();
    if (!object.is_model) {
      ++num_skipped_;
      return absl::OkStatus();
    }
    const auto first = static_cast<uint32_t>(out_.mesh.points.size());
    const bool is_mirrored = placed.linear().determinant() < 0.0;
    for (auto [a, b, c] : object.triangles) {
      EVPOSE_RETURN_IF_ERROR(counter_.AddFace(3));
      if (is_mirrored) std::swap(b, c);
      out_.mesh.triangles.push_back({first + a, first + b, first + c});
    }
    for (const Eigen::Vector3d& point : object.points) {
      out_.mesh.points.push_back(metres_per_unit_ * (placed * point));
      if (!out_.mesh.points.back().allFinite()) return absl::InvalidArgumentError("a coordinate is not finite");
    }
    return absl::OkStatus();
  }

  void Note(size_t count, absl::string_view thing, absl::string_view what) {
    if (count > 0) out_.notices.push_back(absl::StrCat(Counted(count, thing), " ", what));
  }

  ThreeMfArchive archive_;
  ElementCounter counter_;
  std::map<std::string, ThreeMfPart> parts_;  // by name in lower case
  std::string unit_;                          // of the start part
  double metres_per_unit_ = 1.0;
  size_t num_placements_ = 0;
  size_t num_skipped_ = 0;
  size_t num_beams_ = 0;
  Scene out_;
};

}  // namespace

absl::StatusOr<Scene> Read3mf(const std::string& path, size_t max_triangles) {
  EVPOSE_ASSIGN_OR_RETURN(ThreeMfArchive archive, ThreeMfArchive::Open(path));
  return Builder(std::move(archive), max_triangles).Build();
}

}  // namespace evpose::client
