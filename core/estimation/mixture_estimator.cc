// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/mixture_estimator.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/estimation/flood_shift.h"
#include "core/numerics/reusable_vector.h"

namespace evpose {
namespace {

// Below this speed the Poisson Hessian of absence would grow without bound; nothing is told apart there anyway.
constexpr double kMinSpeedPxPerS = 5.0;

// The speed across a half of a line, px/s, is its product with the twist.
Vector6d HalfSpeedRow(const CameraModel& camera, const ImageLine& line, int half) {
  return line.jacobian.transpose() * BearingOf(camera, line.PointAt(0.25 + 0.5 * half));
}

class MixtureEstimator : public WindowEstimator {
 public:
  MixtureEstimator(const EstimatorOptions& options, const CameraModel& camera)
      : options_(options.mixture),
        sensor_(options.sensor),
        camera_(camera),
        edge_bias_(options.edge, options.sensor, camera),
        clutter_(camera) {
    Reset();
  }

  double ReachPx(double predicted_spread_px, double gate_factor) const override {
    // Lines move by as much again before the pose has settled.
    return 2.0 * FirstGatePx(predicted_spread_px, gate_factor);
  }
  int MaxEvents() const override { return options_.max_events; }

  void Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) override;

  void Accept(const WindowFit& fit, const WindowInput& input) override {
    // About ten windows' worth of memory: spread and clutter change with the view, not with the millisecond.
    constexpr double kMemoryEvents = 5000.0;
    const double n = fit.num_explained;
    const double variance =
        (kMemoryEvents * sigma_px_ * sigma_px_ + n * fit.residual_rms_px * fit.residual_rms_px) / (kMemoryEvents + n);
    sigma_px_ = std::clamp(std::sqrt(variance), options_.sigma_min_factor * sensor_.pixel_noise_px,
                           options_.sigma_max_factor * sensor_.pixel_noise_px);
    const double gated = fit.num_gated;
    if (gated > 0.0) {
      outlier_ratio_ = (kMemoryEvents * outlier_ratio_ + (gated - n)) / (kMemoryEvents + gated);
    }
    LearnDisplacement();
    counts_.clear();
    for (const MixtureLine& line : sums_) counts_.push_back(line.Counts(input.shares.events_per_observation));
    clutter_.Learn(input.lines, lines_, line_counts_, final_gate_px_);
    edge_bias_.Learn(input.lines, lines_, counts_, input.duration_s);
  }

  void Reset() override {
    sigma_px_ = sensor_.pixel_noise_px;
    outlier_ratio_ = 0.2;
    edge_bias_.Reset();
    clutter_.Reset();
    displacement_px2_ = 0.0;
    displacement_factor_ = 1.0;
  }

  void SaveState(StateWriter& writer) const override { VisitState(writer, *this); }
  void LoadState(StateReader& reader) override { VisitState(reader, *this); }
  static void VisitState(auto& archive, auto& self) {
    auto& [options, sensor, camera, table, sigma_px, outlier_ratio, displacement_px2, displacement_factor, noise_per_px,
           final_gate_px, pass, lines, sums, counts, line_counts, flood_shifts_px, densities, answers, edge_bias,
           clutter] = self;
    archive(InRange(sigma_px, 1e-6, 1e6), AtMost(outlier_ratio, 1.0), Finite(displacement_px2),
            InRange(displacement_factor, 1.0, 1e6), edge_bias, clutter);
  }

