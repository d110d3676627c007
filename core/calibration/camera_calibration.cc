// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/camera_calibration.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/geometry/undistortion_table.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {
namespace {

using Eigen::Vector2d;

// Prior of the parameters of a lens and sensor, without data, one standard deviation: a parameter whose standard error
// is not below half of it is not determined.
constexpr double kFocalPrior = 0.2;         // of the focal length: the tolerance of tracking
constexpr double kAspectPrior = 0.01;       // pixels are square
constexpr double kCentrePrior = 0.03;       // of the width: how far lenses are off the middle of their sensors
constexpr double kRadialPrior = 0.3;        // coefficients of wide lenses
constexpr double kRationalPrior = 1.0;      // coefficients of a rational lens reach one
constexpr double kTangentialPrior = 0.005;  // p1, p2
constexpr double kEdgeShiftPriorPx = 0.3;   // at rest, and its change at 1000 px/s
constexpr double kMaxErrorToPrior = 0.5;
// Microseconds for which the first recording is tracked with each of the focal lengths of the start. A longer trial
// takes more time for each of them; in a shorter one the object has too few orientations to tell the focal lengths
// apart.
constexpr int64_t kTrialUs = 2'500'000;
// The longest search for the object in it, microseconds: bounds the time for a recording that does not show the object.
constexpr int64_t kMaxTrialUs = 60'000'000;
// Half of the intervals of a calibration: a trial estimates few parameters, and only compares the focal lengths.
constexpr int kTrialIntervals = 150;
// Standard errors need so many parts of the recordings; their duration is halved until there are as many, or until it
// is that of an interval.
constexpr int kWantedBlocks = 16;
constexpr int kMinBlocks = 3;
constexpr int64_t kMinBlockUs = 15'000;
// Focal lengths of the start, of the width of the image: from 80 to 24 degrees; neighbours differ by a factor that the
// adjustment bridges.
constexpr double kTrialFocal[] = {0.6, 0.85, 1.2, 1.7, 2.4};
// The same of a guess that is up to 20 % off, relative to the guess.
constexpr double kTrialOfGuess[] = {1.0, 0.83, 1.2};
// Wide lenses are also tried with a usual distortion k1, k2: without it, a line near the border of the image may be
// 10 px from its events. The distorted radius increases everywhere.
constexpr double kBarrel[] = {-0.3, 0.1};

class Calibrator {
 public:
  Calibrator(absl::Span<const std::string> recordings, const RecordingOpener& open,
             std::shared_ptr<const ObjectModel> model, SensorGeometry sensor, const CameraCalibrationOptions& options,
             const CalibrationProgress& on_progress)
      : recordings_(recordings),
        open_(open),
        model_(std::move(model)),
        options_(options),
        on_progress_(on_progress),
        adjustment_(options.adjustment) {
    const TrackerOptions tracker_options;
    edges_ = std::make_unique<ModelEdges>(*model_, tracker_options.visibility, tracker_options.elements);
    camera_.width_px = sensor.width_px;
    camera_.height_px = sensor.height_px;
    SetParameters(DefaultParameters(1.0 * sensor.width_px), camera_);
    adjustment_.width_px = sensor.width_px;
    adjustment_.height_px = sensor.height_px;
  }

  absl::StatusOr<CameraCalibration> Run();

 private:
  using Intervals = std::vector<CalibrationInterval>;

