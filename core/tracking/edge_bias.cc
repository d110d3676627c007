#include "core/tracking/edge_bias.h"

#include <algorithm>
#include <cmath>

namespace evpose {
namespace {

// Speed along the image normal at a fraction of the line, pixels per second.
double NormalSpeed(const CameraModel& camera, const ImageLine& line, double fraction) {
  return -BearingOf(camera, line.PointAt(fraction)).dot(line.a_dot);
}

// The direction of motion, smoothed near rest, where it cannot be known.
double MotionSign(double speed_px_per_s) {
  constexpr double kSmoothPxPerS = 15.0;
  return speed_px_per_s / std::sqrt(speed_px_per_s * speed_px_per_s + kSmoothPxPerS * kSmoothPxPerS);
}

// Below this |kappa| a line is taken for a stripe, above the other for an edge; between them nothing is applied.
constexpr double kStripeKappa = 0.3;
constexpr double kEdgeKappa = 0.6;

}  // namespace

double EdgeBias::ExpectedPx(const Profile& profile, double motion, int polarity) const {
  if (profile.events < options_.min_events) return 0.0;
  const double kappa = profile.polarity_motion / profile.events;
  const double lag_px = -options_.lag_px * motion;
  if (std::abs(kappa) >= kEdgeKappa) {
    const double density = profile.events / std::max(profile.swept_px2, 1.0);
    const double shift_px = std::min(options_.shift_px_per_event * density, options_.max_shift_px);
    return lag_px + kappa * shift_px;
  }
  if (std::abs(kappa) <= kStripeKappa) return lag_px + motion * (polarity == 1 ? 1.0 : -1.0) * profile.half_gap_px;
  return lag_px;
}

void EdgeBias::Correct(absl::Span<const TrackedLine> tracked, absl::Span<ImageLine> lines) const {
  for (size_t k = 0; k < lines.size(); ++k) {
    ImageLine& line = lines[k];
    const size_t index = static_cast<size_t>(tracked[k].model_line);
    if (!line.in_view() || index >= profiles_.size()) continue;
    const double first = MotionSign(NormalSpeed(camera_, line, 0.0));
    const double last = MotionSign(NormalSpeed(camera_, line, 1.0));
    // Linear along the line, and so linear in the bearing: offset = at_begin + slope * along.
    const Eigen::Vector2d focal(camera_.fx_px, camera_.fy_px);
    const Eigen::Vector2d centre(camera_.cx_px, camera_.cy_px);
    for (int polarity = 0; polarity < 2; ++polarity) {
      const double at_begin = ExpectedPx(profiles_[index], first, polarity);
      const double slope = (ExpectedPx(profiles_[index], last, polarity) - at_begin) / line.length_px;
      const Eigen::Vector2d along = slope * line.direction;
      Eigen::Vector3d offset;
      offset.head<2>() = along.cwiseProduct(focal);
      offset.z() = at_begin + along.dot(centre - line.p1_px);
      line.a_of_polarity[polarity] = line.a - offset;
    }
  }
}

void EdgeBias::Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                     absl::Span<const PolaritySums> sums, double duration_s, double events_per_observation) {
  // Slower lines make too few events to tell from noise, and their direction may be wrong.
  constexpr double kMinSpeedPxPerS = 20.0;
  constexpr double kMinLengthPx = 10.0;
  for (size_t k = 0; k < lines.size(); ++k) {
    const ImageLine& line = lines[k];
    if (line.length_px < kMinLengthPx) continue;
    const double first = NormalSpeed(camera_, line, 0.1);
    const double last = NormalSpeed(camera_, line, 0.9);
    if (first * last < 0.0 || std::min(std::abs(first), std::abs(last)) < kMinSpeedPxPerS) continue;
    const size_t index = static_cast<size_t>(tracked[k].model_line);
    if (index >= profiles_.size()) profiles_.resize(index + 1);
    Profile& profile = profiles_[index];
    const double direction = first > 0.0 ? 1.0 : -1.0;
    const double off = sums[k].weight[0];
    const double on = sums[k].weight[1];
    profile.events += (on + off) * events_per_observation;
    profile.swept_px2 += line.length_px * 0.5 * std::abs(first + last) * duration_s;
    profile.polarity_motion += direction * (on - off) * events_per_observation;
    if (on > 1.0 && off > 1.0) {
      const double gap_px = direction * (sums[k].distance_px[1] / on - sums[k].distance_px[0] / off);
      const double gain = std::min(0.2, (on + off) * 1e-3);
      profile.half_gap_px =
          std::clamp(profile.half_gap_px + gain * 0.5 * gap_px, -options_.max_half_gap_px, options_.max_half_gap_px);
    }
    if (profile.events > options_.memory_events) {
      const double keep = options_.memory_events / profile.events;
      profile.events *= keep;
      profile.swept_px2 *= keep;
      profile.polarity_motion *= keep;
    }
  }
}

}  // namespace evpose
