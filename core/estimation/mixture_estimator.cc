// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/mixture_estimator.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "core/base/check_range.h"
#include "core/base/paced_yields.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/estimation/event_deficit.h"
#include "core/estimation/event_dispersion.h"
#include "core/estimation/flicker_bias.h"
#include "core/geometry/covariance_inverse.h"
#include "core/geometry/lines_of_a_pose.h"
#include "core/numerics/math.h"
#include "core/numerics/reusable_vector.h"

namespace evpose {
namespace {

// Windows after which the sensitivity to systematic errors is updated. It changes with the view, within some 0.1 s.
constexpr int kWindowsPerSystematic = 8;
// Pixels by which the lines are moved to first order before they are projected again. The term of second order is then
// about 0.5^2 / (2 r) for a rotation about a point at r pixels: 0.003 px for 50 px.
constexpr double kLinearPx = 0.5;
// Pixels per second: below it the direction of the motion of a line, and with it the sign of its lag, is uncertain.
constexpr double kSlowPxPerS = 20.0;

// Number of lines between two yield points; their equations take about 0.1 ms.
constexpr size_t kLinesBetweenYields = 128;

class MixtureEstimator : public WindowEstimator {
 public:
  MixtureEstimator(const EstimatorOptions& options, const CameraModel& camera)
      : options_(options.mixture),
        systematic_options_(options.systematic),
        sensor_(options.sensor),
        camera_(camera),
        learned_{.sigma_px = options.sensor.pixel_noise_px,
                 .outlier_ratio = options.mixture.initial_outlier_ratio,
                 .edge_bias = EdgeBias(options.edge, options.sensor, camera),
                 .clutter = LineClutter(camera)} {}

  double ReachPx(double predicted_spread_px, double gate_factor) const override {
    // The pose, and with it the lines, may move by up to one gate before the passes converge, but hardly by more than
    // four standard deviations of the prediction.
    const double gate_px = FirstGatePx(predicted_spread_px, gate_factor);
    return gate_px + std::min(gate_px, 4.0 * predicted_spread_px);
  }
  int MaxEvents() const override { return options_.max_events; }
  bool UpdatesCovariance() const override { return true; }

  void Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) override {
    // Pixels: the passes end when the lines move by less, which is about half of the standard deviation of a line's
    // position from the events of one window.
    constexpr double kSettledPx = 0.04;
    // Upper bound of the outlier ratio from the background: a larger one would leave the line without weight, and the
    // background rate itself is not known better than this.
    constexpr double kMaxBackgroundRatio = 0.99;
    const Matrix12d prior_information = CovarianceInverse(predicted.covariance);

    MotionState state = predicted;
    AssignDefaults(input.lines.size(), window_.flicker_biases_px);
    StartFrom(predicted, input);
    const double spread_px = PredictedSpreadPx(camera_, predicted, window_.lines);
    MixtureDensity density{learned_.sigma_px, learned_.outlier_ratio, FirstGatePx(spread_px, gate_factor)};
    double annealed_px2 = spread_px * spread_px;
    MixtureTotals totals;
    double counts_gate_px = 0.0;  // gate to which window_.line_counts refer
    window_.line_counts.clear();
    for (int pass = 0; pass < options_.max_passes; ++pass) {
      YieldPoint();
      const bool is_last_pass = pass + 1 == options_.max_passes;
      // The gate and the spread shrink to their final values: at first they cover the uncertainty of the prediction.
      if (is_last_pass) annealed_px2 = 0.0;
      density.sigma_px = std::sqrt(learned_.sigma_px * learned_.sigma_px + annealed_px2);
      // Four standard deviations: the share of the normal beyond the gate, 6e-5, is negligible.
      density.gate_px = std::max(options_.gate_px, std::min(density.gate_px, 4.0 * density.sigma_px * gate_factor));
      learned_.clutter.Densities(input.lines, window_.lines, window_.line_counts, counts_gate_px, density,
                                 window_.densities);
      counts_gate_px = density.gate_px;
      totals = pass_.Accumulate(*input.sorted, window_.lines, density, window_.densities, window_.sums);
      CountObservations();
      const double background = Background(input, density.gate_px) / std::max(totals.num_gated, 1.0);
      density.outlier_ratio =
          std::clamp(background, learned_.outlier_ratio, std::max(learned_.outlier_ratio, kMaxBackgroundRatio));
      window_.noise_per_px = input.background_per_px2 * density.OwnWidthPx(table_);
      if (input.is_mostly_tested) CorrectFlickerBias(input, density.gate_px);
      const double moved_px = Minimise(predicted, prior_information, input, density.sigma_px, state);
      // The added variance shrinks by a factor of ten per pass and is negligible below 1 % of that of the events.
      if (pass > 0 && moved_px < kSettledPx && annealed_px2 < 0.01 * learned_.sigma_px * learned_.sigma_px) break;
      annealed_px2 *= 0.1;
    }

    Matrix12d hessian = Matrix12d::Zero();
    Vector12d gradient = Vector12d::Zero();
    AddPriorEquations(state, predicted, prior_information, hessian, gradient);
    fit.Clear();
    fit.deficit_ratio = NormalEquations(state, input, density.sigma_px, Information::kObserved, hessian, gradient);
    state.covariance = CovarianceInverse(hessian);
    fit.systematic_covariance = SystematicCovariance(prior_information, input, density.sigma_px, state);

    fit.state = state;
    fit.gate_px = density.gate_px;
    fit.num_gated = totals.num_gated;
    fit.num_background = Background(input, density.gate_px);
    fit.num_explained = totals.weight;
    for (const MixtureLine& line : window_.sums) fit.line_events.push_back(line.weight()[0] + line.weight()[1]);
    fit.deficit_counts = window_.deficit_counts;
    fit.residual_rms_px =
        totals.weight > 0.0 ? std::sqrt(totals.weighted_squares_px2 / totals.weight) : learned_.sigma_px;
  }

