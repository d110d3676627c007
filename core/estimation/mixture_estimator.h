// SPDX-License-Identifier: Apache-2.0

// Pose and twist of a window by expectation-maximisation over a normal + uniform mixture, under the motion prior
// (core/estimation/README.md, sections 1 and 2).
#pragma once

#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "core/estimation/edge_bias.h"
#include "core/estimation/estimator.h"
#include "core/estimation/mixture_pass.h"
#include "core/estimation/sensor_profile.h"

namespace evpose {

struct MixtureOptions {
  // The estimated spread stays within these factors of the sensor's own (SensorProfile.pixel_noise_px): outside, it
  // fits clutter or collapses.
  double sigma_min_factor = 0.6;
  double sigma_max_factor = 2.0;
  // Pixels: half-width of the gate at the end, wide enough that clutter can be told from the line.
  double gate_px = 6.0;
  // Pixels: the widest gate to start from; it follows the prediction's uncertainty down to gate_px.
  double max_gate_px = 16.0;
  // The gate of the second try is this many times wider (core/estimation/README.md, section 5).
  double retry_gate_factor = 3.0;
  // A second try is made when the explained ratio falls below this fraction of its running mean
  // (core/estimation/README.md, section 5). Validated on a resting object that accelerates to 0.7 m/s at once.
  double retry_explained_ratio = 0.6;
  // Re-weighting passes over the events, at most; two do when the prediction was good, four after a surprise.
  int max_passes = 4;
  // Events that go into one window's fit: more do not help, the floor is systematic (core/estimation/README.md, section
  // 8).
  int max_events = 1200;
  // So many events count as one. Once they are expected where the sensor puts them (edge_bias.h), the means of a line's
  // events scatter from millisecond to millisecond as those of independent events do.
  double events_per_information = 1.1;
  // Pixels, for a window of a second, at each end of a line: what its events have in common that nobody knows, as noise
  // of the same effect; 0.1 px in a window of a millisecond, 0.02 px over 30 ms. It is what core/estimation/README.md,
  // section 7 divides the information for, but however many its events are, a line says no more than this; checked by
  // NEES.
  double edge_noise_px_sqrt_s = 0.0034;
  // Pixels: where the lines' events lie farther off their lines than this, root mean square over the lines, the edge
  // noise grows with it: flicker, a profile that is not this sensor's. Below it the edges are as the profile says.
  double usual_displacement_px = 0.05;
  // Events per swept square pixel that every line is expected to make, for the event deficit
  // (core/estimation/README.md, section 4). Well below what sensors give at ordinary contrast (1 to 5), so that faint
  // or hidden lines do not brake.
  double min_events_per_px2 = 0.15;

  // Explained events over which the spread and the outlier ratio are averaged from window to window. They change with
  // the view and not within milliseconds, so that the average covers some five to ten windows.
  double memory_events = 5000.0;
  // Outlier ratio that the first window starts from; later windows start from the average.
  double initial_outlier_ratio = 0.2;
  // Width of a face, in standard deviations of the events about a line, from which on its two edges can be separated
  // (core/estimation/README.md, section 6).
  double narrow_face_sigma = 3.0;

  absl::Status Validate() const;
};

// What an estimator of one window's pose and twist is configured with.
struct EstimatorOptions {
  SensorProfile sensor;
  MixtureOptions mixture;
  EdgeOptions edge;
};

// `options` and `camera` must be valid.
std::unique_ptr<WindowEstimator> MakeMixtureEstimator(const EstimatorOptions& options, const CameraModel& camera);

// What the lines should have made and made in a window, by this twist. Of the events explained, `noise_per_px` for each
// pixel of a line's length come from the background, moving or not.
void CountForDeficit(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                     absl::Span<const MixtureLine> sums, const Vector6d& twist, double noise_per_px,
                     double min_events_per_px2, std::vector<DeficitCounts>& deficit_counts);

// The event deficit (core/estimation/README.md, section 4): a line that moves across itself makes events. Where
// fewer came than `deficit_counts` expects of the twist, it is braked; a one-sided Poisson penalty, added for the twist
// alone. Only as far as more than half of what the object should make is missing: while most of it speaks, silent lines
// are hidden, and braking them would drag the object away from what is seen. What one line makes too much does not make
// up for another's no_events: it is something else's that passes. In a window, a slow line should make a tenth of an
// event, and mostly makes none; `past`, of the same lines or empty, tells that from no_events. Returns the missing
// share.
double AddEventDeficit(const CameraModel& camera, absl::Span<const ImageLine> lines,
                       absl::Span<const DeficitCounts> deficit_counts, absl::Span<const DeficitCounts> past,
                       const Vector6d& twist, double scale, Matrix12d& hessian, Vector12d& gradient);

}  // namespace evpose