  CalibrationParameters DefaultParameters(double focal_px) const {
    CalibrationParameters parameters{options_.lens_model};
    parameters[kFocal] = focal_px;
    parameters[kAspect] = 1.0;
    parameters[kCentreX] = 0.5 * (camera_.width_px - 1);
    parameters[kCentreY] = 0.5 * (camera_.height_px - 1);
    return parameters;
  }
  std::vector<CalibrationParameters> Starts() const;
  absl::Status FindStart();
  absl::StatusOr<Intervals> Track(int round);
  // Samples and adjusts, `times` times.
  absl::Status Adjust(const FreeParameters& free, int times, Intervals& intervals);
  absl::Status AdjustDetermined(Intervals& intervals);
  double SigmaOfPrior(int parameter) const;
  void SetPrior(double focal_px);
  absl::Status SetBlocks(const Intervals& intervals);
  double LargestMotionPx(const CalibrationParameters& from, const CalibrationParameters& to) const;
  absl::Status CompareHalves(const Intervals& intervals, CameraCalibration& result);
  void Describe(const Intervals& intervals, CameraCalibration& result) const;
  void AddWarnings(CameraCalibration& result) const;
  std::vector<ProjectionUncertainty> Places() const;

  const absl::Span<const std::string> recordings_;
  const RecordingOpener& open_;
  const std::shared_ptr<const ObjectModel> model_;
  const CameraCalibrationOptions options_;
  const CalibrationProgress& on_progress_;
  std::unique_ptr<const ModelEdges> edges_;
  CameraModel camera_;
  CalibrationParameters parameters_ = {};
  double start_focal_px_ = 0.0;
  FreeParameters free_ = {};
  AdjustmentErrors errors_;
  AdjustmentOptions adjustment_;
  std::vector<LineSample> samples_;
  std::vector<std::string> warnings_;
};

void Calibrator::SetPrior(double focal_px) {
  start_focal_px_ = focal_px;
  CalibrationPrior& prior = adjustment_.prior.emplace();
  prior.mean = DefaultParameters(focal_px);
  for (int i = 0; i < kNumCalibrationParameters; ++i) prior.sigma[i] = SigmaOfPrior(i);
}

// Shortens the blocks until there are enough of them.
absl::Status Calibrator::SetBlocks(const Intervals& intervals) {
  int64_t& block_us = adjustment_.block_us;
  block_us = options_.adjustment.block_us;
  while (NumBlocks(samples_, intervals, block_us) < kWantedBlocks && block_us / 2 >= kMinBlockUs) block_us /= 2;
  const int blocks = NumBlocks(samples_, intervals, block_us);
  if (blocks >= kMinBlocks) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrFormat(
      "the lines of the target are measured in %d parts of %.3f s while it is tracked and moves, and %d are needed: "
      "record longer, with the target moving by its own width in a second or faster",
      blocks, 1e-6 * static_cast<double>(block_us), kMinBlocks));
}

double Calibrator::SigmaOfPrior(int parameter) const {
  if (parameter == kFocal) return kFocalPrior * start_focal_px_;
  if (parameter == kAspect) return kAspectPrior;
  if (parameter < kDistortion) return kCentrePrior * camera_.width_px;
  if (parameter >= kEdgeShift) return kEdgeShiftPriorPx;
  const bool is_tangential =
      parameters_.lens_model != LensModel::kFisheye && (parameter == kDistortion + 2 || parameter == kDistortion + 3);
  if (is_tangential) return kTangentialPrior;
  return parameters_.lens_model == LensModel::kRational ? kRationalPrior : kRadialPrior;
}

absl::Status Calibrator::Adjust(const FreeParameters& free, int times, Intervals& intervals) {
  for (int i = 0; i < times; ++i) {
    SetParameters(parameters_, camera_);
    EVPOSE_RETURN_IF_ERROR(camera_.CheckView());
    LineSampler sampler(camera_, *edges_, options_.samples);
    samples_.clear();
    for (size_t k = 0; k < intervals.size(); ++k) sampler.Sample(intervals[k], static_cast<int>(k), samples_);
    RemoveWeakIntervals(samples_);
    if (samples_.empty()) return absl::OkStatus();
    // The first adjustment uses the expected errors, the second those that the residuals show.
    EVPOSE_RETURN_IF_ERROR(AdjustCamera(samples_, free, adjustment_, parameters_, absl::MakeSpan(intervals)));
    ScaleErrors(parameters_, intervals, absl::MakeSpan(samples_));
    EVPOSE_RETURN_IF_ERROR(AdjustCamera(samples_, free, adjustment_, parameters_, absl::MakeSpan(intervals)));
  }
  SetParameters(parameters_, camera_);
  return camera_.CheckView();
}