 private:
  void CountLines() {
    line_counts_.clear();
    for (const MixtureLine& line : sums_) line_counts_.push_back({line.weight(), line.beside});
  }
  // Displaces the lines to where the last pass's counts say that their events are.
  void ShiftByFlood(const ByPolarity& events_per_observation, double gate_px);
  // What the lines' events have in common is seen in what the fit leaves of it: the lines' mean residuals.
  void LearnDisplacement();
  double FirstGatePx(double spread_px, double gate_factor) const {
    const double wanted = 3.0 * std::sqrt(sigma_px_ * sigma_px_ + spread_px * spread_px);
    return gate_factor * std::clamp(wanted, options_.gate_px, options_.max_gate_px);
  }
  void Project(const MotionState& state, const WindowInput& input) {
    ProjectLines(camera_, state, input.lines, lines_);
    ProjectVelocityJacobians(camera_, state, input.lines, absl::MakeSpan(lines_));
    edge_bias_.Correct(input.lines, absl::MakeSpan(lines_));
    for (size_t k = 0; k < lines_.size(); ++k) lines_[k].a_expected.z() -= flood_shifts_px_[k];
  }
  // Moves `state` to the minimum for the present sums; returns the largest movement of a line's middle, pixels.
  double Minimise(const MotionState& predicted, const Matrix12d& prior_information, const WindowInput& input,
                  double sigma_px, MotionState& state);
  // Counts the lines' answers; returns the share of them that is missing. kComplete: as if it were known whose the
  // events are, for a step of expectation-maximisation; kObserved: what they tell without, for the covariance.
  enum class Information { kComplete, kObserved };
  double NormalEquations(const MotionState& state, const WindowInput& input, double sigma_px, Information information,
                         Matrix12d& hessian, Vector12d& gradient);
  double MovementPx(const Vector12d& dx, double duration_s) const;
  // Additional position uncertainty, in pixels, of a line of a face that is seen nearly edge-on: its two edges are
  // closer together than the spread of the events, so that an event cannot be assigned to one of them
  // (core/estimation/README.md, section 6).
  double OfEitherEdgePx(const TrackedLine& line) const {
    constexpr double kTellingSigma = 3.0;
    return 0.5 * std::max(0.0, kTellingSigma * sigma_px_ - line.narrowest_face_px);
  }
  // Events in the gates that come as anywhere on the sensor. A line that rests has only those, and must not be fitted
  // to them.
  double Background(const WindowInput& input, double gate_px) const;

