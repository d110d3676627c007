// SPDX-License-Identifier: Apache-2.0

// How a sensor deficit_counts to a moving edge: calibrated once with known poses (`evpose calibrate`), never fitted to
// the recording at hand (core/estimation/README.md, section 3). A YAML file beside the camera's.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose {

// The defaults are of a simulated EVK4 at its default thresholds (28 % contrast) behind a lens that blurs by 0.5 px,
// fitted by `evpose calibrate` to a cube, a cuboid and a plate at one and at four times their usual speed.
// deploy/sensors/evk4.yaml says the same.
struct SensorProfile {
  std::string name = "evk4";
  // Pixels: spread of events about their line, sensor's own. Rounding gives 0.3, an edge's several events the rest.
  double pixel_noise_px = 0.8;
  // The edge shift, to an edge's darker side, and the lag behind its motion follow from these two and from what an edge
  // makes of events (edge_bias.h). Pixels: standard deviation of an edge's image, by the lens and the pixel's own
  // width.
  double blur_px = 0.47;
  // Natural logarithm of light: how far apart a pixel's events are, in effect.
  double contrast_threshold = 0.35;
  // Microseconds that a pixel is held for after an event.
  double refractory_us = 140.0;
  // Microseconds by which the time stamps are late.
  double latency_us = 40.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;

  friend bool operator==(const SensorProfile&, const SensorProfile&) = default;
};

// YAML with the fields above as keys; a key that is absent has the default. Errors, each naming the file and the field:
// NOT_FOUND, INVALID_ARGUMENT (no YAML, an unknown key, what is not a number or out of range).
absl::StatusOr<SensorProfile> LoadSensorProfile(const std::string& path);
absl::StatusOr<SensorProfile> ParseSensorProfile(const std::string& yaml, const std::string& name_for_errors);
// Reads back to the same bits.
std::string SensorProfileToYaml(const SensorProfile& profile);

}  // namespace evpose
