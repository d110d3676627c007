// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "absl/status/status.h"

namespace evpose {

// Sectors of the outline in which the events are compared with those that the motion should cause. With more sectors
// each has too few events to be tested; with fewer a hidden part of the outline must be larger to be noticed (README,
// section 1).
inline constexpr int kNumOutlineSectors = 8;

// Thresholds of the tests of core/tracking/README.md, section 1. All tests use the same event counts and have stated
// false alarm rates; they were validated on simulated recordings with truth (core/experiments/RESULTS.md) and on the
// tests of this folder.
struct HealthOptions {
  // Pixels. An event counts as near its line if its distance is at most near_px and at most half of the half-width of
  // the line's cell there (README, section 1); events beyond gate_px are not counted. Under uniform clutter the share
  // of near events among those of a cell equals the ratio of the widths. With the spreads below, near_px contains 79 to
  // 95 % of a line's own events (a normal distribution), and with gate_px a quarter of those of clutter.
  double near_px = 2.0;
  double gate_px = 8.0;
  // Pixels. The standard deviation of the events about a line at the right pose, which determines the power of the
  // tests, is that of the fit within these bounds. They are the noise of the sensor (SensorProfile::pixel_noise_px,
  // 0.8) with an error of the pose of 0.6 px, and twice the noise, the largest spread of an estimate.
  double min_spread_px = 1.0;
  double max_spread_px = 1.6;
  // Standard deviations by which the near events must exceed chance: 1e-3 one-sided under the normal.
  double significance_sigma = 3.1;
  // Standard deviations that the near events would exceed chance by at the right pose: a test with less power does not
  // contradict a pose. The right pose then remains below significance_sigma in 3 % of the tests of a line.
  double power_sigma = 5.0;
  // Variance of event counts relative to independent events, which is above 1 because one edge passage triggers several
  // events (see MixtureOptions::events_per_information).
  double dispersion = 5.0;
  // Background events per second and pixel. An EVK4 in dim light produces 1 to 3, with sensitive biases 10. Events near
  // the lines at up to this rate, and no denser than elsewhere on the sensor, do not contradict an object at rest.
  double max_noise_hz_per_px = 10.0;
  // Share of the excess that is expected at the right pose below which the events as a whole do not support a pose,
  // however significant the excess is: uniform clutter is never exactly uniform.
  double min_excess_ratio = 0.2;
  // A pose is doubtful if its events are spread by more than the noise of the sensor (SensorProfile::pixel_noise_px,
  // 0.8) and an error of 0.3 px, and are less than min_contrast times as dense on the lines as beside them
  // (line_contrast.h; README, section 1). Validated on recordings of real objects, right and wrong ones.
  double wide_spread_px = 0.85;
  double min_contrast = 30.0;
  // Microseconds over which the events of this contrast are summed. A wrong pose has the contrast of a right one for up
  // to 160 ms: a puzzle cube that was searched for in 16 parts of a recording of a phone was TRACKING in 742 poses with
  // 100 ms, and in 49 with 1 s.
  int64_t contrast_memory_us = 1'000'000;
  // Gated events that a test result requires: with fewer, single events decide about a line. More would delay all
  // results.
  int min_events = 150;
  // Microseconds that a test covers at least, two windows at 1 kHz: the error of a single window does not decide.
  int64_t min_span_us = 2000;
  // Share of the testable length of lines that must be supported. A wrong pose can be fitted to about three lines of
  // clutter (6 unknowns, 2 per line); at the right pose nearly all lines that are not occluded are supported.
  double confirm_support_ratio = 0.6;
  double keep_support_ratio = 0.35;
  // Lines that must be supported to confirm a tentative pose and to keep a confirmed one. Three lines determine the six
  // unknowns of a pose, and two restrict all but a small part of its motion.
  int confirm_lines = 3;
  int keep_lines = 2;
  // Events per window, above the background, that a decision about the window requires: a second try of the estimate,
  // and the update of the running means. The relative fluctuation of fewer events exceeds the effects that are tested.
  double min_signal_events = 50.0;
  // Microseconds over which the counts of a short or slow line are summed.
  int64_t memory_us = 100'000;
  // Share of the length of the visible lines that must have been testable before the first support confirms a tentative
  // track: a part of one object can equal the whole of another.
  double min_tested_ratio = 0.9;
  // Microseconds after which the first confirmation no longer waits for min_tested_ratio: a line that moves along
  // itself produces no events and never becomes testable.
  int64_t max_hold_us = 15'000;
  // Least time, microseconds, after which a confirmed pose without support counts as unsupported: ten poses at 1 kHz.
  // At low event rates the power of the test determines the time.
  int64_t min_contradiction_us = 10'000;
  // Microseconds from the first unsupported test result on after which a further one makes the pose LOST. At ordinary
  // event rates a loss is thereby reported within 50 ms.
  int64_t lost_after_us = 25'000;
  // Sectors of the eight of the outline that may lack their events while a pose counts as supported: an occluder that
  // hides a third of the width of a disc hides three of them.
  int max_missing_sectors = 3;
  // Share of the testable length that may be displaced while a pose counts as supported. A displaced line has events
  // along it, but not at it (README, section 1). Most right poses in the scenarios of bench tracking have a share of 0;
  // where a bar hides 40 % of the cube (occlusion-40), 6 % of the tests have more than 0.15. The pose of a funnel with
  // an error of 10 degrees had about 0.2 (bench models).
  double max_displaced_ratio = 0.15;
  // Number of contradicting test results after which a tentative pose is rejected. A smaller number may reject a right
  // pose before its depth has converged; a larger number keeps wrong poses for longer.
  int max_contradictions = 3;
  // Pixels. Largest projected uncertainty of a pose. A larger uncertainty exceeds the width of the gate, so that the
  // events do not distinguish a right pose from a wrong one.
  double max_uncertainty_px = 12.0;
  // Pixels. Projected uncertainty, from the supported curves without any single one of them, up to which a pose is
  // confirmed although edges that should have events have none. Inner edges between faces of the same brightness have
  // none at the right pose; there the uncertainty was 0.1 to 0.5 px where it remained DEGRADED (README, section 1).
  double sure_uncertainty_px = 0.5;

  absl::Status Validate() const;
};

}  // namespace evpose
