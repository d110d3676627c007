// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/camera_adjustment.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "core/calibration/calibration_target.h"
#include "core/calibration/event_displacement.h"
#include "core/models/object_model.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kEdgeShiftPx = 0.2, kEdgeShiftRatePx = 0.1, kEdgeLagPx = 0.15;

CameraModel TrueCamera() { return {1280, 720, 1030.0, 1028.0, 643.5, 356.5, {-0.08, 0.05, 0.0003, -0.0002, 0.01}}; }

struct MadeSamples {
  std::vector<CalibrationInterval> intervals;  // with true poses
  std::vector<LineSample> samples;
};

// Samples of the target at random poses, tilted by up to `tilt_rad` about both axes. Those of one line in a block have
// a common error besides their own.
MadeSamples Make(double tilt_rad, uint64_t seed) {
  const auto target = ParseCalibrationTarget("A4");
  const std::string obj = TargetToObj(*target);
  const auto model =
      ParseObjectModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, ModelFormat::kObj, {});
  const CameraModel camera = TrueCamera();
  Random random(seed);
  MadeSamples made;
  constexpr int kBlocks = 60, kPerBlock = 4;
  for (int block = 0; block < kBlocks; ++block) {
    std::vector<double> common_px;
    for (size_t i = 0; i < model->lines.size(); ++i) common_px.push_back(0.05 * random.Normal());
    for (int i = 0; i < kPerBlock; ++i) {
      CalibrationInterval interval;
      interval.t_us = 500'000 * block + 100'000 * i;
      const Vector3d turn{random.Uniform(-tilt_rad, tilt_rad), random.Uniform(-tilt_rad, tilt_rad),
                          random.Uniform(-1.0, 1.0)};
      interval.camera_from_object.rotation = ExpSo3(turn) * Vector3d(1.0, -1.0, -1.0).asDiagonal().toDenseMatrix();
      const double depth_m = random.Uniform(0.6, 1.2);
      interval.camera_from_object.translation_m =
          depth_m * Vector3d{random.Uniform(-0.4, 0.4), random.Uniform(-0.2, 0.2), 1.0};
      const int index = static_cast<int>(made.intervals.size());
      for (size_t k = 0; k < model->lines.size(); ++k) {
        const ModelLine& line = model->lines[k];
        for (const double at : {0.2, 0.5, 0.8}) {
          const auto project = [&](double fraction) -> Vector2d {
            return camera.Distort(
                camera.Project(interval.camera_from_object * Vector3d(line.p1 + fraction * (line.p2 - line.p1))));
          };
          LineSample sample;
          sample.interval = index;
          sample.line = static_cast<int>(k);
          sample.point = line.p1 + at * (line.p2 - line.p1);
          const Vector2d along = (project(at + 0.01) - project(at - 0.01)).normalized();
          sample.normal = {-along.y(), along.x()};
          sample.sigma_px = 0.1;
          sample.dark_side = k % 2 == 0 ? 1.0 : -1.0;
          sample.speed_px_per_s = random.Uniform(50.0, 800.0);
          sample.motion = random.Uniform(-1.0, 1.0) > 0.0 ? 1.0 : -1.0;
          sample.events_per_px2 = random.Uniform(2.0, 4.0);
          const double shift_px = kEdgeShiftPx + 1e-3 * sample.speed_px_per_s * kEdgeShiftRatePx;
          const double noise_px = 0.1 * random.Normal() + common_px[k];
          const double displacement_px = sample.dark_side * shift_px - sample.motion * kEdgeLagPx + noise_px;
          sample.pixel = project(at) + displacement_px * sample.normal;
          made.samples.push_back(sample);
        }
      }
      made.intervals.push_back(interval);
    }
  }
  return made;
}

// The start of a calibration: a focal length that is 20 % off, and the poses that show the object at its size.
void Disturb(MadeSamples& made, CalibrationParameters& parameters) {
  parameters = {};
  parameters[kFocal] = 0.8 * TrueCamera().fx_px;
  parameters[kAspect] = 1.0;
  parameters[kCentreX] = 639.5;
  parameters[kCentreY] = 359.5;
  for (CalibrationInterval& interval : made.intervals) interval.camera_from_object.translation_m.z() *= 0.8;
}

CalibrationParameters TrueParameters() {
  CalibrationParameters parameters = ParametersOf(TrueCamera());
  parameters[kEdgeShift] = kEdgeShiftPx;
  parameters[kEdgeShiftRate] = kEdgeShiftRatePx;
  parameters[kEdgeLag] = kEdgeLagPx;
  return parameters;
}

