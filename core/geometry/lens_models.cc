// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/lens_models.h"

#include <cmath>
#include <limits>

#include "core/numerics/math.h"

namespace evpose {
namespace {

// The point after a radial factor and the tangential distortion d[2], d[3] of p; `radial_slope` times x or y is the
// derivative of the factor. The point is regular only if the factor is (`is_defined`).
DistortedPoint DistortRadially(const Distortion& d, const Eigen::Vector2d& p, double radial, double radial_slope,
                               bool is_defined) {
  const double x = p.x(), y = p.y();
  const double r2 = x * x + y * y;
  const double xx = radial + radial_slope * x * x + 2.0 * d[2] * y + 6.0 * d[3] * x;
  const double xy = radial_slope * x * y + 2.0 * d[2] * x + 2.0 * d[3] * y;  // symmetric
  const double yy = radial + radial_slope * y * y + 6.0 * d[2] * y + 2.0 * d[3] * x;
  return {{x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x),
           y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y},
          xx,
          xy,
          yy,
          is_defined && xx > 0.0 && xx * yy - xy * xy > 0.0};
}

DistortedPoint DistortBrown(const Distortion& d, const Eigen::Vector2d& p) {
  const double r2 = p.x() * p.x() + p.y() * p.y();
  const double radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
  const double radial_slope = 2.0 * (d[0] + r2 * (2.0 * d[1] + r2 * 3.0 * d[4]));
  return DistortRadially(d, p, radial, radial_slope, true);
}

DistortedPoint DistortRational(const Distortion& d, const Eigen::Vector2d& p) {
  const double r2 = p.x() * p.x() + p.y() * p.y();
  const double above = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
  const double below = 1.0 + r2 * (d[5] + r2 * (d[6] + r2 * d[7]));
  const double radial = above / below;
  const double above_slope = d[0] + r2 * (2.0 * d[1] + r2 * 3.0 * d[4]);
  const double below_slope = d[5] + r2 * (2.0 * d[6] + r2 * 3.0 * d[7]);
  const double radial_slope = 2.0 * (above_slope - radial * below_slope) / below;
  // Behind a pole of the radial factor the image appears a second time.
  return DistortRadially(d, p, radial, radial_slope, below > 0.0);
}

// The distorted radius at a distance r from the centre, and its derivative by r.
struct FisheyeRadius {
  double radius;
  double slope;
};

FisheyeRadius DistortRadius(const Distortion& d, double r) {
  const double angle = DeterministicAtan2(r, 1.0);
  const double angle2 = angle * angle;
  const double factor = 1.0 + angle2 * (d[0] + angle2 * (d[1] + angle2 * (d[2] + angle2 * d[3])));
  const double by_angle =
      1.0 + angle2 * (3.0 * d[0] + angle2 * (5.0 * d[1] + angle2 * (7.0 * d[2] + angle2 * 9.0 * d[3])));
  return {angle * factor, by_angle / (1.0 + r * r)};
}

DistortedPoint DistortFisheye(const Distortion& d, const Eigen::Vector2d& p) {
  const double r2 = p.squaredNorm();
  constexpr double kCentre2 = 1e-24;  // within it the map is the identity to rounding error
  if (r2 < kCentre2) return {p, 1.0, 0.0, 1.0, true};
  const double r = std::sqrt(r2);
  const FisheyeRadius distorted = DistortRadius(d, r);
  const double across = distorted.radius / r;
  const double difference = (distorted.slope - across) / r2;
  return {across * p, across + difference * p.x() * p.x(), difference * p.x() * p.y(),
          across + difference * p.y() * p.y(), distorted.slope > 0.0 && across > 0.0 && r <= kMaxFisheyeTangent};
}

// Newton's method needs few steps from the distorted point where a lens compresses or stretches the image steadily. It
// is stopped where halving the step this often leaves the regular region or approaches no further.
constexpr int kMaxSteps = 50;
constexpr int kMaxHalvings = 30;
// Distance in the normalised plane that is below a thousandth of a pixel for all cameras that CheckView() accepts.
constexpr double kConverged = 1e-15;

}  // namespace

const char* LensModelName(LensModel model) {
  return model == LensModel::kBrown ? "brown" : model == LensModel::kRational ? "rational" : "fisheye";
}

DistortedPoint DistortNormalised(LensModel model, const Distortion& distortion, const Eigen::Vector2d& point) {
  if (model == LensModel::kBrown) return DistortBrown(distortion, point);
  return model == LensModel::kRational ? DistortRational(distortion, point) : DistortFisheye(distortion, point);
}

double SecondBranchRadius(LensModel model, const Distortion& distortion) {
  Distortion radial = distortion;
  if (model != LensModel::kFisheye) radial[2] = radial[3] = 0.0;
  // Steps of equal angle up to slightly less than 90 degrees.
  constexpr int kSteps = 8192;
  bool is_folded = false;
  for (int i = 1; i < kSteps; ++i) {
    const SinCos angle = DeterministicSinCos(M_PI / 2.0 * i / kSteps);
    const double radius = angle.sin / angle.cos;
    const bool is_regular = DistortNormalised(model, radial, {radius, 0.0}).is_regular;
    if (is_folded && is_regular) return radius;
    is_folded |= !is_regular;
  }
  return std::numeric_limits<double>::infinity();
}

std::optional<Eigen::Vector2d> UndistortNormalised(LensModel model, const Distortion& distortion,
                                                   const Eigen::Vector2d& distorted) {
  // The iteration begins at the distorted point, or at the centre, which is regular in all models, if that point is
  // beyond a fold.
  Eigen::Vector2d point = distorted;
  DistortedPoint at = DistortNormalised(model, distortion, point);
  if (!at.is_regular || !at.point.allFinite()) {
    point.setZero();
    at = DistortNormalised(model, distortion, point);
  }
  double error2 = (distorted - at.point).squaredNorm();
  const double converged = kConverged * (1.0 + distorted.norm());
  for (int step = 0; step < kMaxSteps && error2 > converged * converged; ++step) {
    const Eigen::Vector2d residual = distorted - at.point;
    const double determinant = at.xx * at.yy - at.xy * at.xy;
    Eigen::Vector2d change(at.yy * residual.x() - at.xy * residual.y(), at.xx * residual.y() - at.xy * residual.x());
    change /= determinant;
    bool is_nearer = false;
    for (int halving = 0; halving < kMaxHalvings && !is_nearer; ++halving, change *= 0.5) {
      const Eigen::Vector2d next = point + change;
      const DistortedPoint at_next = DistortNormalised(model, distortion, next);
      const double next_error2 = (distorted - at_next.point).squaredNorm();
      if (!at_next.is_regular || !(next_error2 < error2)) continue;
      is_nearer = true;
      point = next;
      at = at_next;
      error2 = next_error2;
    }
    if (!is_nearer) break;
  }
  // Rounding ends the descent slightly before `converged` for distant points.
  constexpr double kAccepted = 1e-9;
  const double accepted = kAccepted * (1.0 + distorted.norm());
  if (!(error2 <= accepted * accepted)) return std::nullopt;
  return point;
}

}  // namespace evpose
