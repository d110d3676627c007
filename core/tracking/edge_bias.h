// Where events lie about a moving edge, which is not on it (method.md 2.10 (2), (3)).
//
// A pixel answers to the logarithm of its light, in steps of its threshold. So the events of an edge lie to its darker
// side, the more the higher its contrast, and lag behind its motion. Uncorrected, a bright object looks larger and
// therefore nearer. An edge of contrast c makes n = c / threshold events per swept pixel, so that n, which is counted,
// gives the shift. A thin stripe is two edges, whose bright and dark events lie on opposite sides of its line: there
// the distance between the two is learned.
#pragma once

#include <array>
#include <vector>

#include "absl/types/span.h"
#include "core/tracking/association.h"
#include "core/tracking/tracker_options.h"

namespace evpose {

// What a window's explained events say of one line; by polarity, 0 OFF and 1 ON.
struct PolaritySums {
  std::array<double, 2> weight = {};
  std::array<double, 2> distance_px = {};  // weight times the distance that is left after the correction
};

class EdgeBias {
 public:
  EdgeBias(const EdgeOptions& options, const CameraModel& camera) : options_(options), camera_(camera) {}

  // Sets line.a_of_polarity: the image line displaced to where the events of each polarity are expected.
  void Correct(absl::Span<const TrackedLine> tracked, absl::Span<ImageLine> lines) const;
  // Learns the lines' contrast from a window that has been accepted. One entry of `sums` per line.
  void Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
             absl::Span<const PolaritySums> sums, double duration_s, double events_per_observation);
  void Reset() { profiles_.clear(); }

 private:
  struct Profile {
    double events = 0.0;           // remembered, explained
    double swept_px2 = 0.0;        // by the line while they came
    double polarity_motion = 0.0;  // sum of polarity (+-1) times the sign of the normal velocity
    double half_gap_px = 0.0;      // of a stripe: bright events lie this far ahead of its line, dark ones behind
  };
  // Expected distance along the line's normal of events of one polarity, `motion` the smoothed sign of its velocity.
  double ExpectedPx(const Profile& profile, double motion, int polarity) const;

  const EdgeOptions options_;
  const CameraModel camera_;
  std::vector<Profile> profiles_;  // by model line
};

}  // namespace evpose
