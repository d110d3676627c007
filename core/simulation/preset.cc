// SPDX-License-Identifier: Apache-2.0

// The standard scenes and cameras.
#include <array>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/check_range.h"
#include "core/base/find_named.h"
#include "core/base/length_text.h"
#include "core/base/status_macros.h"
#include "core/simulation/simulator.h"

namespace evpose {
namespace {

struct ObjectPreset {
  SimulatedObject object;
  std::string_view name;
  double size_m;
  double speed_m_per_s;
  double angular_speed_rad_per_s;
};

// The objects, in the order of the enumerators. Sizes and speeds are such that an EVK4 at the default thresholds
// produces about 1e6 events/s.
constexpr std::array<ObjectPreset, 5> kObjects = {{
    {SimulatedObject::kCube, "cube", 0.20, 0.31, 0.8},
    {SimulatedObject::kCuboid, "cuboid", 0.26, 0.31, 0.8},
    {SimulatedObject::kPlanar, "planar", 0.26, 0.45, 1.1},
    {SimulatedObject::kBook, "book", 0.25, 0.22, 0.55},
    {SimulatedObject::kSpacecraft, "spacecraft", 0.42, 0.27, 0.7},
}};
static_assert(kObjects.back().object == SimulatedObject::kSpacecraft);

absl::StatusOr<ObjectPreset> FindObject(std::string_view name) {
  return FindNamed(kObjects, std::string(name), "no simulated object is called \"$0\"");
}

absl::StatusOr<CameraModel> FindCamera(std::string_view name) {
  if (name == "evk4") return SimulationOptions::SimulatedEvk4Camera();
  if (name == "vga") return SimulationOptions::SimulatedVgaCamera();
  return absl::InvalidArgumentError(absl::StrCat("no simulated camera is called \"", std::string(name),
                                                 "\"; known are: ", absl::StrJoin(SimulatedCameraNames(), ", ")));
}

}  // namespace

std::string_view SimulatedObjectName(SimulatedObject object) { return kObjects[static_cast<size_t>(object)].name; }

std::vector<std::string> SimulatedObjectNames() {
  std::vector<std::string> names;
  for (const ObjectPreset& preset : kObjects) names.emplace_back(preset.name);
  return names;
}

absl::StatusOr<SimulatedObject> ParseSimulatedObject(std::string_view name) {
  EVPOSE_ASSIGN_OR_RETURN(const ObjectPreset preset, FindObject(name));
  return preset.object;
}

CameraModel SimulationOptions::SimulatedEvk4Camera() {
  return {1280, 720, 1030.0, 1030.0, 643.5, 356.5, {-0.08, 0.05, 0.0003, -0.0002, 0.0}};
}

CameraModel SimulationOptions::SimulatedVgaCamera() {
  return {640, 480, 515.0, 515.0, 321.5, 237.5, {-0.08, 0.05, 0.0003, -0.0002, 0.0}};
}

std::vector<std::string> SimulatedCameraNames() { return {"evk4", "vga"}; }

void UseCamera(const CameraModel& camera, SimulationOptions& options) {
  const CameraModel evk4 = SimulationOptions::SimulatedEvk4Camera();
  const double length = (camera.MaxFocalPx() / camera.width_px) / (evk4.MaxFocalPx() / evk4.width_px);
  options.camera = camera;
  if (length <= 1.0) return;
  options.scene.motion.depth_m *= length;
  options.scene.motion.speed_m_per_s *= length;
}

absl::StatusOr<SimulationOptions> SimulationPreset(std::string_view object_name, std::string_view camera_name,
                                                   double speed_scale) {
  SimulationOptions options;
  EVPOSE_ASSIGN_OR_RETURN(const ObjectPreset preset, FindObject(object_name));
  EVPOSE_ASSIGN_OR_RETURN(options.camera, FindCamera(camera_name));
  EVPOSE_RETURN_IF_ERROR(CheckRange("speed_scale", speed_scale, 0.0, 100.0));
  options.scene.object = preset.object;
  options.scene.object_size_m = preset.size_m;
  options.scene.motion.speed_m_per_s = speed_scale * preset.speed_m_per_s;
  options.scene.motion.angular_speed_rad_per_s = speed_scale * preset.angular_speed_rad_per_s;
  return options;
}

absl::StatusOr<SimulationOptions> ModelSimulationPreset(std::shared_ptr<const ObjectModel> model,
                                                        std::string_view camera_name, double speed_scale) {
  // At this multiple of its diameter, an object has 300 px in the image of an EVK4 (f = 1030 px): half of its height.
  constexpr double kDepthToDiameter = 3.4;
  constexpr double kSpeedToDepth = 0.31;  // per second: that of the cube, 320 px/s
  // Share of the light that comes from the lamp. There are a lamp and bright walls: faces that are turned away from the
  // lamp have a third of its light, which is twice that of the background, or two contrast thresholds.
  constexpr double kDiffuseRatio = 0.65;
  // The limits of MotionOptions::depth_m, converted to the diameter.
  constexpr double kLeastDiameter = 0.01 / kDepthToDiameter, kLargestDiameter = 1e4 / kDepthToDiameter;
  SimulationOptions options;
  EVPOSE_ASSIGN_OR_RETURN(options.camera, FindCamera(camera_name));
  EVPOSE_RETURN_IF_ERROR(CheckRange("speed_scale", speed_scale, 0.0, 100.0));
  if (model->triangles.empty()) {
    return absl::InvalidArgumentError(
        "the model has no face, only lines, and the simulator draws faces: give a model with faces");
  }
  if (!(model->diameter_m >= kLeastDiameter && model->diameter_m <= kLargestDiameter)) {
    return absl::InvalidArgumentError(absl::StrCat("the model is ", FormatLength(model->diameter_m),
                                                   " across, and the simulator has objects of ",
                                                   FormatLength(kLeastDiameter), " to ", FormatLength(kLargestDiameter),
                                                   ": check --scale, the metres per unit of the file"));
  }
  MotionOptions& motion = options.scene.motion;
  motion.depth_m = kDepthToDiameter * model->diameter_m;
  motion.speed_m_per_s = speed_scale * kSpeedToDepth * motion.depth_m;
  motion.angular_speed_rad_per_s = speed_scale * motion.angular_speed_rad_per_s;
  options.scene.light.diffuse_ratio = kDiffuseRatio;
  options.scene.model = std::move(model);
  EVPOSE_RETURN_IF_ERROR(options.scene.Validate());
  return options;
}

}  // namespace evpose