  const MixtureOptions options_;
  const SensorProfile sensor_;
  const CameraModel camera_;
  const ExpTable table_;
  double sigma_px_ = 0.0;
  double outlier_ratio_ = 0.0;
  double displacement_px2_ = 0.0;  // mean square of the lines' displacements, of the last 100 windows or so
  double displacement_factor_ = 1.0;
  double noise_per_px_ = 0.0;   // of the window: background events that count as a line's, per pixel of its length
  double final_gate_px_ = 0.0;  // of the last fit's last pass
  MixturePass pass_;
  std::vector<ImageLine> lines_;
  std::vector<MixtureLine> sums_;
  std::vector<EdgeCounts> counts_;
  std::vector<LineCounts> line_counts_;  // of the last pass
  std::vector<double> flood_shifts_px_;  // by which lines_ are displaced, flood_shift.h
  std::vector<LineDensities> densities_;
  std::vector<LineAnswer> answers_;
  EdgeBias edge_bias_;
  LineClutter clutter_;
};

// The bearings' (1, position along the line from -1 to 1): basis^T b.
Eigen::Matrix<double, 3, 2> AlongLine(const CameraModel& camera, const ImageLine& line) {
  const Eigen::Vector2d along = 2.0 / line.length_px * line.direction;
  Eigen::Matrix<double, 3, 2> basis;
  basis.col(0) = Eigen::Vector3d::UnitZ();
  basis.col(1) << along.x() * camera.fx_px, along.y() * camera.fy_px,
      along.dot(Eigen::Vector2d(camera.cx_px, camera.cy_px) - line.p1_px) - 1.0;
  return basis;
}

// Column by column: for all of them at once Eigen would block and pack them as those of large matrices.
Matrix12d SymmetricInverse(const Matrix12d& matrix) {
  const Eigen::LDLT<Matrix12d> factors(matrix);
  Matrix12d inverse;
  for (int k = 0; k < 12; ++k) inverse.col(k) = factors.solve(Vector12d::Unit(k));
  return 0.5 * (inverse + inverse.transpose());
}

void MixtureEstimator::Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) {
  constexpr double kSettledPx = 0.04;
  // The background's count is not known better.
  constexpr double kMaxBackgroundRatio = 0.99;
  const Matrix12d prior_information = SymmetricInverse(predicted.covariance);

  MotionState state = predicted;
  AssignDefaults(input.lines.size(), flood_shifts_px_);
  Project(state, input);
  const double spread_px = PredictedSpreadPx(camera_, predicted, lines_);
  MixtureDensity density{sigma_px_, outlier_ratio_, FirstGatePx(spread_px, gate_factor)};
  double annealed_px2 = spread_px * spread_px;
  MixtureTotals totals;
  double counts_gate_px = 0.0;  // of line_counts_
  line_counts_.clear();
  for (int pass = 0; pass < options_.max_passes; ++pass) {
    const bool last = pass + 1 == options_.max_passes;
    // The gate and the spread shrink to their final values: what is uncertain at first is the prediction.
    if (last) annealed_px2 = 0.0;
    density.sigma_px = std::sqrt(sigma_px_ * sigma_px_ + annealed_px2);
    density.gate_px = std::max(options_.gate_px, std::min(density.gate_px, 4.0 * density.sigma_px * gate_factor));
    clutter_.Densities(input.lines, lines_, line_counts_, counts_gate_px, density, densities_);
    counts_gate_px = density.gate_px;
    totals = pass_.Accumulate(*input.sorted, lines_, density, densities_, sums_);
    CountLines();
    const double background = Background(input, density.gate_px) / std::max(totals.num_gated, 1.0);
    density.outlier_ratio = std::clamp(background, outlier_ratio_, std::max(outlier_ratio_, kMaxBackgroundRatio));
    noise_per_px_ = input.background_per_px2 * density.OwnWidthPx(table_);
    if (input.is_believed) ShiftByFlood(input.shares.events_per_observation, density.gate_px);
    const double moved_px = Minimise(predicted, prior_information, input, density.sigma_px, state);
    if (pass > 0 && moved_px < kSettledPx && annealed_px2 < 0.01 * sigma_px_ * sigma_px_) break;
    annealed_px2 *= 0.1;
  }

  Matrix12d hessian = Matrix12d::Zero();
  Vector12d gradient = Vector12d::Zero();
  AddPriorEquations(state, predicted, prior_information, hessian, gradient);
  fit.Clear();
  fit.missing_ratio = NormalEquations(state, input, density.sigma_px, Information::kObserved, hessian, gradient);
  state.covariance = SymmetricInverse(hessian);

  final_gate_px_ = density.gate_px;
  fit.state = state;
  fit.num_gated = totals.num_gated;
  fit.num_background = Background(input, density.gate_px);
  fit.num_explained = totals.weight;
  for (const MixtureLine& line : sums_) fit.line_events.push_back(line.weight()[0] + line.weight()[1]);
  fit.answers = answers_;
  fit.residual_rms_px = totals.weight > 0.0 ? std::sqrt(totals.weighted_squares_px2 / totals.weight) : sigma_px_;
}

double MixtureEstimator::Minimise(const MotionState& predicted, const Matrix12d& prior_information,
                                  const WindowInput& input, double sigma_px, MotionState& state) {
  constexpr int kSteps = 2;
  constexpr double kLinearPx = 0.05;  // what a second step would add to such a one is a thousandth of it
  double moved_px = 0.0;
  for (int step = 0; step < kSteps; ++step) {
    Matrix12d hessian = Matrix12d::Zero();
    Vector12d gradient = Vector12d::Zero();
    AddPriorEquations(state, predicted, prior_information, hessian, gradient);
    NormalEquations(state, input, sigma_px, Information::kComplete, hessian, gradient);
    const Vector12d dx = -hessian.ldlt().solve(gradient);
    if (!dx.allFinite()) break;
    const double step_px = MovementPx(dx, input.duration_s);
    state = Plus(state, dx);
    Project(state, input);
    moved_px = std::max(moved_px, step_px);
    if (step_px < kLinearPx) break;
  }
  return moved_px;
}

