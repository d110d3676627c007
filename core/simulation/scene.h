// SPDX-License-Identifier: Apache-2.0

// The simulated scene: an object, its motion, the background, the light, an occluder.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/models/object_model.h"
#include "core/simulation/motion.h"

namespace evpose {

enum class SimulatedObject {
  kCube,        // six plain faces; all 12 edges show a contrast
  kCuboid,      // 1 : 0.7 : 0.45, six plain faces
  kPlanar,      // a plate with six lines: its border and two painted steps
  kBook,        // a flat box with painted rectangles and a thin rule on its cover
  kSpacecraft,  // a bus with two solar panels of painted cells, and a mast
};

// The names are "cube", "cuboid", "planar", "book", "spacecraft".
std::string_view SimulatedObjectName(SimulatedObject object);
std::vector<std::string> SimulatedObjectNames();
// Error: INVALID_ARGUMENT listing the known names.
absl::StatusOr<SimulatedObject> ParseSimulatedObject(std::string_view name);

// The defaults are assumptions. `evpose bench tracking` runs with them ("background-edge"), and tests/bench/flicker.py
// with the texture.
struct BackgroundOptions {
  double reflectance = 0.12;      // share of white; darker than every face, so that all outlines have contrast
  bool is_textured = false;       // rectangles of several shades: the contrast of outlines changes as they move
  double texture_contrast = 0.6;  // shades are within reflectance * [1 - this, 1 + this]; only if textured
  int texture_rectangles = 160;   // number of rectangles, which cover most of the image; only if textured
  // Mean speed of all rectangles in the image along x, which oscillate as the surroundings of a camera that is turned
  // to and fro; 0: they are at rest. Every edge of them then emits events, and rendering takes several times longer.
  double texture_speed_px_per_s = 0.0;
  // A straight border, beyond which the background has another shade, oscillates behind the object, as a door or the
  // edge of a table. The contrast of the object's outlines changes as it passes.
  bool has_moving_edge = false;
  double edge_reflectance =
      0.4;  // reflectance of the other side: three times the background's, within the range of the faces
  double edge_speed_px_per_s = 500.0;  // mean; faster than the standard objects
  double edge_tilt_ratio = 0.2;        // dx / dy: not parallel to the pixels' columns

  absl::Status Validate() const;
};

// The defaults are a constant light. The scenarios of `evpose bench tracking` and tests/bench/flicker.py set flicker
// and change.
struct LightOptions {
  // A mains lamp: the light is multiplied by 1 + flicker_depth sin(2 pi flicker_hz t). 0: none. Below 0.13 the
  // amplitude of a cycle is below a default threshold; at 0.15 (a bulb) the default cube emits twice the events, at 0.3
  // ten times.
  double flicker_depth = 0.0;
  double flicker_hz = 100.0;  // twice the mains frequency
  // The light oscillates smoothly between 1 and 1 / change_ratio. 1: constant. 3 is a cloud in front of the sun.
  double change_ratio = 1.0;
  double change_period_s = 2.0;
  // Share of the light that comes from one side, so that the shade of a face depends on its attitude. 0: the shades are
  // those of the paint alone. Otherwise faces emit events over their whole area when they rotate; rendering takes
  // several times longer.
  double diffuse_ratio = 0.0;
  // Whether flicker and changes affect the background, too. By default the lamp is near the object and the background
  // is far away. With true, every pixel of the sensor emits events, 1e7 to 1e8 events/s, and the simulation is
  // correspondingly slow.
  bool reaches_background = false;

  absl::Status Validate() const;
};

// Amplitude, as a share of the image's width, of a bar that follows the object (OccluderOptions::follows_object): a
// third of the width of the standard objects, and a quarter of the diameter of a model at the distance of its preset.
// The bar then stays in front of the object. An assumption, not tuned.
inline constexpr double kFollowingSwingRatio = 0.06;

// By default there is none. The other defaults are assumptions; the scenarios with occlusion of `evpose bench tracking`
// run with them.
struct OccluderOptions {
  bool is_present = false;  // a bar in front of the scene, oscillating from side to side
  // True: the bar oscillates about the object instead of about the image's centre, and always hides a part of it, as a
  // hand that holds it. Its borders move almost as the object does.
  bool follows_object = false;
  double swing_ratio = 0.4;       // amplitude, as a share of the image's width
  double width_px = 60.0;         // hides a third of the default cube
  double speed_px_per_s = 250.0;  // mean; comparable to the speed of the object
  double reflectance = 0.3;
  double tilt_ratio = 0.15;  // dx / dy: not parallel to the pixels' columns

  absl::Status Validate() const;
};

// The finish of the whole surface of a model, without paint. The defaults are assumptions; `evpose bench models` runs
// with them.
struct MeshFinish {
  double reflectance = 0.7;  // share of white: primed metal, or light plastic; six times the background
  // Light of the highlight's centre. 0.15 is half a matt varnish: its border moves as an edge that is not on the
  // object, with about one contrast threshold.
  double specular_ratio = 0.15;

  absl::Status Validate() const;
};
// The highlight is the cosine of the angle to the mirror direction's middle to the power of 2^4: 17 degrees to half.
inline constexpr int kGlossSquarings = 4;

struct SceneOptions {
  SimulatedObject object = SimulatedObject::kCube;
  double object_size_m = 0.20;  // its longest side (spacecraft: span)
  MotionOptions motion;
  BackgroundOptions background;
  LightOptions light;
  OccluderOptions occluder;
  // Standard deviation of the lens's point spread, in addition to the square aperture of the pixel. 0.5 px: a good
  // small lens in focus; 0: ideal.
  double lens_blur_px = 0.5;
  // An object of the user instead of `object` and `object_size_m`; null: those. Its surface is rendered as the model's
  // regions describe it: smooth within a region.
  std::shared_ptr<const ObjectModel> model;
  MeshFinish finish;
  // The mean attitude of `model`: true: its z axis points to the camera and its y axis upwards, as for a printed sheet;
  // false: random.
  bool shows_front = false;

  absl::Status Validate() const;
};

}  // namespace evpose
