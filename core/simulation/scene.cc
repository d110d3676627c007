// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/scene.h"

#include <array>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

constexpr std::array<std::pair<SimulatedObject, std::string_view>, 5> kObjectNames = {{
    {SimulatedObject::kCube, "cube"},
    {SimulatedObject::kCuboid, "cuboid"},
    {SimulatedObject::kPlanar, "planar"},
    {SimulatedObject::kBook, "book"},
    {SimulatedObject::kSpacecraft, "spacecraft"},
}};

}  // namespace

std::string_view SimulatedObjectName(SimulatedObject object) {
  for (const auto& [value, name] : kObjectNames) {
    if (value == object) return name;
  }
  return "unknown";
}

std::vector<std::string> SimulatedObjectNames() {
  std::vector<std::string> names;
  names.reserve(kObjectNames.size());
  for (const auto& [value, name] : kObjectNames) names.emplace_back(name);
  return names;
}

absl::StatusOr<SimulatedObject> ParseSimulatedObject(std::string_view name) {
  for (const auto& [value, known] : kObjectNames) {
    if (known == name) return value;
  }
  return absl::InvalidArgumentError(absl::StrCat("no simulated object is called \"", std::string(name),
                                                 "\"; known are: ", absl::StrJoin(SimulatedObjectNames(), ", ")));
}

absl::Status BackgroundOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("BackgroundOptions.reflectance", reflectance, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BackgroundOptions.texture_contrast", texture_contrast, 0.0, 0.95));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BackgroundOptions.edge_reflectance", edge_reflectance, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BackgroundOptions.edge_speed_px_per_s", edge_speed_px_per_s, 0.0, 1e5));
  return CheckRange("BackgroundOptions.edge_tilt_ratio", edge_tilt_ratio, -2.0, 2.0);
}

absl::Status LightOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("LightOptions.flicker_depth", flicker_depth, 0.0, 0.95));
  EVPOSE_RETURN_IF_ERROR(CheckRange("LightOptions.flicker_hz", flicker_hz, 1.0, 5000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("LightOptions.change_ratio", change_ratio, 1.0, 100.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("LightOptions.change_period_s", change_period_s, 0.01, 1e4));
  return CheckRange("LightOptions.diffuse_ratio", diffuse_ratio, 0.0, 1.0);
}

absl::Status OccluderOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("OccluderOptions.swing_ratio", swing_ratio, 1e-3, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("OccluderOptions.width_px", width_px, 1.0, 1e4));
  EVPOSE_RETURN_IF_ERROR(CheckRange("OccluderOptions.speed_px_per_s", speed_px_per_s, 0.0, 1e5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("OccluderOptions.reflectance", reflectance, 0.0, 1.0));
  return CheckRange("OccluderOptions.tilt_ratio", tilt_ratio, -2.0, 2.0);
}

absl::Status SceneOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("SceneOptions.object_size_m", object_size_m, 1e-3, 1e3));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SceneOptions.lens_blur_px", lens_blur_px, 0.0, 2.0));
  EVPOSE_RETURN_IF_ERROR(motion.Validate());
  EVPOSE_RETURN_IF_ERROR(background.Validate());
  EVPOSE_RETURN_IF_ERROR(light.Validate());
  return occluder.Validate();
}

}  // namespace evpose
