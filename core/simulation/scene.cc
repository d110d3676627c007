// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/scene.h"

#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {
absl::Status BackgroundOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("BackgroundOptions.reflectance", reflectance, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BackgroundOptions.texture_contrast", texture_contrast, 0.0, 0.95));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BackgroundOptions.texture_rectangles", texture_rectangles, 1, 10'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("BackgroundOptions.texture_speed_px_per_s", texture_speed_px_per_s, 0.0, 1e5));
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

absl::Status MeshFinish::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("MeshFinish.reflectance", reflectance, 0.0, 1.0));
  return CheckRange("MeshFinish.specular_ratio", specular_ratio, 0.0, 1.0);
}

absl::Status SceneOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("SceneOptions.object_size_m", object_size_m, 1e-3, 1e3));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SceneOptions.lens_blur_px", lens_blur_px, 0.0, 2.0));
  if (model != nullptr && model->triangles.empty()) {
    return absl::InvalidArgumentError("SceneOptions.model has no face, only lines; a surface can be simulated");
  }
  EVPOSE_RETURN_IF_ERROR(finish.Validate());
  EVPOSE_RETURN_IF_ERROR(motion.Validate());
  EVPOSE_RETURN_IF_ERROR(background.Validate());
  EVPOSE_RETURN_IF_ERROR(light.Validate());
  return occluder.Validate();
}

}  // namespace evpose
