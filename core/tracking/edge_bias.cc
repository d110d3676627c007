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

// From this |kappa| on a line is taken for one edge.
constexpr double kEdgeKappa = 0.6;

}  // namespace

double EdgeBias::ExpectedPx(const Profile& profile, double motion) const {
  if (profile.events < options_.min_events) return 0.0;
  const double kappa = profile.polarity_motion / profile.events;
  const double lag_px = -sensor_.lag_px * motion;
  if (std::abs(kappa) < kEdgeKappa) return lag_px;
  const double density = profile.events / std::max(profile.swept_px2, 1.0);
  return lag_px + kappa * std::min(sensor_.edge_shift_px_per_event * density, sensor_.max_edge_shift_px);
}

void EdgeBias::Correct(absl::Span<const TrackedLine> tracked, absl::Span<ImageLine> lines) const {
  for (size_t k = 0; k < lines.size(); ++k) {
    ImageLine& line = lines[k];
    const size_t index = static_cast<size_t>(tracked[k].model_line);
    if (!line.in_view()) continue;
    // Late time stamps show the line where it was.
    line.a_expected = line.a - 1e-6 * sensor_.latency_us * line.a_dot;
    if (index >= profiles_.size()) continue;
    const double first = MotionSign(NormalSpeed(camera_, line, 0.0));
    const double last = MotionSign(NormalSpeed(camera_, line, 1.0));
    // Linear along the line, and so linear in the bearing: offset = at_begin + slope * along.
    const Eigen::Vector2d focal(camera_.fx_px, camera_.fy_px);
    const Eigen::Vector2d centre(camera_.cx_px, camera_.cy_px);
    const double at_begin = ExpectedPx(profiles_[index], first);
    const double slope = (ExpectedPx(profiles_[index], last) - at_begin) / line.length_px;
    const Eigen::Vector2d along = slope * line.direction;
    Eigen::Vector3d offset;
    offset.head<2>() = along.cwiseProduct(focal);
    offset.z() = at_begin + along.dot(centre - line.p1_px);
    line.a_expected -= offset;
  }
}

void EdgeBias::Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                     absl::Span<const std::array<double, 2>> polarity_weights, double duration_s,
                     double events_per_observation) {
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
    const double off = polarity_weights[k][0];
    const double on = polarity_weights[k][1];
    profile.events += (on + off) * events_per_observation;
    profile.swept_px2 += line.length_px * 0.5 * std::abs(first + last) * duration_s;
    profile.polarity_motion += direction * (on - off) * events_per_observation;
    if (profile.events > options_.memory_events) {
      const double keep = options_.memory_events / profile.events;
      profile.events *= keep;
      profile.swept_px2 *= keep;
      profile.polarity_motion *= keep;
    }
  }
}

}  // namespace evpose
