// SPDX-License-Identifier: Apache-2.0

// Response of a sensor and lens to a moving edge (core/estimation/README.md, section 3). It is calibrated once with
// known poses (`evpose calibrate`) and never fitted to the recording that is tracked. It is stored in a YAML file
// beside that of the camera.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose {

// Constants of a sensor and lens. The defaults are those of a simulated EVK4 at its default thresholds (28 % contrast)
// behind a lens that blurs by 0.5 px, fitted by `evpose calibrate` to a cube, a cuboid and a plate at one and at four
// times their usual speed. deploy/sensors/evk4.yaml has the same values. Validated by tests/bench/sensor_settings.py
// (deploy/sensors/README.md): on sensors with thresholds of 0.1 and 0.5 instead of 0.28 the position error is 1.7 and 2
// times as large, in part because the profile does not fit.
struct SensorProfile {
  std::string name = "evk4";
  // Pixels: standard deviation of the events about their line. Rounding to pixels contributes 0.3, the several events
  // of one edge passage the rest.
  double pixel_noise_px = 0.8;
  // Pixels: standard deviation of the blur of an edge, by the lens and the width of a pixel. The shift of the events
  // towards the dark side of an edge, and their lag behind the motion, follow from blur_px, contrast_threshold and the
  // event rates of the line (edge_bias.h).
  double blur_px = 0.47;
  // Effective step of the natural logarithm of light between two events of a pixel.
  double contrast_threshold = 0.35;
  // Microseconds after an event during which the pixel is insensitive.
  double refractory_us = 140.0;
  // Microseconds by which the time stamps are late.
  double latency_us = 40.0;
  // Standard deviation of the errors of these constants, relative to the spread among sensors (SystematicOptions): 1
  // for the profile of another sensor, whose thresholds and lens may differ; 0.3 for one that `evpose calibrate` has
  // fitted; 0 for exact constants. It affects the covariance only.
  double uncertainty = 1.0;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;

  friend bool operator==(const SensorProfile&, const SensorProfile&) = default;
};

// Reads YAML with the fields above as keys; an absent key gets the default. Errors, each with the file and the field:
// those of ReadFile(); INVALID_ARGUMENT if the file is not YAML or has an unknown key, or if a value is not a number or
// is out of range.
absl::StatusOr<SensorProfile> LoadSensorProfile(const std::string& path);
absl::StatusOr<SensorProfile> ParseSensorProfile(const std::string& yaml, const std::string& name_for_errors);
// Writes YAML from which ParseSensorProfile() reads the same values, bit for bit.
std::string SensorProfileToYaml(const SensorProfile& profile);

}  // namespace evpose
