// SPDX-License-Identifier: Apache-2.0

// What the tracker can be told, with units, defaults and the reason for each.
#pragma once

#include "absl/status/status.h"
#include "core/models/visibility.h"
#include "core/tracking/sensor_profile.h"
#include "core/tracking/tracker.h"
#include "core/windows/event_window.h"

namespace evpose {

// How far a pose that somebody gave may be off, one standard deviation. Image units scale with object and distance.
struct InitialPoseOptions {
  double lateral_px = 2.0;                  // sideways, in the image: what a hand-made or line-based first pose reaches
  double depth_ratio = 0.01;                // of the distance
  double rotation_rad = 0.015;              // about 1 deg
  double velocity_px_per_s = 2000.0;        // nothing is known of the motion: fast for an object that fills the image
  double angular_velocity_rad_per_s = 6.0;  // about one turn per second

  absl::Status Validate() const;
};

// White acceleration (method.md 2.8): the twist does a random walk of this strength.
struct MotionPriorOptions {
  // Depths per second^1.5: in 10 ms the velocity changes by 0.034 depths/s, 35 px/s at f = 1000 px. Relative to the
  // depth, so that the image motion counts. What is quicker, a second try follows (retry_noise_factor).
  double linear_acceleration_density = 0.34;
  // Radians per second^1.5: in 10 ms the angular velocity changes by 0.24 rad/s, as in a hand's turn.
  double angular_acceleration_density = 2.4;
  // Seconds in which a velocity changes by as much as itself, on top of both: what moves fast within a view turns in
  // it.
  double turn_time_s = 0.5;
  // Process noise of the second try after a fall of the explained share, as a factor (method.md 2.10 (4)).
  double retry_noise_factor = 250.0;

  absl::Status Validate() const;
};

struct MixtureOptions {
  // The estimated spread stays within these factors of the sensor's own (SensorProfile.pixel_noise_px): outside, it
  // fits clutter or collapses.
  double sigma_min_factor = 0.6;
  double sigma_max_factor = 2.0;
  // Pixels: half-width of the gate at the end, wide enough that clutter can be told from the line.
  double gate_px = 6.0;
  // Pixels: the widest gate to start from; it follows the prediction's uncertainty down to gate_px.
  double max_gate_px = 16.0;
  // The gate of the second try is this many times wider (method.md 2.10 (4)).
  double retry_gate_factor = 3.0;
  // Re-weighting passes over the events, at most; two do when the prediction was good, four after a surprise.
  int max_passes = 4;
  // Events that go into one window's fit: more do not help, the floor is systematic (method.md 2.10 (5)).
  int max_events = 1200;
  // So many events count as one. Once they are expected where the sensor puts them (edge_bias.h), the means of a line's
  // events scatter from millisecond to millisecond as those of independent events do.
  double events_per_information = 1.1;
  // Pixels, for a window of a second, at each end of a line: what its events have in common that nobody knows, as noise
  // of the same effect; 0.1 px in a window of a millisecond, 0.02 px over 30 ms. It is what method.md 2.10 (8) divides
  // the information for, but however many its events are, a line says no more than this; checked by NEES.
  double edge_noise_px_sqrt_s = 0.0034;
  // Pixels: where the lines' events lie farther off their lines than this, root mean square over the lines, the edge
  // noise grows with it: flicker, a profile that is not this sensor's. Below it the edges are as the profile says.
  double usual_displacement_px = 0.05;
  // Events per swept square pixel that every line is expected to make, for the evidence of absence (method.md 2.10
  // (1)). Well below what sensors give at ordinary contrast (1 to 5), so that faint or hidden lines do not brake.
  double min_events_per_px2 = 0.15;

  absl::Status Validate() const;
};

// How the lines' contrast, which the correction of the edges' bias needs, is learned (edge_bias.h). What the sensor
// makes of it is in its profile.
struct EdgeOptions {
  // Explained events of a line before anything is applied to it.
  double min_events = 200.0;
  // Explained events that its contrast is the mean of: it changes with the view and the background, within a second or
  // so.
  double memory_events = 5000.0;
  // Square pixels that a half of a line sweeps while what its pixels saw before is learned: some milliseconds.
  double turn_memory_px2 = 150.0;

  absl::Status Validate() const;
};

// The paper's static fits (its Sec. III-C and III-D), for comparison.
struct StaticOptions {
  double distance_px = 8.0;            // d_t: farthest event of a line; the paper's value
  double released_distance_px = 10.0;  // d_t of its released code
  double midpoint_ratio = 0.5;         // d_m: distance to the midpoint, of the projected length; the paper's value
  double two_lines_px = 3.0;           // d_a: events this close to two lines are rejected; the paper gives none
  int max_iterations = 20;             // re-weightings of S and of M each; both converge in fewer
  double tolerance_px = 5e-3;          // re-weighting ends when no event's distance changes by more
  int max_events = 4000;               // events per window, evenly drawn; the error is systematic beyond