TEST(CameraAdjustment, FindsTheCameraWithinItsStandardErrors) {
  constexpr int kSeeds = 8;
  FreeParameters free = AllParameters(LensModel::kBrown);
  double squares = 0.0;
  for (uint64_t seed = 0; seed < kSeeds; ++seed) {
    MadeSamples made = Make(0.6, seed);
    CalibrationParameters parameters;
    Disturb(made, parameters);
    ASSERT_TRUE(AdjustCamera(made.samples, free, {}, parameters, absl::MakeSpan(made.intervals)).ok());
    const AdjustmentErrors errors = ComputeErrors(made.samples, free, {}, parameters, made.intervals);
    EXPECT_EQ(errors.num_blocks, 60);
    EXPECT_NEAR(errors.rms_px, 0.11, 0.02);
    const CalibrationParameters truth = TrueParameters();
    for (int i = 0; i < kNumCalibrationParameters; ++i) {
      if (!free[i]) continue;
      const double sigma = std::sqrt(errors.covariance(i, i));
      EXPECT_LT(std::abs(parameters[i] - truth[i]), 4.5 * sigma)
          << CalibrationParameterName(LensModel::kBrown, i) << ", seed " << seed;
      squares += std::pow((parameters[i] - truth[i]) / sigma, 2) / (kSeeds * 14.0);
    }
    EXPECT_LT(std::sqrt(errors.covariance(kFocal, kFocal)), 1.0);
  }
  // One on average if the standard errors are neither too small nor too large.
  EXPECT_GT(squares, 0.5);
  EXPECT_LT(squares, 2.0);
}

TEST(CameraAdjustment, StandardErrorOfTheFocalLengthGrowsWithoutTilt) {
  FreeParameters free = {};
  free[kFocal] = true;
  double sigma[2];
  for (const bool is_tilted : {false, true}) {
    MadeSamples made = Make(is_tilted ? 0.6 : 0.01, 1);
    CalibrationParameters parameters = TrueParameters();
    sigma[is_tilted] = std::sqrt(ComputeErrors(made.samples, free, {}, parameters, made.intervals).covariance(0, 0));
  }
  EXPECT_GT(sigma[0], 10.0 * sigma[1]);
}

TEST(CameraAdjustment, ParametersThatAreNotFreeStay) {
  FreeParameters free = AllParameters(LensModel::kBrown);
  free[kDistortion + 4] = free[kAspect] = false;
  MadeSamples made = Make(0.6, 3);
  CalibrationParameters parameters;
  Disturb(made, parameters);
  ASSERT_TRUE(AdjustCamera(made.samples, free, {}, parameters, absl::MakeSpan(made.intervals)).ok());
  EXPECT_EQ(parameters[kDistortion + 4], 0.0);
  EXPECT_EQ(parameters[kAspect], 1.0);
  const AdjustmentErrors errors = ComputeErrors(made.samples, free, {}, parameters, made.intervals);
  EXPECT_EQ(errors.covariance(kDistortion + 4, kDistortion + 4), 0.0);
}

AdjustmentOptions WithPrior(double sigma_of_k3) {
  AdjustmentOptions options;
  CalibrationPrior& prior = options.prior.emplace();
  prior.mean = {};
  prior.mean[kFocal] = TrueCamera().fx_px;
  prior.mean[kAspect] = 1.0;
  prior.mean[kCentreX] = 639.5;
  prior.mean[kCentreY] = 359.5;
  prior.sigma.fill(0.3);
  prior.sigma[kFocal] = 200.0;
  prior.sigma[kCentreX] = prior.sigma[kCentreY] = 40.0;
  prior.sigma[kDistortion + 4] = sigma_of_k3;
  return options;
}

TEST(CameraAdjustment, PriorKeepsWhatTheDataDoNotDetermine) {
  const FreeParameters free = AllParameters(LensModel::kBrown);
  double error[2], k3[2];
  for (const bool is_narrow : {false, true}) {
    const AdjustmentOptions options = WithPrior(is_narrow ? 1e-4 : 0.3);
    MadeSamples made = Make(0.6, 3);
    CalibrationParameters parameters;
    Disturb(made, parameters);
    ASSERT_TRUE(AdjustCamera(made.samples, free, options, parameters, absl::MakeSpan(made.intervals)).ok());
    const AdjustmentErrors errors = ComputeErrors(made.samples, free, options, parameters, made.intervals);
    error[is_narrow] = std::sqrt(errors.covariance(kDistortion + 4, kDistortion + 4));
    k3[is_narrow] = parameters[kDistortion + 4];
    EXPECT_NEAR(parameters[kFocal], TrueCamera().fx_px, 4.5 * std::sqrt(errors.covariance(kFocal, kFocal)));
    // The samples of a block have common errors, which the bound leaves out.
    EXPECT_GT(errors.dispersion, 1.1);
    EXPECT_LT(errors.bound(kFocal, kFocal), errors.covariance(kFocal, kFocal));
  }
  EXPECT_GT(error[0], 1e-3);
  EXPECT_LT(error[1], 2e-4);
  EXPECT_LT(std::abs(k3[1]), 5e-4);
}