  void Accept(const WindowFit& fit, const WindowInput& input) override {
    const double memory = options_.memory_events;
    const double n = fit.num_explained;
    const double variance =
        (memory * learned_.sigma_px * learned_.sigma_px + n * fit.residual_rms_px * fit.residual_rms_px) / (memory + n);
    learned_.sigma_px = std::clamp(std::sqrt(variance), options_.sigma_min_factor * sensor_.pixel_noise_px,
                                   options_.sigma_max_factor * sensor_.pixel_noise_px);
    const double gated = fit.num_gated;
    if (gated > 0.0) {
      learned_.outlier_ratio = (memory * learned_.outlier_ratio + (gated - n)) / (memory + gated);
    }
    learned_.systematic = window_.next_systematic;
    learned_.until_systematic =
        learned_.until_systematic > 0 ? learned_.until_systematic - 1 : kWindowsPerSystematic - 1;
    LearnDisplacement(input.lines);
    LearnDispersion(input);
    window_.counts.clear();
    for (const MixtureLine& line : window_.sums) {
      window_.counts.push_back(line.Counts(input.sampling.events_per_observation));
    }
    learned_.clutter.Learn(input.lines, window_.lines, window_.line_counts, fit.gate_px);
    learned_.edge_bias.Learn(input.lines, window_.lines, window_.counts, input.duration_s);
  }

  void SaveState(StateWriter& writer) const override { writer(learned_); }
  void LoadState(StateReader& reader) override { reader(learned_); }

 private:
  // What has been learned from the accepted windows. The next window starts from it.
  struct Learned {
    double sigma_px;                // standard deviation of the events about the lines
    double outlier_ratio;           // share of the events beside the lines
    double displacement_px2 = 0.0;  // mean square displacement of the lines over about 100 windows
    double displacement_factor = 1.0;
    EdgeBias edge_bias;
    LineClutter clutter;
    EventDispersion dispersion;
    SystematicError systematic;
    int until_systematic = 0;  // windows until systematic is updated again

