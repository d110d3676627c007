// How a sensor answers to a moving edge: calibrated once with known poses (`evpose calibrate`), never fitted to the
// recording at hand (method.md 2.10 (2)). A YAML file beside the camera's.
#pragma once

#include <string>

#include "absl/status/status.h"

namespace evpose {

// The defaults are of a simulated EVK4 at its default thresholds (28 % contrast) behind a lens that blurs by 0.5 px.
struct SensorProfile {
  std::string name = "evk4";
  // Pixels: spread of events about their line, sensor's own. Rounding gives 0.3, an edge's several events the rest.
  double pixel_noise_px = 0.8;
  // Pixels that events lag behind a moving edge at any speed: about half of the light's step to the next threshold.
  double lag_px = 0.16;
  // Pixels to an edge's darker side, for each event per swept square pixel: the latter tells the contrast. It grows
  // with the lens's blur.
  double edge_shift_px_per_event = 0.062;
  double max_edge_shift_px = 0.4;
  // Microseconds by which the time stamps are late.
  double latency_us = 0.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

}  // namespace evpose
