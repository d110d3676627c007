// SPDX-License-Identifier: Apache-2.0

// Lens models: maps from the normalised image plane, (x, y) = (X / Z, Y / Z), to the distorted one (README, section 4).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>

namespace evpose {

// The values are stored and sent; a new model gets a new value.
enum class LensModel : uint8_t {
  kBrown = 0,     // k1 k2 p1 p2 k3: plumb_bob, radtan
  kRational = 1,  // k1 k2 p1 p2 k3 k4 k5 k6: rational_polynomial
  kFisheye = 2,   // k1 k2 k3 k4: equidistant
};

inline constexpr int kMaxDistortion = 8;
// The distortion coefficients in OpenCV's order. The coefficients that the model does not have are 0.
using Distortion = std::array<double, kMaxDistortion>;

// The number of coefficients of the model.
constexpr int NumCoefficients(LensModel model) {
  return model == LensModel::kBrown ? 5 : model == LensModel::kRational ? 8 : 4;
}
// "brown", "rational" or "fisheye".
const char* LensModelName(LensModel model);

// Tangent of the largest angle, 85 degrees, between the optical axis and a direction that is used. Only a fisheye lens
// shows such directions.
inline constexpr double kMaxFisheyeTangent = 11.430052302761343;

// The distorted point, and the Jacobian of the map, which is symmetric for all models: (xx, xy; xy, yy).
struct DistortedPoint {
  Eigen::Vector2d point;
  double xx, xy, yy;
  // Whether the point lies in the region of the model around the centre of the image, in which the map can be inverted:
  // the Jacobian is positive definite there, but not where the map folds or mirrors the image.
  bool is_regular;
};

DistortedPoint DistortNormalised(LensModel model, const Distortion& distortion, const Eigen::Vector2d& point);

// The smallest radius beyond which the map, without tangential distortion, has folded twice. Between the folds the
// radius of the image decreases or the radial factor of a rational lens has a pole; beyond them the map is regular
// again, but shows directions that are not those of the lens. Infinity if there is no such radius. Accurate to 2e-4 of
// the angle from the optical axis; takes about 0.2 ms.
double SecondBranchRadius(LensModel model, const Distortion& distortion);

// Inverts the map: the regular point whose distortion is `distorted`, to rounding error. nullopt if there is none.
std::optional<Eigen::Vector2d> UndistortNormalised(LensModel model, const Distortion& distortion,
                                                   const Eigen::Vector2d& distorted);

}  // namespace evpose