std::vector<CalibrationParameters> Calibrator::Starts() const {
  std::vector<CalibrationParameters> starts;
  const double unit_px = options_.focal_px.value_or(camera_.width_px);
  for (const double ratio : options_.focal_px ? absl::MakeConstSpan(kTrialOfGuess) : absl::MakeConstSpan(kTrialFocal)) {
    starts.push_back(DefaultParameters(ratio * unit_px));
    if (options_.lens_model == LensModel::kFisheye || ratio * unit_px > camera_.width_px) continue;
    starts.push_back(starts.back());
    std::copy(std::begin(kBarrel), std::end(kBarrel), starts.back().values.begin() + kDistortion);
  }
  return starts;
}

// Tries several focal lengths, and keeps the one whose adjusted lines fit best.
absl::Status Calibrator::FindStart() {
  struct Trial {
    CalibrationParameters parameters = {};
    size_t num_samples = 0;
    double rms_px = 0.0;
  };
  std::vector<Trial> trials;
  const std::vector<CalibrationParameters> starts = Starts();
  for (const CalibrationParameters& start : starts) {
    on_progress_(0.2 * static_cast<double>(trials.size()) / static_cast<double>(starts.size()),
                 absl::StrFormat("focal length of %.0f px tried", start[kFocal]));
    Trial& trial = trials.emplace_back();
    SetPrior(options_.focal_px.value_or(start[kFocal]));
    parameters_ = start;
    SetParameters(parameters_, camera_);
    if (!camera_.CheckView().ok()) continue;
    TrackedRecordingOptions tracked{.sensor = options_.sensor,
                                    .max_duration_us = kMaxTrialUs,
                                    .max_tracked_us = kTrialUs,
                                    .max_intervals = kTrialIntervals};
    EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> recording, open_(recordings_[0]));
    EVPOSE_ASSIGN_OR_RETURN(Intervals intervals,
                            CollectIntervals(*recording, 0, model_, camera_, tracked, [](double) {}));
    FreeParameters free = {};
    free[kFocal] = free[kDistortion] = free[kEdgeShift] = true;
    samples_.clear();
    if (!Adjust(free, 2, intervals).ok() || samples_.empty()) continue;
    trial = {parameters_, samples_.size(), ComputeErrors(samples_, free, adjustment_, parameters_, intervals).rms_px};
  }
  size_t most = 0;
  for (const Trial& trial : trials) most = std::max(most, trial.num_samples);
  const Trial* best = nullptr;
  for (const Trial& trial : trials) {
    if (trial.num_samples == 0 || 2 * trial.num_samples < most) continue;
    if (best == nullptr || trial.rms_px < best->rms_px) best = &trial;
  }
  if (best == nullptr) {
    return absl::FailedPreconditionError(
        absl::StrFormat("%s: in its first %.0f s, the object was not found moving by more than %.0f px/s with any "
                        "focal length that was tried; give --focal-mm or --fov, and record the whole target moving in "
                        "view from the start",
                        recordings_[0], 1e-6 * kMaxTrialUs, options_.samples.min_speed_px_per_s));
  }
  parameters_ = best->parameters;
  SetPrior(options_.focal_px.value_or(parameters_[kFocal]));
  SetParameters(parameters_, camera_);
  return absl::OkStatus();
}