double MixtureEstimator::NormalEquations(const MotionState& state, const WindowInput& input, double sigma_px,
                                         Information information, Matrix12d& hessian, Vector12d& gradient) {
  const double event_scale = 1.0 / (sigma_px * sigma_px * options_.events_per_information);
  const double displacement_px =
      options_.edge_noise_px_sqrt_s * std::sqrt(displacement_factor_ / std::max(input.duration_s, 1e-6));
  for (size_t k = 0; k < lines_.size(); ++k) {
    if (!lines_[k].in_view() || sums_[k].sums.weight() <= 0.0) continue;
    const double scale =
        information == Information::kObserved ? sums_[k].ObservedRatio(sigma_px) * event_scale : event_scale;
    LineEquations equations(sums_[k].sums, lines_[k], scale);
    const double line_px = std::hypot(displacement_px, OfEitherEdgePx(input.lines[k]));
    if (line_px > 0.0) equations.Marginalise({AlongLine(camera_, lines_[k]), line_px});
    equations.AddTo(hessian, gradient);
  }
  CountAnswers(camera_, input, lines_, sums_, state.twist, noise_per_px_, options_.min_events_per_px2, answers_);
  return AddAbsence(camera_, lines_, answers_, input.past_answers, state.twist, 1.0 / options_.events_per_information,
                    hessian, gradient);
}

void MixtureEstimator::ShiftByFlood(const ByPolarity& events_per_observation, double gate_px) {
  for (size_t k = 0; k < lines_.size(); ++k) {
    const double shift_px = FloodShiftPx(line_counts_[k], events_per_observation, gate_px, sigma_px_);
    lines_[k].a_expected.z() -= shift_px - flood_shifts_px_[k];
    flood_shifts_px_[k] = shift_px;
  }
}

void MixtureEstimator::LearnDisplacement() {
  constexpr double kMinWeight = 20.0;
  constexpr double kForget = 0.01;
  // A line has two unknowns, the pose six.
  constexpr double kLinesOfAPose = 3.0;
  constexpr double kMaxFactor = 30.0;
  double count = 0.0;
  double squares_px2 = 0.0;
  double observed_squares = 0.0;
  for (size_t k = 0; k < lines_.size(); ++k) {
    const LineSums& sums = sums_[k].sums;
    if (sums.weight() < kMinWeight || !lines_[k].in_view()) continue;
    const double mean_px = sums.Sum(0).dot(lines_[k].a_expected) + sums.Sum(1).dot(lines_[k].a_dot);
    const double w = sums.weight();
    const double observed = sums_[k].ObservedRatio(sigma_px_);
    squares_px2 += mean_px * mean_px / (w * w) - observed * sigma_px_ * sigma_px_ * options_.events_per_information / w;
    observed_squares += observed * observed;
    count += 1.0;
  }
  if (count <= kLinesOfAPose) return;
  const double mean_px2 = squares_px2 / (observed_squares * (1.0 - kLinesOfAPose / count));
  displacement_px2_ += kForget * (mean_px2 - displacement_px2_);
  const double usual_px = options_.usual_displacement_px;
  displacement_factor_ = std::clamp(displacement_px2_ / (usual_px * usual_px), 1.0, kMaxFactor);
}

double MixtureEstimator::Background(const WindowInput& input, double gate_px) const {
  double length_px = 0.0;
  for (const ImageLine& line : lines_) length_px += line.length_px;
  return input.background_per_px2 * 2.0 * gate_px * length_px * input.shares.observations_per_background_event;
}

