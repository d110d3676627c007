// Where events lie about a moving edge, which is not on it (method.md 2.10 (2), (3)).
//
// A pixel answers to the logarithm of its light, in steps of its threshold. So the events of an edge lie to its darker
// side, the more the higher its contrast, and lag behind its motion. Uncorrected, a bright object looks larger and
// therefore nearer. An edge of contrast c makes n = c / threshold events per swept pixel, so that n, which is counted,
// gives the shift. A line whose bright and dark events do not follow its motion, as those of a thin stripe, which is
// two edges, is not shifted: a step's correction would lock onto one side.
#pragma once

#include <array>
#include <vector>

#include "absl/types/span.h"
#include "core/tracking/association.h"
#include "core/tracking/tracker_options.h"

namespace evpose {

class EdgeBias {
 public:
  EdgeBias(const EdgeOptions& options, const SensorProfile& sensor, const CameraModel& camera)
      : options_(options), sensor_(sensor), camera_(camera) {}

  // Sets line.a_expected: the image line displaced to where its events are expected.
  void Correct(absl::Span<const TrackedLine> tracked, absl::Span<ImageLine> lines) const;
  // Learns the lines' contrast from a window that has been accepted. `polarity_weights`: explained OFF and ON events of
  // each line.
  void Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
             absl::Span<const std::array<double, 2>> polarity_weights, double duration_s,
             double events_per_observation);
  void Reset() { profiles_.clear(); }

 private:
  struct Profile {
    double events = 0.0;           // remembered, explained
    double swept_px2 = 0.0;        // by the line while they came
    double polarity_motion = 0.0;  // sum of polarity (+-1) times the sign of the normal velocity
  };
  // Expected distance of its events along the line's normal, `motion` the smoothed sign of its velocity.
  double ExpectedPx(const Profile& profile, double motion) const;

  const EdgeOptions options_;
  const SensorProfile sensor_;
  const CameraModel camera_;
  std::vector<Profile> profiles_;  // by model line
};

}  // namespace evpose