absl::StatusOr<Calibrator::Intervals> Calibrator::Track(int round) {
  Intervals all;
  for (size_t i = 0; i < recordings_.size(); ++i) {
    const double share = (round + static_cast<double>(i) / recordings_.size()) / options_.max_rounds;
    TrackedRecordingOptions tracked{.sensor = options_.sensor, .max_intervals = options_.max_intervals};
    EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> recording, open_(recordings_[i]));
    EVPOSE_ASSIGN_OR_RETURN(
        Intervals intervals,
        CollectIntervals(*recording, static_cast<int>(i), model_, camera_, tracked, [&](double seconds) {
          on_progress_(0.2 + 0.7 * share,
                       absl::StrFormat("round %d: %s, %.1f s tracked", round + 1, recordings_[i], seconds));
        }));
    if (intervals.empty()) {
      warnings_.push_back(absl::StrCat(recordings_[i], ": the object was not tracked; the recording is not used"));
    }
    std::move(intervals.begin(), intervals.end(), std::back_inserter(all));
  }
  return all;
}

// Frees all parameters; then fixes, one after the other, those that the data do not determine.
absl::Status Calibrator::AdjustDetermined(Intervals& intervals) {
  free_ = AllParameters(options_.lens_model);
  while (true) {
    EVPOSE_RETURN_IF_ERROR(Adjust(free_, 2, intervals));
    EVPOSE_RETURN_IF_ERROR(SetBlocks(intervals));
    errors_ = ComputeErrors(samples_, free_, adjustment_, parameters_, intervals);
    adjustment_.prior->dispersion = errors_.dispersion;
    int worst = -1;
    double worst_ratio = kMaxErrorToPrior;
    for (int i = 0; i < kNumCalibrationParameters; ++i) {
      const double ratio = std::sqrt(errors_.covariance(i, i)) / SigmaOfPrior(i);
      if (!free_[i] || ratio <= worst_ratio) continue;
      worst_ratio = ratio;
      worst = i;
    }
    if (worst < 0) return absl::OkStatus();
    if (worst == kFocal && !options_.focal_px) {
      return absl::FailedPreconditionError(absl::StrFormat(
          "the recordings do not determine the focal length (%.0f +- %.0f px): record the target tilted to all sides "
          "by 30 degrees and more, near enough to fill a third of the image, while it moves; or give --fov or "
          "--focal-mm, which is then kept",
          parameters_[kFocal], std::sqrt(errors_.covariance(kFocal, kFocal))));
    }
    free_[worst] = false;
    parameters_[worst] = adjustment_.prior->mean[worst];
  }
}

double Calibrator::LargestMotionPx(const CalibrationParameters& from, const CalibrationParameters& to) const {
  double largest = 0.0;
  for (const LineSample& sample : samples_) {
    // Bearing by the first camera without distortion; it is accurate enough to measure how far the image has moved.
    const Vector2d bearing((sample.pixel.x() - from[kCentreX]) / from[kFocal],
                           (sample.pixel.y() - from[kCentreY]) / (from[kFocal] * from[kAspect]));
    largest = std::max(largest, (ProjectBearing(from, bearing) - ProjectBearing(to, bearing)).norm());
  }
  return largest;
}

std::vector<ProjectionUncertainty> Calibrator::Places() const {
  const double right = camera_.width_px - 1, bottom = camera_.height_px - 1;
  return {{"centre", {0.5 * right, 0.5 * bottom}}, {"left edge", {0.0, 0.5 * bottom}},
          {"right edge", {right, 0.5 * bottom}},   {"upper edge", {0.5 * right, 0.0}},
          {"lower edge", {0.5 * right, bottom}},   {"upper left corner", {0.0, 0.0}},
          {"upper right corner", {right, 0.0}},    {"lower left corner", {0.0, bottom}},
          {"lower right corner", {right, bottom}}};
}

