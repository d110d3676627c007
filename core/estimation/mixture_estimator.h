// SPDX-License-Identifier: Apache-2.0

// Estimates pose and twist of a window by expectation-maximisation over a mixture of normal (lines) and uniform
// (clutter) distances, with the motion prior (core/estimation/README.md, sections 1, 2 and 4 to 8).
#pragma once

#include <memory>

#include "absl/status/status.h"
#include "core/estimation/edge_bias.h"
#include "core/estimation/estimator.h"
#include "core/estimation/mixture_pass.h"
#include "core/estimation/sensor_profile.h"
#include "core/estimation/systematic_error.h"

namespace evpose {

// Where a field does not say more, it is validated together with the others by the position errors, losses and NEES of
// `evpose bench tracking` (core/experiments/RESULTS.md, Tracking).
struct MixtureOptions {
  // The estimated standard deviation of the events about a line stays within these factors of that of the sensor
  // (SensorProfile::pixel_noise_px). A larger one fits clutter, a smaller one collapses onto few events. README,
  // equation (4).
  double sigma_min_factor = 0.6;
  double sigma_max_factor = 2.0;
  // Pixels: half-width of the gate in the last pass. It is wide enough that the density of clutter beside the line can
  // be estimated.
  double gate_px = 6.0;
  // Pixels: largest half-width of the gate in the first pass, which follows the uncertainty of the prediction. With a
  // wider gate more lines share each event; with a narrower one the lines of a badly predicted pose lie outside.
  double max_gate_px = 16.0;
  // Factor by which the gate of a second try is wider (core/estimation/README.md, section 5): 18 px instead of 6 px.
  // Validated on a resting object that accelerates to 0.7 m/s at once. A wider gate admits more events of other edges.
  double retry_gate_factor = 3.0;
  // A second try is made when the explained ratio falls below this fraction of its running mean
  // (core/estimation/README.md, section 5). Validated on a resting object that accelerates to 0.7 m/s at once.
  double retry_explained_ratio = 0.6;
  // Largest number of passes over the events. Two suffice after a good prediction, four after a sudden acceleration.
  int max_passes = 4;
  // Largest number of events per window. More do not improve the estimate, because the remaining error is systematic
  // (core/estimation/README.md, section 8, with the validation).
  int max_events = 1200;
  // Least number of events that carry the information of one independent event; event_dispersion.h multiplies it. Once
  // edge_bias.h has corrected their expected positions, the mean distances of the events of a fast line fluctuate from
  // millisecond to millisecond nearly as those of independent events. Validated by the NEES (core/estimation/README.md,
  // section 7).
  double events_per_information = 1.1;
  // Standard deviation, in px sqrt(s), of the displacement that all events of a line in a window share (unmodelled edge
  // bias), for each end of the line: 0.1 px in a window of 1 ms, 0.02 px in one of 30 ms. It limits the information of
  // one line regardless of its number of events. Validated by the NEES (core/estimation/README.md, section 7).
  double edge_noise_px_sqrt_s = 0.0034;
  // Pixels: root mean square displacement of the events of the lines that the calibrated profile leaves. Above it, as
  // under flicker or with the profile of another sensor, edge_noise_px_sqrt_s grows in proportion. Validated by the
  // NEES of the scenarios with flicker (core/experiments/RESULTS.md, Tracking: median 2.2 to 4.2).
  double usual_displacement_px = 0.05;
  // Lower bound of the events per swept square pixel of every line, for the event deficit (core/estimation/README.md,
  // section 4). It is well below what sensors produce at ordinary contrast (1 to 5), so that faint or occluded lines do
  // not bias the twist towards zero. Validated by the scenario "rests": without the event deficit an object that stops
  // is lost.
  double min_events_per_px2 = 0.15;

  // Explained events over which the spread and the outlier ratio are averaged from window to window. They change with
  // the view and not within milliseconds, so that the average covers some five to ten windows.
  double memory_events = 5000.0;
  // Outlier ratio that the first window starts from; later windows start from the average. The passes of the first
  // window correct it: a higher start gives the events less weight in the first pass, a lower one gives clutter more.
  double initial_outlier_ratio = 0.2;
  // Width of a face, in standard deviations of the events about a line, from which on its two edges can be separated
  // (core/estimation/README.md, section 6). The value is not critical: widths of 1.5 to 5 px instead of 2.4 px gave
  // nearly the same results.
  double narrow_face_sigma = 3.0;

  absl::Status Validate() const;
};

// Configuration of an estimator.
struct EstimatorOptions {
  SensorProfile sensor;
  MixtureOptions mixture;
  EdgeOptions edge;
  SystematicOptions systematic;
};

// Makes the mixture estimator. `options` and `camera` must be valid.
std::unique_ptr<WindowEstimator> MakeMixtureEstimator(const EstimatorOptions& options, const CameraModel& camera);

}  // namespace evpose
