// SPDX-License-Identifier: Apache-2.0

// Where events lie about a moving edge, which is not on it (core/estimation/README.md, section 3).
//
// A line that moves across itself makes n events per square pixel that it sweeps; in a share h of the swept pixels the
// first of them turns round: the pixel's event before had the other polarity. Turning round costs a threshold c, so
// that the edge's log contrast is L = (n + h) c, and the levels at which events come begin h c after its beginning. n
// and h are counted; with c and the blur, which are the sensor's (sensor_profile.h), edge_response.h then has the
// events' mean distance from the edge: to its darker side, the more the higher the contrast, and behind its motion, the
// more the lower it is. Uncorrected, a bright object looks larger and therefore nearer.
#pragma once

#include <array>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/estimation/edge_response.h"
#include "core/estimation/sensor_profile.h"

namespace evpose {

// Events of a line that a window's fit explains, weighted, those that were not kept with them.
struct EdgeCounts {
  std::array<double, 2> polarity = {};  // OFF and ON
  // After an event of the other polarity, half where nobody knows; on the line's first half and on its second.
  std::array<double, 2> turns = {};

  void Add(const Observation& event, int half, double weight) {
    polarity[event.polarity] += weight;
    turns[half] += event.TurnRatio() * weight;
  }
};

// What a moving line makes of events.
struct EdgeRates {
  double events_per_px2 = 0.0;        // of the area that it sweeps while its pixels can answer
  double turns_per_px2 = 0.0;         // after one of the other polarity; of all the area
  double recent_turns_per_px2 = 0.0;  // the same, lately
  double kappa = 0.0;                 // mean of polarity (+-1) times the sign of the normal velocity
};

// The area that a line sweeps while its pixels can answer. After an event a pixel is held, and misses what the edge
// does meanwhile: at `speed` it moves on by a part of its width, with as much of its contrast.
double LiveAreaPx2(const SensorProfile& sensor, double swept_px2, double events, double speed_px_per_s);

// Expected distance of its events along the line's normal but for the latency, pixels; `motion` is the sign of its
// normal velocity, smoothed near rest.
double ExpectedEdgePx(const SensorProfile& sensor, const EdgeRates& rates, double motion);

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

class EdgeBias {
 public:
  EdgeBias(const EdgeOptions& options, const SensorProfile& sensor, const CameraModel& camera)
      : options_(options), sensor_(sensor), camera_(camera) {}

  // Sets line.a_expected: the image line displaced to where its events are expected.
  void Correct(absl::Span<const TrackedLine> tracked, absl::Span<ImageLine> lines) const;
  // Learns the lines' contrast from a window that has been accepted; one entry of `counts` per line.
  void Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
             absl::Span<const EdgeCounts> counts, double duration_s);
  void Reset() { profiles_.clear(); }

  static void VisitState(auto& archive, auto& self) {
    auto& [options, sensor, camera, profiles] = self;
    archive(profiles);
  }

 private:
  struct Profile {
    double events = 0.0;           // remembered, explained
    double swept_px2 = 0.0;        // by the line while they came
    double live_px2 = 0.0;         // of it, while pixels could answer
    double polarity_motion = 0.0;  // sum of polarity (+-1) times the sign of the normal velocity
    double turns = 0.0;            // over the whole memory
    // The same over a few milliseconds: what the pixels saw before changes as soon as the motion does.
    std::array<double, 2> recent_turns = {};
    std::array<double, 2> recent_swept_px2 = {};

    // Within bounds that no line comes near and no table is left by.
    static void VisitState(auto& archive, auto& self) {
      auto& [events, swept_px2, live_px2, polarity_motion, turns, recent_turns, recent_swept_px2] = self;
      constexpr double kMax = 1e15;
      bool is_empty = events == 0 && swept_px2 == 0;
      archive(is_empty);
      if (is_empty) return;
      archive(AtMost(events, kMax), AtMost(swept_px2, kMax), AtMost(live_px2, kMax),
              InRange(polarity_motion, -kMax, kMax), AtMost(turns, kMax));
      for (int half = 0; half < 2; ++half)
        archive(AtMost(recent_turns[half], kMax), AtMost(recent_swept_px2[half], kMax));
    }
  };
  // `velocity`: normal to the line.
  void Add(const EdgeCounts& counts, double velocity_px_per_s, const std::array<double, 2>& swept_px2,
           Profile& profile) const;
  // Expected distance of its events along the line's normal, `motion` the smoothed sign of its velocity.
  double ExpectedPx(const Profile& profile, int half, double motion) const;

  const EdgeOptions options_;
  const SensorProfile sensor_;
  const CameraModel camera_;
  std::vector<Profile> profiles_;  // by model line
};

}  // namespace evpose