absl::Status Calibrator::CompareHalves(const Intervals& intervals, CameraCalibration& result) {
  const absl::StatusOr<UndistortionTable> table = UndistortionTable::Create(camera_);
  if (!table.ok())
    return absl::FailedPreconditionError(
        absl::StrCat("the estimated lens cannot be inverted in the whole image: ", table.status().message(),
                     "; record the target near the borders of the image, too"));
  std::array<CalibrationParameters, 2> halves;
  for (int half = 0; half < 2; ++half) {
    std::vector<LineSample> samples;
    for (const LineSample& sample : samples_) {
      if (intervals[sample.interval].t_us / adjustment_.block_us % 2 == half) samples.push_back(sample);
    }
    halves[half] = parameters_;
    Intervals poses;
    for (const CalibrationInterval& interval : intervals) {
      poses.push_back({.recording = interval.recording,
                       .t_us = interval.t_us,
                       .duration_us = interval.duration_us,
                       .camera_from_object = interval.camera_from_object,
                       .twist = interval.twist});
    }
    if (samples.empty()) continue;
    EVPOSE_RETURN_IF_ERROR(AdjustCamera(samples, free_, adjustment_, halves[half], absl::MakeSpan(poses)));
  }
  result.uncertainties = Places();
  for (ProjectionUncertainty& place : result.uncertainties) {
    const Vector2d bearing =
        table->Bearing(static_cast<int>(place.pixel.x()), static_cast<int>(place.pixel.y())).cast<double>();
    const auto jacobian = ProjectionJacobian(parameters_, bearing);
    const Eigen::Matrix2d covariance = jacobian * errors_.covariance * jacobian.transpose();
    place.sigma_px =
        std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(covariance, Eigen::EigenvaluesOnly).eigenvalues()(1));
    place.half_difference_px = (ProjectBearing(halves[0], bearing) - ProjectBearing(halves[1], bearing)).norm();
  }
  return absl::OkStatus();
}

void Calibrator::Describe(const Intervals& intervals, CameraCalibration& result) const {
  result.camera = camera_;
  result.rms_px = errors_.rms_px;
  const std::vector<double> residuals = ResidualsPx(samples_, parameters_, intervals);
  int last_interval = -1;
  for (size_t i = 0; i < samples_.size(); ++i) {
    const LineSample& sample = samples_[i];
    result.num_intervals += sample.interval != last_interval;
    last_interval = sample.interval;
    result.num_events += sample.num_events;
    const auto cell = [](double px, int size_px, int count) {
      return std::clamp(static_cast<int>(px * count / size_px), 0, count - 1);
    };
    CoverageCell& seen = result.coverage[cell(sample.pixel.y(), camera_.height_px, kCoverageRows)]
                                        [cell(sample.pixel.x(), camera_.width_px, kCoverageColumns)];
    ++seen.num_samples;
    seen.rms_px += residuals[i] * residuals[i];
  }
  result.num_samples = static_cast<int>(samples_.size());
  for (auto& row : result.coverage) {
    for (CoverageCell& cell : row) cell.rms_px = std::sqrt(cell.rms_px / std::max(1, cell.num_samples));
  }
  const FreeParameters all = AllParameters(options_.lens_model);
  for (int i = 0; i < kNumCalibrationParameters; ++i) {
    if (!all[i]) continue;
    result.parameters.push_back({std::string(CalibrationParameterName(options_.lens_model, i)), parameters_[i],
                                 std::sqrt(errors_.covariance(i, i)), std::sqrt(errors_.bound(i, i)), free_[i]});
  }
}