    static void VisitState(auto& archive, auto& self) {
      auto& [sigma_px, outlier_ratio, displacement_px2, displacement_factor, edge_bias, clutter, dispersion, systematic,
             until_systematic] = self;
      archive(InRange(sigma_px, 1e-6, 1e6), AtMost(outlier_ratio, 1.0), Finite(displacement_px2),
              InRange(displacement_factor, 1.0, 1e6), edge_bias, clutter, dispersion, systematic,
              AtMost(until_systematic, kWindowsPerSystematic));
    }
  };
  // The lines and sums of the window that is fitted, from Fit() to Accept(). The buffers keep their memory.
  struct FittedWindow {
    // Background events of the window that are attributed to a line, per pixel of its length.
    double noise_per_px = 0.0;
    double moved_px = 0.0;  // by which the lines moved since all of them were projected
    std::vector<ImageLine> lines;
    std::vector<MixtureLine> sums;
    std::vector<HalfOffsets> offsets;  // of the edge bias
    std::vector<EdgeCounts> counts;
    std::vector<LineCounts> line_counts;    // observations of each line in the last pass
    std::vector<double> flicker_biases_px;  // flicker bias of each line; ImageLine::a_expected contains it
    std::vector<LineDensities> densities;
    std::vector<DeficitCounts> deficit_counts;
    SystematicError next_systematic;     // that of the next window if this one is accepted
    std::vector<ImageLine> moved_lines;  // the lines with other residuals, for the gradients by systematic errors
  };

