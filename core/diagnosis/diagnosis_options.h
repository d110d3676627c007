// SPDX-License-Identifier: Apache-2.0

// The limits of the checks of a recording (README.md has the statistics).
#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "core/diagnosis/finding.h"

namespace evpose {

struct Range {
  double low = 0.0;
  double high = 0.0;
  bool Contains(double value) const { return value >= low && value <= high; }
};

// The limits are validated by diagnosis_test and by tests/bench/doctor.py: detections and false alarms on simulated
// sensors with and without each defect, and on real recordings (core/diagnosis/README.md, Measured). The limits of the
// event rate follow from `evpose bench speed` (core/experiments/RESULTS.md, Speed).
struct DiagnosisOptions {
  // Largest probability of a false report, for each check that has a statistical model. With some 20 checks the user
  // sees one false report in 50,000 recordings. The models are approximations, so that a smaller probability would not
  // be credible.
  double false_alarm_probability = 1e-6;

  // Share of the events that come from hot pixels. A percent has no effect on poses, but costs the link that much; a
  // tenth is as much as the events of an edge at low speed.
  Limits hot_share = {0.01, 0.1};
  // A hot pixel has, beyond chance, this many times the upper quartile of the events of the pixels around it: a pixel
  // at the turning point of an edge has about three times the events of its neighbours.
  double hot_ratio = 8.0;
  // Share of the events that are noise. In simulation (deploy/sensors/README.md) 83 % noise increase errors by a third,
  // and five times the events of the object have to be transferred.
  Limits noise_share = {0.6, 0.9};
  // Share of the events in time with the flicker of a lamp. In simulation, a lamp that flickers by 5 % gives up to 0.6
  // and one of 10 % up to 0.8, which costs nothing; one of 20 % gives 0.97 and more, and one of 30 % costs a factor of
  // four. The search for a first pose removes such events itself (core/detection/flicker_filter.h).
  Limits flicker_share = {0.6, 0.85};
  // Hertz: slower changes of the light are those of motion. Lamps at the mains flicker at 100 or 120 Hz, dimmed ones
  // and screens at 50 and more.
  double min_flicker_hz = 45.0;
  // Magnitude of the sum over the parts of the image, per sum of their magnitudes. Unrelated phases of n parts give
  // 0.9 / sqrt(n), 0.5 for the least number of parts.
  double min_coherence = 0.8;
  // Parts of the image, of 8 x 8, among which a line of the spectrum is distributed: one part may show a machine.
  double min_flicker_parts = 3.0;
  // Ratio of the ON and OFF events, or its inverse. If the light of most pixels returns to what it was, the thresholds
  // have the same ratio; what does not return makes up to 1.6 in simulated recordings of half a second with equal
  // thresholds, and 2.2 in real ones. Edges of both directions are then displaced differently from the profile's.
  Limits polarity_ratio = {2.5, 4.0};
  // Pixels: standard deviation of the blur of edges, by lens, pixel and bandwidth. In simulation, 1 px instead of 0.5
  // px makes the error four times as large, 2 px seventeen times; the limits lie between these.
  Limits blur_px = {0.9, 1.4};
  // Share of the pixels in areas without events.
  Limits dead_share = {1e-4, 0.1};
  // Pixels per second: the search for a first pose needs a motion of some 6 px, within its second of events. Slower
  // objects may be found late; at 2 px/s edges move by less than a pixel between searches.
  double advice_speed_px_per_s = 6.0;
  double problem_speed_px_per_s = 2.0;
  // Events in 20 ms, without noise. With fewer a window closes on time (WindowOptions::min_events), as if nothing
  // moved.
  double min_events_in_20_ms = 150.0;
  // Events per second in the busiest tenth of the time. At 50 Mev/s one session takes 0.8 of a core (evpose bench
  // speed); 20 Mev/s are 0.6 Gbit/s of EVT3, as much as a 1 Gbit/s link carries beside its other load.
  Limits event_rate_per_s = {20e6, 50e6};
  // Microseconds between the values that time stamps take. An object at 1000 px/s moves by 0.1 px in 100 us, which is
  // negligible, and by 1 px in 1 ms, the usual duration of a window.
  Limits time_step_us = {100.0, 1000.0};
  // Microseconds by which time stamps step back. Events within a window may have any order; a window is at least 500
  // us.
  Limits step_back_us = {0.0, 500.0};
  // Microseconds without any event, between times at which a gap of this length had 50 events. 20 ms is the longest
  // window; the motion in a longer gap is unknown.
  Limits gap_us = {10e3, 20e3};
  // Share of words or events that could not be decoded. A camera sends none; a few at the start of a recording are
  // normal.
  Limits decode_fault_share = {1e-5, 1e-3};
  // Metres: the sizes of models, and their distances from the camera by the extent of the moving region. Objects
  // outside `usual` are rare, those outside `possible` are in another unit: cameras see objects from a millimetre to a
  // building.
  Range usual_diameter_m = {0.005, 5.0};
  Range possible_diameter_m = {1e-3, 30.0};
  Range usual_distance_m = {0.03, 20.0};
  Range possible_distance_m = {0.01, 300.0};
  // The pixels of a sensor: bounds the memory at some 60 bytes per pixel. The largest event cameras have 2 million.
  int64_t max_pixels = 8'000'000;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

}  // namespace evpose