void Calibrator::AddWarnings(CameraCalibration& result) const {
  result.warnings = warnings_;
  for (const CalibratedParameter& parameter : result.parameters) {
    if (parameter.is_fitted) continue;
    const bool is_of_edges = absl::StartsWith(parameter.name, "edge_");  // of the displacement of the events
    result.warnings.push_back(
        absl::StrFormat("the recordings do not determine %s, which stays at %g: %s", parameter.name, parameter.value,
                        is_of_edges ? "move the target at different speeds"
                                    : "record the target in all parts of the image, tilted to all sides"));
  }
  if (adjustment_.block_us < options_.adjustment.block_us) {
    result.warnings.push_back(absl::StrFormat(
        "the target is tracked for so short a time that the standard errors are from parts of %.3f s; errors that last "
        "longer, as those of the model, are not in them: record at least 20 s in all",
        1e-6 * static_cast<double>(adjustment_.block_us)));
  }
  for (const ProjectionUncertainty& place : result.uncertainties) {
    // The difference of two independent halves has twice the standard deviation of the whole.
    if (place.half_difference_px <= 3.0 * 2.0 * std::max(place.sigma_px, 0.02)) continue;
    result.warnings.push_back(absl::StrFormat(
        "the halves of the data differ by %.2f px at the %s, more than the standard error of %.2f px explains: the "
        "model of the target, its flatness or the kind of lens is wrong",
        place.half_difference_px, place.place, place.sigma_px));
  }
  if (!result.is_converged) {
    result.warnings.push_back(
        absl::StrFormat("the parameters still change by more than a tenth of their standard errors after %d rounds",
                        result.num_rounds));
  }
}

absl::StatusOr<CameraCalibration> Calibrator::Run() {
  EVPOSE_RETURN_IF_ERROR(FindStart());
  CameraCalibration result;
  Intervals intervals;
  CalibrationParameters tracked_with = parameters_;
  bool must_track = true;
  for (int round = 0; round < options_.max_rounds && !result.is_converged; ++round) {
    const CalibrationParameters before = parameters_;
    if (must_track) {
      warnings_.clear();
      tracked_with = parameters_;
      EVPOSE_ASSIGN_OR_RETURN(intervals, Track(round));
    }
    on_progress_(0.2 + 0.7 * (round + 0.9) / options_.max_rounds, absl::StrFormat("round %d: adjusting", round + 1));
    EVPOSE_RETURN_IF_ERROR(AdjustDetermined(intervals));
    result.num_rounds = round + 1;
    const bool tracked_now = must_track;
    // Poses and motions of tracking are those of its camera; half a pixel is below the spread of the events.
    constexpr double kSameCameraPx = 0.5;
    must_track = LargestMotionPx(tracked_with, parameters_) > kSameCameraPx;
    double change = 0.0;
    for (int i = 0; i < kNumCalibrationParameters; ++i) {
      if (!free_[i]) continue;
      change = std::max(change, std::abs(parameters_[i] - before[i]) / std::sqrt(errors_.covariance(i, i)));
    }
    result.is_converged = !must_track && !tracked_now && change < options_.converged_ratio;
  }
  on_progress_(0.92, "comparing the halves of the data");
  EVPOSE_RETURN_IF_ERROR(CompareHalves(intervals, result));
  Describe(intervals, result);
  AddWarnings(result);
  return result;
}

}  // namespace

absl::Status CameraCalibrationOptions::Validate() const {
  if (focal_px) EVPOSE_RETURN_IF_ERROR(CheckRange("CameraCalibrationOptions.focal_px", *focal_px, 1.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(sensor.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("CameraCalibrationOptions.max_intervals", max_intervals, 10, 10'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("CameraCalibrationOptions.max_rounds", max_rounds, 1, 100));
  return CheckRange("CameraCalibrationOptions.converged_ratio", converged_ratio, 1e-6, 10.0);
}

absl::StatusOr<CameraCalibration> CalibrateCamera(absl::Span<const std::string> recordings, const RecordingOpener& open,
                                                  std::shared_ptr<const ObjectModel> model, SensorGeometry sensor,
                                                  const CameraCalibrationOptions& options,
                                                  const CalibrationProgress& on_progress) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  if (recordings.empty()) return absl::InvalidArgumentError("a calibration needs a recording");
  if (model == nullptr || model->lines.empty()) {
    return absl::InvalidArgumentError("the model has no straight lines; a calibration needs them");
  }
  return Calibrator(recordings, open, std::move(model), sensor, options, on_progress).Run();
}

}  // namespace evpose
