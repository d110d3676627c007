// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/pose_track.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/estimation/free_motion.h"

namespace evpose {
namespace {

// With a larger event deficit than this share of the expected events, the events near the lines are not the object's.
constexpr double kMaxDeficitRatio = 0.5;
// Share of a window of 1 ms or more in the running means and sums over past windows, which cover about 20 windows: the
// events of a slow object are within the fluctuation of the noise in 1 ms, but exceed it in 20 ms.
constexpr double kSignalForgetPerMs = 0.05;

// Whether a second fit explains the object better than the first: it must explain more events, and gain on most of the
// lines that have events. Another edge that passes by has many events, but on few of the lines.
bool IsBetter(const WindowFit& second, const WindowFit& first, absl::Span<const TrackedLine> tracked,
              absl::Span<const ImageLine> lines) {
  // Events of a line or curve in both fits together: fewer cannot show a difference of kSigma standard deviations.
  constexpr double kMinEvents = 3.0;
  // Standard deviations for one line; the majority of the lines makes the decision significant.
  constexpr double kSigma = 2.0;
  if (second.explained_signal_ratio() <= first.explained_signal_ratio()) return false;
  if (second.deficit_ratio > kMaxDeficitRatio) return false;
  double active_px = 0.0, improved_px = 0.0;
  if (second.line_events.empty()) return true;
  ForEachCurve(tracked, [&](size_t begin, size_t end) {
    double in_second = 0.0, in_first = 0.0, length_px = 0.0;
    for (size_t k = begin; k < end; ++k) {
      in_second += second.line_events[k];
      in_first += first.line_events[k];
      length_px += lines[k].length_px;
    }
    const double both = in_second + in_first;
    if (both < kMinEvents) return;
    active_px += length_px;
    if (in_second - in_first > kSigma * std::sqrt(both)) improved_px += length_px;
  });
  return improved_px >= 0.5 * active_px;
}

}  // namespace

PoseTrack::PoseTrack(const TrackContext& context, const MotionState& start)
    : context_(context),
      visible_edges_(context.camera, *context.edges),
      associator_(context.camera, *context.tables, context.options.windows.intervals_per_usual()),
      estimator_(context.options.MakeEstimator(context.camera)),
      health_(context.options.health, *context.near_probability, context.options.mixture.min_events_per_px2,
              context.edges->num_curves()),
      determination_(context.camera, *context.model, context.sphere, context.options.health),
      activity_(context.edges->num_curves(), context.options.mixture.min_events_per_px2),
      flash_(context.options.flash),
      motion_(start),
      deficit_counts_(static_cast<size_t>(context.edges->num_curves())) {
  RemoveFreeMotion(context.model->continuous_symmetry, motion_);
  for (const int index : context.edges->lines()) {
    const ModelLine& line = context.model->lines[index];
    all_lines_.push_back({context.edges->CurveOf(static_cast<uint32_t>(index)), line.p1, line.p2});
  }
  size_t max_lines = all_lines_.size();
  if (context.edges->elements().has_curves()) max_lines += context.options.elements.max_elements;
  // Both are reserved here because the second one is seldom used, so that it would allocate while tracking.
  for (WindowFit* const fit : {&last_.fit, &last_.second_fit}) {
    fit->line_events.reserve(max_lines);
    fit->deficit_counts.reserve(max_lines);
  }
}

std::optional<PoseEstimate> PoseTrack::OnWindow(const EventWindow& window, const OtherObjects* others) {
  if (others != nullptr && others->empty()) others = nullptr;
  WindowInput input;
  FitWindow(window, others, input);
  const WindowFit& fit = last_.fit;
  last_.lines = input.lines;
  if (last_.occlusion == Occlusion::kAll) return PredictOccluded(window);
  const RigidTransform& pose = fit.state.camera_from_object;
  const bool is_usable = !input.lines.empty() && fit.state.covariance.allFinite() && pose.rotation.allFinite() &&
                         pose.translation_m.allFinite() && fit.state.twist.allFinite();
  if (!is_usable) {
    Enter(TrackInput::kFailure, window.t_end_us);
    return std::nullopt;
  }
  RemoveFreeMotion(context_.model->continuous_symmetry, motion_, last_.fit.state);
  motion_ = fit.state;

  const CameraModel& camera = context_.camera;
  const HealthOptions& health = context_.options.health;
  ProjectLines(camera, motion_, input.lines, last_.image_lines);
  AddCounts(input, fit);
  if (PredictedSpreadPx(camera, motion_, last_.image_lines) > health.max_uncertainty_px) {
    Enter(TrackInput::kFailure, window.t_end_us);
    return std::nullopt;
  }
  if (last_.is_flash) {
    // Events of the change of brightness are no evidence for or against the pose.
    Enter(TrackInput::kFewEvents, window.t_end_us);
    if (!HasEstimate(phase_)) return std::nullopt;
    return MakeEstimate(fit, input);
  }
  // Until a pose is confirmed on most of its lines, the events of both polarities have full weight.
  if (!input.is_mostly_tested) input.sampling.polarity_weight = {1.0, 1.0};
  health_.AddWindow(camera, input, last_.image_lines, fit);
  const bool is_tentative = phase_ == TrackPhase::kTentative;
  const double support = coverage_ == TestCoverage::kMost ? health.keep_support_ratio : health.confirm_support_ratio;
  if (followed_since_us_ < 0) followed_since_us_ = window.t_begin_us;
  const int64_t min_contradiction_us = is_tentative ? health.min_span_us : health.min_contradiction_us;
  const HealthResult result =
      health_.Test({support, is_tentative ? health.confirm_lines : health.keep_lines, min_contradiction_us});
  if (last_.occlusion == Occlusion::kSome && input.lines.size() < static_cast<size_t>(health.confirm_lines)) {
    // Too little is visible for an event deficit or foreign events to contradict the pose.
    Enter(TrackInput::kOcclusion, window.t_end_us);
  } else {
    const bool is_determined = result.kind != HealthResult::Kind::kSupported || IsDetermined(input.lines, support);
    UpdatePhase(result, is_determined, window.t_end_us);
  }
  if (!HasEstimate(phase_)) return std::nullopt;
  return MakeEstimate(fit, input);
}

void PoseTrack::AddCounts(const WindowInput& input, const WindowFit& fit) {
  if (!fit.deficit_counts.empty()) {
    ForEachCurve(input.lines, [&](size_t first, size_t end) {
      DeficitCounts window;
      for (size_t k = first; k < end; ++k) {
        for (int half = 0; half < 2; ++half) {
          window.expected[half] += fit.deficit_counts[k].expected[half];
          window.observed[half] += fit.deficit_counts[k].observed[half];
        }
      }
      deficit_counts_[input.lines[first].curve].Add(window);
    });
  }
  if (phase_ != TrackPhase::kConfirmed || fit.line_events.empty()) return;
  activity_.Add(context_.camera, input, last_.image_lines, fit.line_events);
  // The events of the window count for its own test.
  for (size_t k = 0; k < last_.expectations.size(); ++k) last_.expectations[k] = activity_.Of(input.lines[k]);
}

void PoseTrack::SetPastCounts(WindowInput& input) {
  last_.past_deficit_counts.clear();
  last_.expectations.clear();
  ForEachCurve(input.lines, [&](size_t first, size_t end) {
    // The counts of a curve are divided among its elements as the expected events are, by length.
    double length_px = 0.0;
    for (size_t k = first; k < end; ++k) length_px += last_.image_lines[k].length_px;
    for (size_t k = first; k < end; ++k) {
      DeficitCounts& past = last_.past_deficit_counts.emplace_back(deficit_counts_[input.lines[k].curve]);
      if (!input.lines[k].is_element) continue;
      const double share = length_px > 0.0 ? last_.image_lines[k].length_px / length_px : 0.0;
      for (int half = 0; half < 2; ++half) {
        past.expected[half] *= share;
        past.observed[half] *= share;
      }
    }
  });
  input.past_deficit_counts = last_.past_deficit_counts;
  if (!context_.edges->elements().has_curves()) return;
  for (const TrackedLine& line : input.lines) last_.expectations.push_back(activity_.Of(line));
  input.expectations = last_.expectations;
}

void PoseTrack::OnGap(int64_t gap_us) {
  // supported_at_us_ stays: the knowledge of the pose has aged by the gap.
  unsupported_since_us_ += gap_us;
  if (followed_since_us_ >= 0) followed_since_us_ += gap_us;
}

std::optional<PoseEstimate> PoseTrack::PredictOccluded(const EventWindow& window) {
  motion_ = Predict(motion_, window.t_mid_us(), context_.options.motion);
  RemoveFreeMotion(context_.model->continuous_symmetry, motion_);
  ProjectLines(context_.camera, motion_, visible_edges_.At(motion_.camera_from_object), last_.image_lines);
  const double spread_px = PredictedSpreadPx(context_.camera, motion_, last_.image_lines);
  last_.image_lines.clear();
  associator_.ClearLines();
  const bool is_uncertain = spread_px > context_.options.health.max_uncertainty_px;
  Enter(is_uncertain ? TrackInput::kFailure : TrackInput::kOcclusion, window.t_end_us);
  if (!HasEstimate(phase_)) return std::nullopt;
  WindowFit fit;
  fit.state = motion_;
  return MakeEstimate(fit, WindowInput());
}

PoseTrack::Nearness PoseTrack::NearestLine(Observation observation, const OtherObjects* others) const {
  Nearness nearness;
  if (!associator_.grid().GiveLines(observation)) return nearness;
  const NearLines near = FindNearLines(observation, last_.image_lines.data(), kScoredPx, 0.0);
  if (near.count == 0) return nearness;
  const double distance_px = std::abs(near.distance_px[0]);
  nearness.distance_px = static_cast<float>(distance_px);
  nearness.kind = last_.lines[near.line[0]].kind;
  if (others == nullptr || last_.rates.empty()) return nearness;
  nearness.share = static_cast<float>(OwnShare(distance_px, OthersDensityPerPx(observation, *others, last_.rates)));
  return nearness;
}

void PoseTrack::FitWindow(const EventWindow& window, const OtherObjects* others, WindowInput& input) {
  adaptation_.Limit(1.0);
  MotionState predicted = Predicted(window.t_mid_us(), adaptation_.Adapted(context_.options.motion), 1.0);
  input = Gather(window, others, predicted, 1.0);
  last_.fit.Clear();
  last_.is_flash = false;
  if (input.lines.empty()) return;
  // A window longer than the usual interval has few events (WindowOptions::min_events), so that its estimate depends on
  // the prior.
  const bool is_sparse = window.t_end_us - window.t_begin_us > WindowOptions::kUsualIntervalUs;
  if (is_sparse && LimitMotion(input)) {
    predicted = Predicted(window.t_mid_us(), adaptation_.Adapted(context_.options.motion), 1.0);
  }
  FitAdapted(window, input, predicted);
  const bool is_quiet = IsOnlyBackground(last_.fit) || (last_.fit.deficit_ratio > kMaxDeficitRatio && IsSlow(input));
  last_.is_flash = IsFlash(window, input);
  if (is_quiet || last_.is_flash) {
    FitNoEvents(input, predicted);
    return;
  }
  // Background events carry no information about the pose, neither for the estimator nor for a second fit.
  if (!HasSignal(last_.fit)) return;
  if (last_.fit.explained_signal_ratio() <
      context_.options.mixture.retry_explained_ratio * signal_.usual_explained_ratio) {
    const MotionPriorOptions& motion = context_.options.motion;
    const MotionState agile = Predicted(window.t_mid_us(), motion, motion.retry_noise_factor);
    const WindowInput wide_input = Gather(window, others, agile, context_.options.mixture.retry_gate_factor);
    estimator_->Fit(agile, wide_input, context_.options.mixture.retry_gate_factor, last_.second_fit);
    input = wide_input;
    if (!IsBetter(last_.second_fit, last_.fit, input.lines, last_.image_lines)) return;
    std::swap(last_.fit, last_.second_fit);
    adaptation_.Reset();
  } else if (phase_ != TrackPhase::kTentative && estimator_->UpdatesCovariance()) {
    adaptation_.Add(MotionAdaptation::Compare(predicted, last_.fit.state));
  }
  estimator_->Accept(last_.fit, input);
  if (HasSignal(last_.fit)) {
    signal_.usual_explained_ratio += (signal_.usual_explained_ratio == 0.0 ? 1.0 : PerWindow(kSignalForgetPerMs)) *
                                     (last_.fit.explained_signal_ratio() - signal_.usual_explained_ratio);
  }
}

bool PoseTrack::LimitMotion(const WindowInput& input) {
  // Events per square pixel that an edge of ordinary contrast sweeps; sensors have 1 to 5.
  constexpr double kEventsPerPx2 = 1.0;
  // Standard deviations of an unknown velocity, in image speeds: the speed is that of the mean line across itself.
  constexpr double kSpeeds = 2.0;
  double length_px = 0.0;
  for (const ImageLine& line : last_.image_lines) length_px += line.in_view() ? line.length_px : 0.0;
  const double could_sweep = kEventsPerPx2 * length_px * input.duration_s;
  if (!(could_sweep > 0.0)) return false;
  const double speed_px_per_s = (input.sampling.near_events[0] + input.sampling.near_events[1]) / could_sweep;
  const MotionPriorOptions& motion = context_.options.motion;
  const double focal_px = context_.camera.MaxFocalPx();
  const double radius_m = 0.5 * context_.model->diameter_m;
  const double depth_m = std::max(radius_m, (motion_.camera_from_object * context_.edges->centre()).z());
  const double px_per_m = focal_px / depth_m, px_per_rad = px_per_m * radius_m;
  const double density =
      focal_px * motion.linear_acceleration_density + px_per_rad * motion.angular_acceleration_density;
  const double learned = adaptation_.ratio();
  adaptation_.Limit(speed_px_per_s * speed_px_per_s / (motion.turn_time_s * density * density));
  bool is_limited = adaptation_.ratio() != learned;
  if (followed_since_us_ < 0 && motion_.twist.isZero()) {
    auto twist = motion_.covariance.bottomRightCorner<6, 6>();
    const double prior = px_per_m * px_per_m * twist.topLeftCorner<3, 3>().trace() / 3.0 +
                         px_per_rad * px_per_rad * twist.bottomRightCorner<3, 3>().trace() / 3.0;
    const double ratio = kSpeeds * kSpeeds * speed_px_per_s * speed_px_per_s / prior;
    is_limited = is_limited || ratio < 1.0;
    if (ratio < 1.0) twist *= ratio;
  }
  return is_limited;
}

void PoseTrack::FitAdapted(const EventWindow& window, const WindowInput& input, MotionState& predicted) {
  estimator_->Fit(predicted, input, 1.0, last_.fit);
  if (adaptation_.ratio() == 1.0 || !HasSignal(last_.fit)) return;
  if (!adaptation_.IsSignificant(MotionAdaptation::Compare(predicted, last_.fit.state))) return;
  adaptation_.Reset();
  predicted = Predicted(window.t_mid_us(), context_.options.motion, 1.0);
  estimator_->Fit(predicted, input, 1.0, last_.fit);
}

void PoseTrack::FitNoEvents(const WindowInput& input, const MotionState& predicted) {
  // Noise does not measure the pose, nor do the events of something that passes an object at rest. The event deficit
  // of the lines does measure their motion.
  const LineEvents nothing;
  WindowInput no_events = input;
  no_events.events = {};
  no_events.sorted = &nothing;
  no_events.past_deficit_counts = {};
  no_events.background_per_px2 = 0.0;
  estimator_->Fit(predicted, no_events, 1.0, last_.second_fit);
  last_.fit.state = last_.second_fit.state;
}

bool PoseTrack::IsFlash(const EventWindow& window, const WindowInput& input) {
  flash_.Add(input.sampling.near_events, window.t_begin_us, window.t_end_us);
  if (!flash_.is_changing()) return false;
  ProjectLines(context_.camera, last_.fit.state, input.lines, last_.image_lines);
  const EventConcentration concentration = health_.Concentration(input, last_.image_lines, last_.fit);
  const FlashOptions& options = context_.options.flash;
  return concentration.sigma < options.min_sigma || concentration.ratio < options.min_excess_ratio;
}

bool PoseTrack::IsOnlyBackground(const WindowFit& fit) {
  const double keep = 1.0 - PerWindow(kSignalForgetPerMs);
  const HealthOptions& health = context_.options.health;
  signal_.recent_signal = keep * signal_.recent_signal + fit.num_gated - fit.num_background;
  signal_.recent_background = keep * signal_.recent_background + fit.num_background;
  const double chance = health.significance_sigma * std::sqrt(signal_.recent_background * health.dispersion);
  return signal_.recent_signal < chance && !HasSignal(fit);
}

bool PoseTrack::IsSlow(const WindowInput& input) const {
  double swept_px2 = 0.0;
  for (const ImageLine& line : last_.image_lines) {
    if (!line.in_view()) continue;
    swept_px2 += line.length_px * std::abs(NormalSpeedPxPerS(context_.camera, line, 0.5)) * input.duration_s;
  }
  return context_.options.mixture.min_events_per_px2 * swept_px2 < context_.options.health.min_signal_events;
}

bool PoseTrack::HasSignal(const WindowFit& fit) const {
  const HealthOptions& health = context_.options.health;
  const double chance = health.significance_sigma * std::sqrt(fit.num_background * health.dispersion);
  return fit.num_signal() >= std::max(health.min_signal_events, chance);
}

MotionState PoseTrack::Predicted(int64_t t_us, const MotionPriorOptions& motion, double noise_factor) const {
  MotionState predicted = Predict(motion_, t_us, motion, noise_factor);
  if (!estimator_->UsesPrediction()) {
    predicted.camera_from_object = motion_.camera_from_object;
    predicted.twist.setZero();
  }
  RemoveFreeMotion(context_.model->continuous_symmetry, predicted);
  return predicted;
}

double PoseTrack::OthersDensityPerPx(const Observation& event, const OtherObjects& others,
                                     absl::Span<const double> rates) const {
  const double density = others.DensityAt(event);
  if (density <= 0.0) return 0.0;
  constexpr double kReachPx = MixtureOptions().max_gate_px;  // the widest gate of the first pass
  const NearLines near = FindNearLines(event, last_.image_lines.data(), kReachPx, 0.0);
  // Away from all own lines the event can only belong to the other objects, whatever their rate.
  return near.count == 0 ? density : density / rates[near.line[0]];
}

WindowInput PoseTrack::Gather(const EventWindow& window, const OtherObjects* others, const MotionState& predicted,
                              double gate_factor) {
  WindowInput input;
  input.is_mostly_tested = phase_ != TrackPhase::kTentative && coverage_ == TestCoverage::kMost;
  input.lines = estimator_->UsesVisibility() ? visible_edges_.At(predicted.camera_from_object) : all_lines_;
  last_.occlusion = Occlusion::kNone;
  if (others != nullptr && estimator_->UsesVisibility() && !input.lines.empty()) {
    last_.unoccluded_lines.assign(input.lines.begin(), input.lines.end());
    if (others->RemoveHidden(predicted.camera_from_object, last_.unoccluded_lines)) last_.occlusion = Occlusion::kSome;
    if (last_.unoccluded_lines.empty()) last_.occlusion = Occlusion::kAll;
    input.lines = last_.unoccluded_lines;
  }
  ProjectLines(context_.camera, predicted, input.lines, last_.image_lines);
  const double spread_px = PredictedSpreadPx(context_.camera, predicted, last_.image_lines);
  const double reach_px =
      std::max(estimator_->ReachPx(spread_px, gate_factor), TrackHealth::ReachPx(context_.options.health));
  last_.rates.clear();
  if (others != nullptr) {
    for (const ImageLine& line : last_.image_lines) {
      last_.rates.push_back(RelativeEventRate(context_.camera, predicted, line));
    }
  }
  const auto others_per_px = [&](const Observation& event) {
    return others == nullptr ? 0.0f : static_cast<float>(OthersDensityPerPx(event, *others, last_.rates));
  };
  static_cast<AssociatedEvents&>(input) = associator_.Associate(window, last_.image_lines, predicted.t_us, reach_px,
                                                                estimator_->MaxEvents(), others_per_px);
  input.image_lines = last_.image_lines;
  SetPastCounts(input);
  return input;
}

bool PoseTrack::IsDetermined(absl::Span<const TrackedLine> lines, double support_ratio) {
  determination_.Sum(motion_.camera_from_object, lines, last_.image_lines, health_.curve_results());
  const bool was_determined = coverage_ == TestCoverage::kMost && phase_ == TrackPhase::kConfirmed;
  return was_determined ? determination_.IsKept() : determination_.IsConfirmed(support_ratio);
}

void PoseTrack::UpdatePhase(const HealthResult& result, bool is_determined, int64_t t_us) {
  // An object at rest produces no events: events near the smaller part of its lines come from something that passes.
  constexpr double kMostLines = 0.5;
  const HealthOptions& health = context_.options.health;
  const bool is_tentative = phase_ == TrackPhase::kTentative;
  const bool is_most_testable = result.testable_ratio >= health.min_tested_ratio;
  const bool is_foreign_edge =
      result.kind == HealthResult::Kind::kUnsupported && !is_tentative && result.present_ratio < kMostLines;
  switch (is_foreign_edge ? HealthResult::Kind::kFewEvents : result.kind) {
    case HealthResult::Kind::kOpen:
      return;
    case HealthResult::Kind::kSupported: {
      const bool is_most_tested = coverage_ == TestCoverage::kMost || is_most_testable;
      // The first confirmation waits until most lines could be tested: a part of an object can equal another object.
      if (is_tentative && !is_most_tested && t_us - followed_since_us_ < health.max_hold_us) return;
      const TrackInput input = is_determined ? TrackInput::kSupport : TrackInput::kPartialSupport;
      coverage_ = NextCoverage(coverage_, input, is_most_testable);
      Enter(input, t_us);
      return;
    }
    case HealthResult::Kind::kDoubtful:
      // The pose is right and partly occluded, or attracted by the occluder. It is kept, and other poses may compete.
      Enter(TrackInput::kPartialSupport, t_us);
      return;
    case HealthResult::Kind::kFewEvents:
      // A doubtful pose stays doubtful.
      Enter(TrackInput::kFewEvents, t_us);
      break;
    case HealthResult::Kind::kUnsupported:
      if (is_tentative) ++num_contradictions_;
      Enter(TrackInput::kContradiction, t_us);
      break;
  }
  if (phase_ == TrackPhase::kUnsupported && t_us - unsupported_since_us_ >= health.lost_after_us) {
    Enter(TrackInput::kTimeout, t_us);
  }
}

void PoseTrack::Enter(TrackInput input, int64_t t_us) {
  const TrackPhase next = NextPhase(phase_, input);
  if (next == TrackPhase::kConfirmed || phase_ == TrackPhase::kTentative) supported_at_us_ = t_us;
  if (next == TrackPhase::kUnsupported && phase_ != TrackPhase::kUnsupported) unsupported_since_us_ = t_us;
  if (next == TrackPhase::kLost && phase_ != TrackPhase::kLost) loss_cause_ = CauseOf(input);
  context_.phase_reporter->Report(phase_, next, t_us);
  phase_ = next;
}

void PoseTrack::Reject(LossCause cause, int64_t t_us) {
  if (phase_ == TrackPhase::kLost) return;
  Enter(TrackInput::kRejection, t_us);
  loss_cause_ = cause;
}

LossCause PoseTrack::CauseOf(TrackInput input) const {
  if (input == TrackInput::kTimeout) return LossCause::kContradicted;
  const bool is_in_view =
      last_.occlusion == Occlusion::kAll || std::any_of(last_.image_lines.begin(), last_.image_lines.end(),
                                                        [](const ImageLine& line) { return line.in_view(); });
  return is_in_view ? LossCause::kUncertain : LossCause::kOutOfView;
}

// While the events do not support the pose, the covariance of the fit is that of a wrong association: it is small and
// no measure of the error (core/tracking/README.md, section 1). The published covariance is then that of the state
// predicted over the time since the last support.
Matrix6d PoseTrack::PublishedCovariance(const WindowFit& fit) const {
  const MotionState& state = fit.state;
  const bool is_unsupported = phase_ == TrackPhase::kUnsupported;
  if (!is_unsupported && phase_ != TrackPhase::kDoubtful) {
    return state.covariance.topLeftCorner<6, 6>() + fit.systematic_covariance;
  }
  const int64_t since_us = std::max<int64_t>(0, state.t_us - supported_at_us_);
  const MotionPriorOptions& motion = context_.options.motion;
  const MotionState grown =
      Predict(state, state.t_us + since_us, motion, is_unsupported ? motion.retry_noise_factor : 1.0);
  return grown.covariance.topLeftCorner<6, 6>() + fit.systematic_covariance;
}

void PoseTrack::VisitState(auto& archive, auto& self) {
  auto& [context, visible_edges, all_lines, associator, estimator, health, determination, activity, flash, adaptation,
         phase, motion, signal, deficit_counts, num_contradictions, followed_since_us, coverage, supported_at_us,
         unsupported_since_us, loss_cause, last] = self;
  constexpr int64_t kMaxUs = kMaxStateTimeUs;
  constexpr int kMaxContradictions = 1 << 20;  // more than any track collects before it is rejected
  archive(visible_edges, associator.background(), *estimator, health, AtMost(phase, TrackPhase::kLost), motion, signal,
          AtMost(num_contradictions, kMaxContradictions), InRange(followed_since_us, -kMaxUs, kMaxUs),
          AtMost(coverage, TestCoverage::kMost), InRange(supported_at_us, -kMaxUs, kMaxUs),
          InRange(unsupported_since_us, -kMaxUs, kMaxUs));
  archive(associator.near_events());
  for (auto& counts : deficit_counts) archive(counts);
  archive(activity, flash, adaptation);
}

void PoseTrack::SaveState(StateWriter& writer) const { VisitState(writer, *this); }

void PoseTrack::LoadState(StateReader& reader) { VisitState(reader, *this); }

PoseEstimate PoseTrack::MakeEstimate(const WindowFit& fit, const WindowInput& input) const {
  PoseEstimate estimate;
  estimate.t_us = fit.state.t_us;
  estimate.camera_from_object = fit.state.camera_from_object;
  estimate.covariance =
      WithFreeAngle(context_.model->continuous_symmetry, fit.state.camera_from_object, PublishedCovariance(fit));
  estimate.twist = fit.state.twist;
  estimate.state = ReportedState(phase_);
  estimate.num_events = static_cast<uint32_t>(std::lround(fit.num_gated * input.sampling.mean_events_per_observation));
  estimate.explained_ratio = static_cast<float>(fit.explained_ratio());
  estimate.residual_rms_px = static_cast<float>(fit.residual_rms_px);
  return estimate;
}

}  // namespace evpose
