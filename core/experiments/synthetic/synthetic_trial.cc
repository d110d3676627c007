// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/synthetic/synthetic_trial.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include "core/geometry/image_segment.h"
#include "core/geometry/projected_line.h"
#include "core/numerics/math.h"
#include "core/numerics/random.h"
#include "core/simulation/random_rotation.h"

namespace evpose {
namespace {

// Depths of the ends of the lines, metres: values of the paper. The origin of the object is in the middle of them. The
// paper gives no least length of the image of a line, pixels; a shorter one hardly determines its direction with the
// largest noise, 10 px.
constexpr double kMinDepthM = 5.0;
constexpr double kMaxDepthM = 10.0;
constexpr double kMinOriginDepthM = 6.5;
constexpr double kMaxOriginDepthM = 8.5;
constexpr double kMinLinePx = 50.0;

// The centre of the first pixel is (0, 0).
constexpr CameraModel kSyntheticCamera = {640, 480, 800.0, 800.0, 319.5, 239.5, {}};

// Uniform in the central part of the image with this share of its sides.
Eigen::Vector2d DrawPixel(const CameraModel& camera, double share, Random& random) {
  return {camera.cx_px + share * random.Uniform(-0.5, 0.5) * (camera.width_px - 1),
          camera.cy_px + share * random.Uniform(-0.5, 0.5) * (camera.height_px - 1)};
}

RigidTransform DrawPose(const CameraModel& camera, Random& random) {
  const Eigen::Vector2d pixel = DrawPixel(camera, 0.5, random);
  const Eigen::Vector3d origin = random.Uniform(kMinOriginDepthM, kMaxOriginDepthM) * BearingOf(camera, pixel);
  return {DrawRotation(random), origin};
}

LineEnds DrawLine(const CameraModel& camera, const RigidTransform& object_from_camera, Random& random) {
  Eigen::Vector2d p1_px, p2_px;
  do {
    p1_px = DrawPixel(camera, 1.0, random);
    p2_px = DrawPixel(camera, 1.0, random);
  } while ((p2_px - p1_px).norm() < kMinLinePx);
  const double depth1_m = random.Uniform(kMinDepthM, kMaxDepthM);
  const double depth2_m = random.Uniform(kMinDepthM, kMaxDepthM);
  return {object_from_camera * (depth1_m * BearingOf(camera, p1_px)),
          object_from_camera * (depth2_m * BearingOf(camera, p2_px))};
}

RigidTransform DrawStart(const SyntheticTrialOptions& options, const RigidTransform& truth, Random& random) {
  const double range_m = options.start_translation_ratio * truth.translation_m.norm();
  Vector6d moved;
  for (int i = 0; i < 3; ++i) moved[i] = range_m * random.Uniform(-1.0, 1.0);
  for (int i = 3; i < 6; ++i) moved[i] = options.start_rotation_rad * random.Uniform(-1.0, 1.0);
  return Perturb(truth, moved);
}

void DrawEvents(const SyntheticTrialOptions& options, Random& random, SyntheticTrial& trial) {
  const CameraModel& camera = trial.camera;
  for (int line = 0; line < options.num_lines; ++line) {
    const Eigen::Vector2d p1_px = camera.Project(trial.camera_from_object * trial.lines[line].p1);
    const Eigen::Vector2d p2_px = camera.Project(trial.camera_from_object * trial.lines[line].p2);
    const Eigen::Vector2d along = (p2_px - p1_px).normalized();
    const Eigen::Vector2d across(-along.y(), along.x());
    for (int i = 0; i < options.events_per_line; ++i) {
      const Eigen::Vector2d pixel =
          p1_px + random.Uniform() * (p2_px - p1_px) + options.noise_px * random.Normal() * across;
      const Eigen::Vector3d bearing = BearingOf(camera, pixel);
      trial.events.push_back({bearing.x(), bearing.y(), line});
      trial.true_line.push_back(line);
    }
  }
}

// The lines move together, so that their events come in random order.
void ShuffleEvents(Random& random, SyntheticTrial& trial) {
  for (size_t i = trial.events.size(); i > 1; --i) {
    const size_t other = random.UniformInt(i);
    std::swap(trial.events[i - 1], trial.events[other]);
    std::swap(trial.true_line[i - 1], trial.true_line[other]);
  }
}

// Assigns another line to this number of events, chosen at random.
void MislabelEvents(const SyntheticTrialOptions& options, Random& random, SyntheticTrial& trial) {
  std::vector<size_t> order(trial.events.size());
  std::iota(order.begin(), order.end(), size_t{0});
  const size_t num_outliers = std::llround(options.outlier_ratio * static_cast<double>(order.size()));
  for (size_t i = 0; i < num_outliers; ++i) {
    std::swap(order[i], order[i + random.UniformInt(order.size() - i)]);
    int& line = trial.events[order[i]].line;
    line = (line + 1 + static_cast<int>(random.UniformInt(options.num_lines - 1))) % options.num_lines;
  }
}

}  // namespace

SyntheticTrial MakeSyntheticTrial(const SyntheticTrialOptions& options, uint64_t seed) {
  // Each part has its own random numbers, so that a change of one leaves the others unchanged.
  Random seeds(seed);
  Random poses(seeds.NextU64()), lines(seeds.NextU64()), events(seeds.NextU64()), outliers(seeds.NextU64());
  SyntheticTrial trial;
  trial.camera = kSyntheticCamera;
  trial.noise_px = options.noise_px;
  trial.camera_from_object = DrawPose(trial.camera, poses);
  trial.start = DrawStart(options, trial.camera_from_object, poses);
  const RigidTransform object_from_camera = trial.camera_from_object.Inverse();
  for (int i = 0; i < options.num_lines; ++i) {
    trial.lines.push_back(DrawLine(trial.camera, object_from_camera, lines));
  }
  DrawEvents(options, events, trial);
  ShuffleEvents(events, trial);
  MislabelEvents(options, outliers, trial);
  return trial;
}

SyntheticError CompareWithTruth(const SyntheticTrial& trial, const RigidTransform& camera_from_object) {
  const RigidTransform& truth = trial.camera_from_object;
  return {RotationAngle(camera_from_object.rotation, truth.rotation) * kDegreesPerRadian,
          (camera_from_object.translation_m - truth.translation_m).norm() / truth.translation_m.norm()};
}

absl::StatusOr<SyntheticBound> ComputeSyntheticBound(const SyntheticTrial& trial) {
  if (!(trial.noise_px > 0.0)) return absl::FailedPreconditionError("without noise there is no bound on the error");
  std::vector<std::optional<ProjectedLine>> projected;
  for (const LineEnds& line : trial.lines) {
    projected.push_back(ProjectLine(trial.camera, trial.camera_from_object, line.p1, line.p2));
  }
  const double inverse_variance = 1.0 / (trial.noise_px * trial.noise_px);
  SyntheticBound bound;
  Vector6d score = Vector6d::Zero();
  for (size_t i = 0; i < trial.events.size(); ++i) {
    const LabelledEvent& event = trial.events[i];
    const std::optional<ProjectedLine>& line = projected[event.line];
    if (event.line != trial.true_line[i] || !line) continue;
    const double d_px = line->a.dot(Eigen::Vector3d(event.bx, event.by, 1.0));
    // The event without its noise: a step of d against the line's normal, which in pixels is (a_x / fx, a_y / fy).
    const double nx = line->a.x() / trial.camera.fx_px, ny = line->a.y() / trial.camera.fy_px;
    const Eigen::Vector3d foot(event.bx - d_px * nx / trial.camera.fx_px, event.by - d_px * ny / trial.camera.fy_px,
                               1.0);
    const Vector6d row = line->jacobian.transpose() * foot;
    bound.information += inverse_variance * row * row.transpose();
    score -= inverse_variance * d_px * row;
  }
  const Eigen::LLT<Matrix6d> factor(bound.information);
  if (factor.info() != Eigen::Success) {
    return absl::FailedPreconditionError("the events whose line is right do not determine the pose");
  }
  bound.efficient_error = factor.solve(score);
  return bound;
}

}  // namespace evpose