double MixtureEstimator::MovementPx(const Vector12d& dx, double duration_s) const {
  double largest = 0.0;
  for (const ImageLine& line : lines_) {
    if (!line.in_view()) continue;
    const Vector6d row = line.jacobian.transpose() * BearingOf(camera_, line.PointAt(0.5));
    largest = std::max(largest, std::abs(row.dot(dx.head<6>())) + 0.5 * duration_s * std::abs(row.dot(dx.tail<6>())));
  }
  return largest;
}

}  // namespace

absl::Status MixtureOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("sigma_min_factor", sigma_min_factor, 0.1, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("sigma_max_factor", sigma_max_factor, 1.0, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("gate_px", gate_px, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_gate_px", max_gate_px, gate_px, 64.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("retry_gate_factor", retry_gate_factor, 1.0, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_passes", max_passes, 1, 100));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_events", max_events, 50, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("events_per_information", events_per_information, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("edge_noise_px_sqrt_s", edge_noise_px_sqrt_s, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("usual_displacement_px", usual_displacement_px, 1e-3, 10.0));
  return CheckRange("min_events_per_px2", min_events_per_px2, 0.0, 100.0);
}

void CountAnswers(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                  absl::Span<const MixtureLine> sums, const Vector6d& twist, double noise_per_px,
                  double min_events_per_px2, std::vector<LineAnswer>& answers) {
  AssignDefaults(lines.size(), answers);
  for (size_t k = 0; k < lines.size(); ++k) {
    if (!lines[k].in_view()) continue;
    const double half_px = 0.5 * lines[k].length_px;
    for (int half = 0; half < 2; ++half) {
      const double speed = std::max(std::abs(HalfSpeedRow(camera, lines[k], half).dot(twist)), kMinSpeedPxPerS);
      answers[k].expected[half] = min_events_per_px2 * half_px * speed * input.duration_s;
      const double events = sums[k].half_weight[half][0] * input.shares.events_per_observation[0] +
                            sums[k].half_weight[half][1] * input.shares.events_per_observation[1];
      answers[k].observed[half] = events - noise_per_px * half_px;
    }
  }
}

double AddAbsence(const CameraModel& camera, absl::Span<const ImageLine> lines, absl::Span<const LineAnswer> answers,
                  absl::Span<const LineAnswer> past, const Vector6d& twist, double scale, Matrix12d& hessian,
                  Vector12d& gradient) {
  // Events missing of each half line.
  const auto missing_of = [&](size_t k, int half) {
    const LineAnswer before = past.empty() ? LineAnswer() : past[k];
    const double observed = std::max(0.0, answers[k].observed[half] + before.observed[half]);
    const double expected = answers[k].expected[half];
    return expected * std::max(0.0, 1.0 - observed / (expected + before.expected[half]));
  };
  double all_expected = 0.0;
  double all_missing = 0.0;
  for (size_t k = 0; k < lines.size(); ++k) {
    if (!lines[k].in_view()) continue;
    for (int half = 0; half < 2; ++half) {
      all_expected += answers[k].expected[half];
      all_missing += missing_of(k, half);
    }
  }
  if (!(all_missing > 0.0)) return 0.0;
  const double missing_ratio = all_missing / all_expected;
  const double factor = scale * (2.0 * missing_ratio - 1.0);
  if (factor <= 0.0) return missing_ratio;
  for (size_t k = 0; k < lines.size(); ++k) {
    if (!lines[k].in_view()) continue;
    for (int half = 0; half < 2; ++half) {
      const Vector6d row = HalfSpeedRow(camera, lines[k], half);
      const double velocity = row.dot(twist);
      const double speed = std::max(std::abs(velocity), kMinSpeedPxPerS);
      const double curvature = factor * missing_of(k, half) / (speed * speed);
      hessian.bottomRightCorner<6, 6>() += curvature * row * row.transpose();
      gradient.tail<6>() += curvature * velocity * row;
    }
  }
  return missing_ratio;
}

std::unique_ptr<WindowEstimator> MakeMixtureEstimator(const EstimatorOptions& options, const CameraModel& camera) {
  return std::make_unique<MixtureEstimator>(options, camera);
}

}  // namespace evpose