  absl::Status Validate() const;
};

// The filter after Chamorro et al. (error_state_filter.h), for comparison.
struct ErrorStateFilterOptions {
  double sigma_px = 0.8;        // an event's distance to its line: as MixtureOptions' to start with, and not learned
  double gate_px = 8.0;         // farthest event of a line, before the test
  double two_lines_px = 3.0;    // events this close to two lines are rejected
  double gate_chi2 = 6.63;      // of the squared innovation over its variance: 99 %, one degree of freedom
  double injection_s = 100e-6;  // seconds: the lines are projected anew so often; 10 kHz in the published filter
  // So many events count as one (method.md 2.10 (8)). The published filter takes each for new, and its covariance
  // shrinks until the gate holds nothing but the noise.
  double events_per_information = 20.0;
  int max_events = 16'384;  // events per window, evenly drawn: all but in a flood

  absl::Status Validate() const;
};

// Track health (method.md 2.9): tests with stated false alarm rates, all on the same count of events.
struct HealthOptions {
  // Pixels: events this near to their line count as its own, of those within gate_px of it. Where nothing is, the share
  // of the near ones is that of the areas.
  double near_px = 2.0;
  double gate_px = 8.0;
  // Standard deviations by which the near events must exceed chance: 1e-3 one-sided under the normal.
  double significance_sigma = 3.1;
  // Variance of counts relative to independent events: they come in groups (see events_per_information).
  double dispersion = 5.0;
  // Events per second and pixel of background in which a moving object may come to rest: an EVK4 in dim light makes 1
  // to 3, with sensitive biases 10. Up to so many, and no denser than elsewhere on the sensor, the events near the
  // lines say nothing against a still object.
  double max_noise_hz_per_px = 10.0;
  // Events in the gate that a verdict needs.
  int min_events = 150;
  // Microseconds: a verdict is taken over at least this much.
  int64_t min_span_us = 2000;
  // Share of the testable length of lines that must be supported: a wrong pose can be fitted to about three lines'
  // worth of clutter (6 unknowns, 2 per line); a right one has nearly all, less what is hidden.
  double confirm_support_ratio = 0.6;
  double keep_support_ratio = 0.35;
  // Microseconds over which the evidence of a line that is short or slow is summed.
  int64_t memory_us = 100'000;
  // Share of the visible lines' length that must have had the time to answer before the first verdict for a pose is
  // believed, and until when a pose stays on trial: part of an object may be all of another one.
  double min_tested_ratio = 0.9;
  // Microseconds that the first verdict is held back for it, at most: a line along its motion never answers.
  int64_t max_hold_us = 15'000;
  // Microseconds after which a tracked pose that the events have not supported counts as unsupported: ten poses at 1
  // kHz.
  int64_t patience_us = 10'000;
  // Microseconds of plentiful but unexplained events, from the first such verdict on, after which the pose is LOST.
  // With the patience before it, a lost object is known as such within 50 ms.
  int64_t lost_after_us = 25'000;
  // Verdicts with plenty of events that a first pose gets.
  int max_unconfirmed_verdicts = 3;
  // Pixels: a pose that is less certain than the gate is wide cannot be told from a wrong one.
  double max_uncertainty_px = 12.0;

  absl::Status Validate() const;
};

// The search for the pose, at the start and after a loss (method.md 2.2, 2.3).
struct InitializationOptions {
  // False: the pose is only ever given, as in the published method; what is lost stays lost.
  bool is_automatic = true;
  // Microseconds of events that a search may look back on: what a slow object needs to move by a few pixels.
  int64_t memory_us = 200'000;
  // Events kept, of a window and in all: bounds memory and time in a flood.
  int max_window_events = 4096;
  int max_events = 200'000;
  // Events that a search needs: three lines of a hundred pixels that moved by one make as many.
  int min_events = 400;
  // Microseconds of sensor time between searches: the first one, and what it grows to while there are too few lines to
  // search with; a returning object waits no longer than this.
  int64_t retry_us = 5000;
  int64_t max_retry_us = 32'000;
  // The same while there are lines, of something else: a search in vain takes some ten times longer than a look for
  // lines, and must not keep the events behind it waiting.
  int64_t max_vain_retry_us = 100'000;
  // Microseconds after a pose was taken up at which the search is done again, with more events, and its hypotheses
  // challenge the pose: what the first search had overlooked is then found within 100 ms.
  int64_t review_us = 20'000;
  int num_reviews = 2;
  // Hypotheses of a search that the events are asked about.
  int max_candidates = 4;
  // Standard deviations by which the events must prefer one of two poses: 3e-5 one-sided under the normal.
  double decision_sigma = 4.0;
  // Microseconds after which the better of two poses that cannot be told apart is reported, as DEGRADED.
  int64_t undecided_us = 200'000;

  absl::Status Validate() const;
};

struct TrackerOptions {
  TrackerOptions() {
    // Exactly what is visible at the predicted pose. On ideal events of a tumbling cube a slack of 0.02 to 0.1 to
    // either side loses up to a fifth of the runs, none none.
    visibility.grazing_cosine = 0.0;
  }

  Estimator estimator = Estimator::kMixture;
  SensorProfile sensor;
  WindowOptions windows;
  VisibilityOptions visibility;
  InitialPoseOptions initial;
  InitializationOptions initialization;
  MotionPriorOptions motion;
  MixtureOptions mixture;
  EdgeOptions edge;
  StaticOptions static_fit;
  ErrorStateFilterOptions error_state_filter;
  HealthOptions health;

  // INVALID_ARGUMENT naming the group and the field that is wrong.
  absl::Status Validate() const;
};

}  // namespace evpose