TEST(CameraAdjustment, FewBlocksHaveOneDispersion) {
  FreeParameters free = AllParameters(LensModel::kBrown);
  MadeSamples made = Make(0.6, 4);
  const CalibrationCovariance all = ComputeErrors(made.samples, free, {}, TrueParameters(), made.intervals).covariance;
  std::erase_if(made.samples, [](const LineSample& sample) { return sample.interval >= 40; });
  EXPECT_EQ(NumBlocks(made.samples, made.intervals, AdjustmentOptions().block_us), 10);
  const AdjustmentErrors few = ComputeErrors(made.samples, free, {}, TrueParameters(), made.intervals);
  EXPECT_EQ(few.num_blocks, 10);
  // A sixth of the data.
  const double ratio = std::sqrt(few.covariance(kFocal, kFocal) / all(kFocal, kFocal));
  EXPECT_GT(ratio, 1.2);
  EXPECT_LT(ratio, 5.0);
  EXPECT_NEAR(few.covariance(kFocal, kFocal), few.dispersion * few.bound(kFocal, kFocal), 1e-9);
}

// Samples in the middle of the image alone, and a start that maps two directions to one pixel.
TEST(CameraAdjustment, RadialDistortionIncreasesUpToTheCorners) {
  FreeParameters free = {};
  free[kDistortion] = free[kDistortion + 1] = free[kDistortion + 4] = true;
  const auto smallest_slope = [](const CalibrationParameters& parameters) {
    double smallest = 1.0;
    for (double r = 0.01; r < 0.71; r += 0.01) {
      const double slope =
          ProjectBearing(parameters, {r + 1e-4, 0.0}).x() - ProjectBearing(parameters, {r - 1e-4, 0.0}).x();
      smallest = std::min(smallest, slope / (2e-4 * parameters[kFocal]));
    }
    return smallest;
  };
  double slopes[2];
  for (const bool is_limited : {false, true}) {
    MadeSamples made = Make(0.6, 8);
    // Errors that a lens with a falling distortion explains, in the samples of the middle.
    std::erase_if(made.samples,
                  [](const LineSample& sample) { return (sample.pixel - Vector2d(643.5, 356.5)).norm() > 250.0; });
    for (LineSample& sample : made.samples) {
      const Vector2d radius = (sample.pixel - Vector2d(643.5, 356.5)) / 1030.0;
      sample.pixel -= 1030.0 * 3.0 * radius.squaredNorm() * radius;
    }
    AdjustmentOptions options;
    if (is_limited) {
      options.width_px = 1280;
      options.height_px = 720;
    }
    CalibrationParameters parameters = TrueParameters();
    ASSERT_TRUE(AdjustCamera(made.samples, free, options, parameters, absl::MakeSpan(made.intervals)).ok());
    slopes[is_limited] = smallest_slope(parameters);
  }
  EXPECT_LT(slopes[0], 0.0);
  EXPECT_GT(slopes[1], 0.05);
}

TEST(EventDisplacement, LinesThatAreNearTogetherAreDisplacedTogether) {
  Random random(5);
  constexpr double kShiftPx = 0.35, kCompanions[] = {1.8, 4.0};
  std::vector<double> distances;
  for (int i = 0; i < 4000; ++i) {
    const double line = i % 3 == 0 ? 0.0 : kCompanions[i % 3 - 1];
    distances.push_back(line + kShiftPx + 0.5 * random.Normal());
  }
  for (int i = 0; i < 400; ++i) distances.push_back(random.Uniform(-2.0, 6.0));
  const EventDisplacement fit = FitDisplacement(distances, 4.0, 0.0, ExpTable(), kCompanions);
  EXPECT_NEAR(fit.mean_px, kShiftPx, 0.03);
  EXPECT_NEAR(fit.spread_px, 0.5, 0.05);
  EXPECT_NEAR(fit.num_events, 4000.0, 200.0);
}

