// SPDX-License-Identifier: Apache-2.0

// What the simulated camera looks at: an object, its motion, the background, the light, an occluder.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/simulation/motion.h"

namespace evpose {

enum class SimulatedObject {
  kCube,        // six plain faces; all 12 edges show a contrast
  kCuboid,      // 1 : 0.7 : 0.45, six plain faces
  kPlanar,      // a plate with six lines: its border and two painted steps
  kBook,        // a flat box whose cover carries painted rectangles and a thin rule
  kSpacecraft,  // a bus with two solar panels of painted cells, and a mast
};

// "cube", "cuboid", "planar", "book", "spacecraft".
std::string_view SimulatedObjectName(SimulatedObject object);
std::vector<std::string> SimulatedObjectNames();
// INVALID_ARGUMENT listing the known names.
absl::StatusOr<SimulatedObject> ParseSimulatedObject(std::string_view name);

struct BackgroundOptions {
  double reflectance = 0.12;  // of white; darker than every face, so that outlines show everywhere
  bool is_textured = false;   // rectangles of several shades, still: outlines then change their contrast as they move
  double texture_contrast = 0.6;  // shades lie within reflectance * [1 - this, 1 + this]; used when textured
  // A straight border, beyond which the background is of another shade, swings from side to side behind the object: a
  // door, the edge of a table. The object's outlines change their contrast as it passes.
  bool has_moving_edge = false;
  double edge_reflectance = 0.4;       // of the other side: three times the background's, within the faces' range
  double edge_speed_px_per_s = 500.0;  // mean; faster than the standard objects
  double edge_tilt_ratio = 0.2;        // dx / dy: not parallel to the pixels' columns

  absl::Status Validate() const;
};

struct LightOptions {
  // A mains lamp: light is multiplied by 1 + flicker_depth sin(2 pi flicker_hz t). 0: none. Below 0.13 a cycle swings
  // by less than a default threshold; at 0.15 (a bulb) the default cube sends twice the events, at 0.3 ten times.
  double flicker_depth = 0.0;
  double flicker_hz = 100.0;  // twice the mains frequency
  // The light swings smoothly between 1 and 1 / change_ratio. 1: steady. 3 is a cloud before the sun.
  double change_ratio = 1.0;
  double change_period_s = 2.0;
  // Share of the light that comes from one side and makes a face's shade depend on its attitude. 0: shades are those
  // of the paint alone. Faces emit events all over when they turn; rendering takes several times longer.
  double diffuse_ratio = 0.0;
  // Flicker and changes act on the background too. By default the lamp stands near the object and the background is
  // far: with true, every pixel of the sensor fires, 1e7 to 1e8 events/s, and the simulation is as slow.
  bool reaches_background = false;

  absl::Status Validate() const;
};

struct OccluderOptions {
  bool is_present = false;  // a bar before everything, swinging from side to side
  // It swings about the object instead of the image's middle, and always hides a part of it, as a hand would that
  // holds it: its borders move nearly as the object does.
  bool follows_object = false;
  double swing_ratio = 0.4;       // amplitude, as a share of the image's width
  double width_px = 60.0;         // hides a third of the default cube
  double speed_px_per_s = 250.0;  // mean; comparable with the object's own
  double reflectance = 0.3;
  double tilt_ratio = 0.15;  // dx / dy: not parallel to the pixels' columns

  absl::Status Validate() const;
};

struct SceneOptions {
  SimulatedObject object = SimulatedObject::kCube;
  double object_size_m = 0.20;  // its longest side (spacecraft: from tip to tip)
  MotionOptions motion;
  BackgroundOptions background;
  LightOptions light;
  OccluderOptions occluder;
  // Standard deviation of the lens's point spread, beside the pixel's own square aperture. 0.5 px: a good small lens
  // in focus; 0: ideal.
  double lens_blur_px = 0.5;

  absl::Status Validate() const;
};

}  // namespace evpose