  // Sets the observations of each line to those of the last pass.
  void CountObservations() {
    window_.line_counts.clear();
    for (const MixtureLine& line : window_.sums) window_.line_counts.push_back({line.weight(), line.beside});
  }
  // Sets the flicker bias of each line (flicker_bias.h) from the counts of the last pass.
  void CorrectFlickerBias(const WindowInput& input, double gate_px) {
    ForEachCurve(input.lines, [&](size_t first, size_t end) {
      LineCounts counts;
      for (size_t k = first; k < end; ++k) counts.Add(window_.line_counts[k]);
      const double shift_px = FlickerBiasPx(counts, input.sampling.events_per_observation, gate_px, learned_.sigma_px);
      for (size_t k = first; k < end; ++k) {
        window_.lines[k].a_expected.z() -= shift_px - window_.flicker_biases_px[k];
        window_.flicker_biases_px[k] = shift_px;
      }
    });
  }
  // Sums over the lines [first, end) that are in view.
  struct ResidualSums {
    double weighted_px = 0.0;  // sum of the residuals times their weights
    double weight = 0.0;
    double ambiguous_px2 = 0.0;
  };
  ResidualSums SumResiduals(size_t first, size_t end) const {
    ResidualSums sum;
    for (size_t k = first; k < end; ++k) {
      if (!window_.lines[k].in_view()) continue;
      const LineSums& sums = window_.sums[k].sums;
      sum.weighted_px += sums.Sum(0).dot(window_.lines[k].a_expected) + sums.Sum(1).dot(window_.lines[k].a_dot);
      sum.weight += sums.weight();
      sum.ambiguous_px2 += window_.sums[k].ambiguous_px2;
    }
    return sum;
  }
  // Updates the scale of the common displacement of the events of a line from the mean residuals of the lines
  // (core/estimation/README.md, section 7).
  void LearnDisplacement(absl::Span<const TrackedLine> tracked) {
    // Sum of weights of a line that contributes: the mean of fewer events is dominated by their own noise.
    constexpr double kMinWeight = 20.0;
    // Share of a new window in the running mean, which therefore covers about 100 windows.
    constexpr double kForget = 0.01;
    // Bound of the growth: a displacement of 0.27 px. A larger one is a wrong pose and not the bias of an edge.
    constexpr double kMaxFactor = 30.0;
    double count = 0.0;
    double squares_px2 = 0.0;
    double observed_squares = 0.0;
    ForEachArc(tracked, window_.lines, [&](size_t first, size_t end) {
      const auto [sum_px, w, ambiguous_px2] = SumResiduals(first, end);
      if (w < kMinWeight) return;
      const double observed = MixtureLine::ObservedRatio(ambiguous_px2, w, learned_.sigma_px);
      squares_px2 += sum_px * sum_px / (w * w) -
                     observed * learned_.sigma_px * learned_.sigma_px * options_.events_per_information / w;
      observed_squares += observed * observed;
      count += 1.0;
    });
    if (count <= kLinesOfAPose) return;
    const double mean_px2 = squares_px2 / (observed_squares * (1.0 - kLinesOfAPose / count));
    learned_.displacement_px2 += kForget * (mean_px2 - learned_.displacement_px2);
    const double usual_px = options_.usual_displacement_px;
    learned_.displacement_factor = std::clamp(learned_.displacement_px2 / (usual_px * usual_px), 1.0, kMaxFactor);
  }
  // Updates the dispersion from the distances of the events of the lines.
  void LearnDispersion(const WindowInput& input) {
    const double displacement_px = DisplacementPx(input.duration_s);
    ForEachCurve(input.lines, [&](size_t first, size_t end) {
      const auto [sum_px, w, ambiguous_px2] = SumResiduals(first, end);
      if (!(w > 0.0)) return;
      const double observed = MixtureLine::ObservedRatio(ambiguous_px2, w, learned_.sigma_px);
      const double displaced_px = w * observed * displacement_px;
      const double independent_px2 =
          w * observed * learned_.sigma_px * learned_.sigma_px * options_.events_per_information;
      learned_.dispersion.Add(input.lines[first].curve, sum_px, independent_px2 + displaced_px * displaced_px, w);
    });
  }
  double EventsPerInformation() const { return options_.events_per_information * learned_.dispersion.factor(); }
  // Standard deviation of the displacement that the events of a line share in a window.
  double DisplacementPx(double duration_s) const {
    return options_.edge_noise_px_sqrt_s * std::sqrt(learned_.displacement_factor / std::max(duration_s, 1e-6));
  }
  double FirstGatePx(double spread_px, double gate_factor) const {
    // Three standard deviations of an event about the predicted line.
    const double wanted = 3.0 * std::sqrt(learned_.sigma_px * learned_.sigma_px + spread_px * spread_px);
    return gate_factor * std::clamp(wanted, options_.gate_px, options_.max_gate_px);
  }
  // Sets the lines of the first pass.
  void StartFrom(const MotionState& predicted, const WindowInput& input) {
    window_.lines.clear();
    for (const ImageLine& line : input.image_lines) window_.lines.push_back(line);
    if (input.image_lines.empty()) ProjectLines(camera_, predicted, input.lines, window_.lines);
    window_.moved_px = 0.0;
    learned_.edge_bias.FindOffsets(input.lines, window_.offsets);
    ProjectVelocityJacobians(camera_, predicted, input.lines, absl::MakeSpan(window_.lines));
    CorrectLines();
  }
  // Moves the lines to `state` after a step of the pose that moves them by at most `step_px`.
  void MoveTo(const MotionState& state, const Vector12d& change, double step_px, const WindowInput& input) {
    window_.moved_px += step_px;
    if (window_.moved_px <= kLinearPx) {
      MoveLines(change, absl::MakeSpan(window_.lines));
    } else {
      ProjectLines(camera_, state, input.lines, window_.lines);
      ProjectVelocityJacobians(camera_, state, input.lines, absl::MakeSpan(window_.lines));
      window_.moved_px = 0.0;
    }
    CorrectLines();
  }
  // Displaces the lines by the biases of their edges.
  void CorrectLines() {
    YieldPoint();
    learned_.edge_bias.Correct(window_.offsets, absl::MakeSpan(window_.lines));
    for (size_t k = 0; k < window_.lines.size(); ++k) window_.lines[k].a_expected.z() -= window_.flicker_biases_px[k];
  }
  // Moves `state` to the minimum for the weights of the last pass. Returns the largest movement of the middle of a
  // line, in pixels.
  double Minimise(const MotionState& predicted, const Matrix12d& prior_information, const WindowInput& input,
                  double sigma_px, MotionState& state) {
    // Gauss-Newton steps per pass: the next pass changes the weights anyway. While the lines move to first order, their
    // equations are linear, so that the first step leads to the minimum.
    constexpr int kSteps = 2;
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
      MoveTo(state, dx, step_px, input);
      moved_px = std::max(moved_px, step_px);
      if (step_px < kLinearPx) break;
    }
    return moved_px;
  }
  // Adds the equations of the lines and of the event deficit, and returns the missing share of the expected events.
  // kComplete: the information as if the assignment of the events were known, for a step of expectation-maximisation.
  // kObserved: the same minus the information that is lost because the assignment is unknown, for the covariance.
  enum class Information { kComplete, kObserved };
  double NormalEquations(const MotionState& state, const WindowInput& input, double sigma_px, Information information,
                         Matrix12d& hessian, Vector12d& gradient) {
    const double event_scale = 1.0 / (sigma_px * sigma_px * EventsPerInformation());
    const double displacement_px = DisplacementPx(input.duration_s);
    const auto scale_of = [&](size_t k) {
      return information == Information::kObserved ? window_.sums[k].ObservedRatio(sigma_px) * event_scale
                                                   : event_scale;
    };
    PacedYields yields(kLinesBetweenYields);
    ForEachArc(input.lines, window_.lines, [&](size_t first, size_t end) {
      AddEquations(input.lines, window_.lines, first, end, displacement_px, scale_of, &hessian, gradient);
      yields.Add(end - first);
    });
    CountForDeficit(camera_, input, window_.lines, window_.sums, state.twist, window_.noise_per_px,
                    options_.min_events_per_px2, window_.deficit_counts);
    return AddEventDeficit(camera_, window_.lines, window_.deficit_counts, input.past_deficit_counts, state.twist,
                           1.0 / EventsPerInformation(), hessian, gradient);
  }
  // Adds the equations of the lines [first, end) of an arc, or their gradient alone where `hessian` is null. `lines`
  // are window_.lines, or a copy with other residuals.
  template <typename ScaleOf>
  void AddEquations(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines, size_t first, size_t end,
                    double displacement_px, const ScaleOf& scale_of, Matrix12d* hessian, Vector12d& gradient) const {
    if (tracked[first].is_element) {
      AddArc(tracked, lines, first, end, displacement_px, scale_of, hessian, gradient);
      return;
    }
    if (!HasEvents(first)) return;
    LineEquations equations(window_.sums[first].sums, lines[first], scale_of(first));
    const double line_px = Hypotenuse(displacement_px, NarrowFacePx(tracked[first]));
    if (line_px > 0.0) equations.Marginalise({AlongLine(camera_, lines[first]), line_px});
    equations.AddTo(hessian, gradient);
  }
  // The covariance of the systematic error of the estimate. It changes slowly with the view and is therefore updated
  // once in kWindowsPerSystematic windows: an update takes as long as two steps of Minimise().
  Matrix6d SystematicCovariance(const Matrix12d& prior_information, const WindowInput& input, double sigma_px,
                                const MotionState& state) {
    window_.next_systematic = learned_.systematic;
    if (learned_.until_systematic == 0) {
      window_.next_systematic.Update(prior_information, input.duration_s, state.covariance,
                                     GradientsBySystematic(input, sigma_px), kWindowsPerSystematic);
    }
    return window_.next_systematic.Covariance(systematic_options_, sensor_.uncertainty, state.twist);
  }
  // The normal equations are linear in the distances of the events, so that the change of the gradient is the gradient
  // of lines whose events are displaced and have no other residual.
  SystematicGradients GradientsBySystematic(const WindowInput& input, double sigma_px) {
    const double event_scale = 1.0 / (sigma_px * sigma_px * EventsPerInformation());
    const double displacement_px = DisplacementPx(input.duration_s);
    const auto scale_of = [&](size_t k) { return window_.sums[k].ObservedRatio(sigma_px) * event_scale; };
    const auto gradient_of = [&](auto displacement_of) {
      window_.moved_lines.clear();
      for (const ImageLine& line : window_.lines) {
        window_.moved_lines.push_back(line);
        window_.moved_lines.back().a_expected = displacement_of(line);
        window_.moved_lines.back().a_dot.setZero();
      }
      Vector12d gradient = Vector12d::Zero();
      PacedYields yields(kLinesBetweenYields);
      ForEachArc(input.lines, window_.lines, [&](size_t first, size_t end) {
        AddEquations(input.lines, window_.moved_lines, first, end, displacement_px, scale_of, nullptr, gradient);
        yields.Add(end - first);
      });
      return gradient;
    };
    const auto bias_of = [&](const ImageLine& line) -> Eigen::Vector3d {
      return line.a_expected - (line.a - 1e-6 * sensor_.latency_us * line.a_dot);
    };
    const auto lag_of = [&](const ImageLine& line) -> Eigen::Vector3d {
      if (!line.in_view()) return Eigen::Vector3d::Zero();
      const double speed = line.a_dot.dot(BearingOf(camera_, line.PointAt(0.5)));
      return {0.0, 0.0, -speed / Hypotenuse(speed, kSlowPxPerS)};
    };
    return {gradient_of(bias_of), gradient_of(lag_of)};
  }
  bool HasEvents(size_t k) const { return window_.lines[k].in_view() && window_.sums[k].sums.weight() > 0.0; }
  // Adds the equations of the elements [first, end) of an arc. Their common displacement is marginalised once
  // (core/estimation/README.md, section 7).
  template <typename ScaleOf>
  void AddArc(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines, size_t first, size_t end,
              double displacement_px, const ScaleOf& scale_of, Matrix12d* hessian, Vector12d& gradient) const {
    double arc_px = 0.0, narrow_px = 0.0;
    for (size_t k = first; k < end; ++k) arc_px += lines[k].length_px;
    ArcEquations equations;
    double begin_px = 0.0;
    for (size_t k = first; k < end; ++k) {
      const double length_px = lines[k].length_px;
      const double position = (2.0 * begin_px + length_px) / arc_px - 1.0;
      begin_px += length_px;
      if (!HasEvents(k)) continue;
      equations.Add(camera_, window_.sums[k].sums, lines[k], scale_of(k), position, length_px / arc_px);
      narrow_px = std::max(narrow_px, NarrowFacePx(tracked[k]));
    }
    equations.AddTo(Hypotenuse(displacement_px, narrow_px), hessian, gradient);
  }
  double MovementPx(const Vector12d& dx, double duration_s) const {
    double largest = 0.0;
    for (const ImageLine& line : window_.lines) {
      if (!line.in_view()) continue;
      const Vector6d row = line.jacobian.transpose() * BearingOf(camera_, line.PointAt(0.5));
      largest = std::max(largest, std::abs(row.dot(dx.head<6>())) + 0.5 * duration_s * std::abs(row.dot(dx.tail<6>())));
    }
    return largest;
  }
  // Additional position uncertainty, in pixels, of a line of a face that is seen nearly edge-on: its two edges are
  // closer together than the spread of the events, so that an event cannot be assigned to one of them
  // (core/estimation/README.md, section 6).
  double NarrowFacePx(const TrackedLine& line) const {
    return 0.5 * std::max(0.0, options_.narrow_face_sigma * learned_.sigma_px - line.narrowest_face_px);
  }
  // Expected number of observations in the gates from the background. A line at rest has only these and must not be
  // fitted to them.
  double Background(const WindowInput& input, double gate_px) const {
    double area_px2 = 0.0;
    for (size_t k = 0; k < window_.lines.size(); ++k) {
      YieldPoint(k);
      area_px2 += GateAreaPx2(input.cells, window_.lines, k, gate_px);
    }
    return input.background_per_px2 * area_px2 * input.sampling.observations_per_background_event;
  }

  const MixtureOptions options_;
  const SystematicOptions systematic_options_;
  const SensorProfile sensor_;
  const CameraModel camera_;
  const ExpTable table_;
  MixturePass pass_;
  Learned learned_;
  FittedWindow window_;
};

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
  EVPOSE_RETURN_IF_ERROR(CheckRange("retry_explained_ratio", retry_explained_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("memory_events", memory_events, 1.0, 1e9));
  EVPOSE_RETURN_IF_ERROR(CheckRange("initial_outlier_ratio", initial_outlier_ratio, 1e-6, 0.99));
  EVPOSE_RETURN_IF_ERROR(CheckRange("narrow_face_sigma", narrow_face_sigma, 0.0, 10.0));
  return CheckRange("min_events_per_px2", min_events_per_px2, 0.0, 100.0);
}

std::unique_ptr<WindowEstimator> MakeMixtureEstimator(const EstimatorOptions& options, const CameraModel& camera) {
  return std::make_unique<MixtureEstimator>(options, camera);
}

}  // namespace evpose