TEST(CameraAdjustment, TooFewBlocksHaveNoStandardError) {
  FreeParameters free = AllParameters(LensModel::kBrown);
  MadeSamples made = Make(0.6, 4);
  std::erase_if(made.samples, [&](const LineSample& sample) { return sample.interval >= 4; });
  const AdjustmentErrors errors = ComputeErrors(made.samples, free, {}, TrueParameters(), made.intervals);
  EXPECT_EQ(errors.num_blocks, 1);
  EXPECT_TRUE(std::isinf(errors.covariance(kFocal, kFocal)));
}

TEST(CameraAdjustment, ErrorsAreScaledToTheResidualsBySpeed) {
  MadeSamples made = Make(0.6, 6);
  for (LineSample& sample : made.samples) sample.sigma_px = 0.5;
  // Slow samples are five times less accurate; one in a hundred is wrong.
  Random random(7);
  for (size_t i = 0; i < made.samples.size(); ++i) {
    LineSample& sample = made.samples[i];
    if (sample.speed_px_per_s < 200.0) sample.pixel += 0.5 * random.Normal() * sample.normal;
    if (i % 100 == 0) sample.pixel += 5.0 * sample.normal;
  }
  ScaleErrors(TrueParameters(), made.intervals, absl::MakeSpan(made.samples));
  for (const LineSample& sample : made.samples) {
    if (sample.speed_px_per_s < 150.0) {
      EXPECT_NEAR(sample.sigma_px, 0.51, 0.1);
    }
    if (sample.speed_px_per_s > 300.0) {
      EXPECT_NEAR(sample.sigma_px, 0.11, 0.03);
    }
  }
}

TEST(CameraAdjustment, WeakIntervalsAreRemoved) {
  MadeSamples made = Make(0.6, 5);
  const size_t all = made.samples.size();
  RemoveWeakIntervals(made.samples);
  EXPECT_EQ(made.samples.size(), all);
  // The samples of two lines do not determine a pose.
  std::erase_if(made.samples, [](const LineSample& sample) { return sample.interval == 7 && sample.line > 1; });
  constexpr int kFirstOfInterval = 7 * 66;
  for (int i = 0; i < 6; ++i) {
    made.samples.insert(made.samples.begin() + kFirstOfInterval, made.samples[kFirstOfInterval]);
  }
  RemoveWeakIntervals(made.samples);
  EXPECT_EQ(made.samples.size(), all - 66);
}

TEST(CameraAdjustment, ProjectionIsThatOfTheCamera) {
  CameraModel rational = TrueCamera(), fisheye = TrueCamera();
  rational.lens_model = LensModel::kRational;
  rational.distortion = {0.4, 0.05, 0.0003, -0.0002, 0.01, 0.5, 0.1, 0.02};
  fisheye.lens_model = LensModel::kFisheye;
  fisheye.distortion = {0.05, -0.01, 0.003, -0.001};
  for (const CameraModel& camera : {TrueCamera(), rational, fisheye}) {
    const CalibrationParameters parameters = ParametersOf(camera);
    const FreeParameters all = AllParameters(camera.lens_model);
    for (const Vector2d& bearing : {Vector2d(0.0, 0.0), Vector2d(0.5, -0.3), Vector2d(-0.6, 0.33)}) {
      const Vector2d expected = camera.Distort(camera.Project({bearing.x(), bearing.y(), 1.0}));
      EXPECT_LT((ProjectBearing(parameters, bearing) - expected).norm(), 1e-9);
      const auto jacobian = ProjectionJacobian(parameters, bearing);
      for (int i = 0; i < kEdgeShift; ++i) {
        CalibrationParameters moved = parameters;
        moved[i] += 1e-6;
        const Vector2d quotient = 1e6 * (ProjectBearing(moved, bearing) - ProjectBearing(parameters, bearing));
        EXPECT_LT((quotient - jacobian.col(i)).norm(), 1e-3 * (1.0 + quotient.norm()));
        if (!all[i]) {
          EXPECT_EQ(quotient.norm(), 0.0);
        }
      }
    }
    CameraModel copy{1280, 720};
    SetParameters(parameters, copy);
    EXPECT_EQ(copy.lens_model, camera.lens_model);
    EXPECT_LT((copy.Project({0.1, 0.2, 1.0}) - camera.Project({0.1, 0.2, 1.0})).norm(), 1e-9);
  }
  EXPECT_EQ(CalibrationParameterName(LensModel::kBrown, kDistortion + 2), "p1");
  EXPECT_EQ(CalibrationParameterName(LensModel::kFisheye, kDistortion + 2), "k3");
}

}  // namespace
}  // namespace evpose
