// SPDX-License-Identifier: Apache-2.0
#include "client/lib/messages/core_types.h"

#include <array>
#include <utility>

namespace evpose::client {
namespace {

// Both directions of an enumeration read one table.
constexpr std::array<std::pair<EventEncoding, Encoding>, 5> kCoreEncodings = {{
    {EventEncoding::kEvt3, Encoding::kEvt3},
    {EventEncoding::kEvt21, Encoding::kEvt21},
    {EventEncoding::kEvt2, Encoding::kEvt2},
    {EventEncoding::kDat, Encoding::kDat},
    {EventEncoding::kFlat64, Encoding::kFlat64},
}};
constexpr std::array<std::pair<PoseEstimator, Estimator>, 6> kOfferedEstimators = {{
    {PoseEstimator::kMixture, Estimator::kMixture},
    {PoseEstimator::kStaticLs, Estimator::kStaticLs},
    {PoseEstimator::kStaticM, Estimator::kStaticM},
    {PoseEstimator::kStaticS, Estimator::kStaticS},
    {PoseEstimator::kStaticMm, Estimator::kStaticMm},
    {PoseEstimator::kErrorStateFilter, Estimator::kErrorStateFilter},
}};
constexpr std::array<std::pair<LensModel, evpose::LensModel>, 3> kLensModels = {{
    {LensModel::kBrown, evpose::LensModel::kBrown},
    {LensModel::kRational, evpose::LensModel::kRational},
    {LensModel::kFisheye, evpose::LensModel::kFisheye},
}};

LensModel FromCore(evpose::LensModel lens_model) {
  for (const auto& [offered, core] : kLensModels) {
    if (core == lens_model) return offered;
  }
  return LensModel::kBrown;
}
evpose::LensModel ToCore(LensModel lens_model) {
  for (const auto& [offered, core] : kLensModels) {
    if (offered == lens_model) return core;
  }
  return evpose::LensModel::kBrown;
}

}  // namespace

Transform FromCore(const RigidTransform& transform) { return {transform.rotation, transform.translation_m}; }
RigidTransform ToCore(const Transform& transform) { return {transform.rotation, transform.translation_m}; }

Camera FromCore(const CameraModel& camera) {
  const auto& [width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, lens_model] = camera;
  return {width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, FromCore(lens_model)};
}
CameraModel ToCore(const Camera& camera) {
  const auto& [width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, lens_model] = camera;
  return {width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, ToCore(lens_model)};
}

SensorParameters FromCore(const SensorProfile& profile) {
  return {profile.pixel_noise_px, profile.blur_px,    profile.contrast_threshold,
          profile.refractory_us,  profile.latency_us, profile.uncertainty};
}
SensorProfile ToCore(const SensorParameters& sensor) {
  const auto& [pixel_noise_px, blur_px, contrast_threshold, refractory_us, latency_us, uncertainty] = sensor;
  return {"", pixel_noise_px, blur_px, contrast_threshold, refractory_us, latency_us, uncertainty};
}

EventEncoding FromCore(Encoding encoding) {
  for (const auto& [offered, core] : kCoreEncodings) {
    if (core == encoding) return offered;
  }
  return EventEncoding::kEvt3;
}
Encoding ToCore(EventEncoding encoding) {
  for (const auto& [offered, core] : kCoreEncodings) {
    if (offered == encoding) return core;
  }
  return Encoding::kEvt3;
}

std::optional<PoseEstimator> FromCore(Estimator estimator) {
  for (const auto& [offered, core] : kOfferedEstimators) {
    if (core == estimator) return offered;
  }
  return std::nullopt;
}

absl::StatusOr<EventChunk> FromCore(absl::StatusOr<EventChunkBytes> chunk) {
  if (!chunk.ok()) return chunk.status();
  return EventChunk{std::move(chunk->bytes), chunk->t_last_us, {}, chunk->follows_loss};
}

}  // namespace evpose::client
