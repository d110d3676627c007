// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/inspect_symmetry.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/counted.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

std::string SymmetryText(const ObjectModel& model) {
  if (model.continuous_symmetry) {
    const evpose::ContinuousSymmetry& symmetry = *model.continuous_symmetry;
    if (symmetry.kind == evpose::ContinuousSymmetry::Kind::kSphere) return "sphere: the rotation cannot be known";
    const Eigen::Vector3d& axis = symmetry.axis;
    return absl::StrFormat("continuous about the axis (%.3f, %.3f, %.3f)%s: the angle about it cannot be known",
                           axis.x(), axis.y(), axis.z(),
                           symmetry.is_flippable ? " and half turns about axes perpendicular to it" : "");
  }
  const size_t count = std::max<size_t>(1, model.symmetries.size());
  if (count == 1) return "none";
  return absl::StrCat(Counted(count, "rotation"), " map the object onto itself");
}

// "turned by 180 deg about (0.00, 0.00, 1.00)"
std::string TurnText(const NearSymmetry& near) {
  const std::string angle =
      near.is_any_angle ? "any angle" : absl::StrFormat("%.0f deg", kDegreesPerRadian * near.angle_rad);
  // A component that rounds to zero has no sign.
  const auto rounded = [](double value) { return std::abs(value) < 0.005 ? 0.0 : value; };
  return absl::StrFormat("turned by %s about (%.2f, %.2f, %.2f)", angle, rounded(near.axis.x()), rounded(near.axis.y()),
                         rounded(near.axis.z()));
}

}  // namespace

Json SymmetryJson(const ObjectModel& model) {
  Json json = {{"discrete", std::max<size_t>(1, model.symmetries.size())}, {"continuous", nullptr}};
  if (!model.continuous_symmetry) return json;
  const evpose::ContinuousSymmetry& symmetry = *model.continuous_symmetry;
  const auto vector = [](const Eigen::Vector3d& v) { return Json::array({v.x(), v.y(), v.z()}); };
  json["continuous"] = {{"kind", symmetry.kind == evpose::ContinuousSymmetry::Kind::kSphere ? "sphere" : "axis"},
                        {"centre_m", vector(symmetry.centre)},
                        {"axis", vector(symmetry.axis)},
                        {"is_flippable", symmetry.is_flippable}};
  return json;
}

Json NearSymmetriesJson(absl::Span<const NearSymmetry> near) {
  Json json = Json::array();
  for (const NearSymmetry& symmetry : near) {
    const Eigen::Vector3d& axis = symmetry.axis;
    const bool is_any = symmetry.is_any_angle;
    json.push_back({{"axis", {axis.x(), axis.y(), axis.z()}},
                    {"angle_deg", is_any ? Json(nullptr) : Json(kDegreesPerRadian * symmetry.angle_rad)},
                    {"differing_share", symmetry.differing_share},
                    {"differing_edges", symmetry.differing_edges},
                    {"differing_contours", symmetry.differing_contours},
                    {"displacement_ratio", symmetry.displacement_ratio}});
  }
  return json;
}

void PrintSymmetries(const ObjectModel& model, absl::Span<const NearSymmetry> near, std::ostream& out) {
  out << "symmetry     " << SymmetryText(model) << "\n";
  constexpr size_t kMaxPrinted = 4;  // the most similar ones, so that the report fits a screen
  for (size_t i = 0; i < std::min(kMaxPrinted, near.size()); ++i) {
    out << absl::StrFormat("near         %s, %.1f %% of the edges and outlines differ\n", TurnText(near[i]),
                           100.0 * near[i].differing_share);
  }
  if (near.size() > kMaxPrinted) {
    out << absl::StrFormat("             and %s; --json has all\n",
                           Counted(near.size() - kMaxPrinted, "further rotation"));
  }
}

void AddNearSymmetryWarning(absl::Span<const NearSymmetry> near, std::vector<std::string>& warnings) {
  if (near.empty()) return;
  warnings.push_back(absl::StrFormat(
      "the object is nearly symmetric: %s, it differs in %.1f %% of its edges and outlines. Without a prior the first "
      "pose may be that of the turned object, or AMBIGUOUS, and a track may change between the two, until a view shows "
      "clearly what differs. A first pose (--init-pose) and more edges in the model where the two differ, as those of "
      "an image or drawn lines (OBJ l), make this less likely",
      TurnText(near.front()), 100.0 * near.front().differing_share));
}

}  // namespace evpose::client
