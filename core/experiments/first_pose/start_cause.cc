// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/start_cause.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>

#include "core/base/status_macros.h"
#include "core/initialization/templates/edge_samples.h"
#include "core/initialization/templates/template_search.h"
#include "core/models/continuous_symmetry.h"

namespace evpose {
namespace {

using Eigen::Vector2d;

// Errors up to which the alignment of a search finds the true pose: 6 degrees and 3 % of the depth, as for
// SearchTrial::rank.
constexpr double kCaptureRad = 6.0 * 0.017453292519943295;
constexpr double kCaptureRatio = 0.03;
// Microseconds after a start at which searches are made: those of a tracker are 5 to 32 ms apart.
constexpr std::array<int64_t, 8> kSearchTimesUs = {5'000, 10'000, 20'000, 40'000, 80'000, 140'000, 220'000, 300'000};

// Distances from the visible edges at a pose, for the pixels near them.
class EdgeImage {
 public:
  explicit EdgeImage(const CameraModel& camera)
      : camera_(camera), squared_(static_cast<size_t>(camera.width_px) * camera.height_px, kFar) {}

  // Replaces the edges by `samples` at a pose.
  void Set(const RigidTransform& pose, const std::vector<EdgeSample>& samples) {
    for (const size_t place : touched_) squared_[place] = kFar;
    touched_.clear();
    for (const EdgeSample& sample : samples) {
      const Eigen::Vector3d p1 = pose * (sample.point - sample.along), p2 = pose * (sample.point + sample.along);
      if (!(p1.z() > 0.0 && p2.z() > 0.0)) continue;
      const Vector2d begin = camera_.Project(p1), end = camera_.Project(p2);
      const double steps = std::clamp(std::ceil((end - begin).norm()), 1.0, 100.0);
      for (double step = 0.0; step < steps; ++step) Mark(begin + (step + 0.5) / steps * (end - begin));
    }
  }
  // Hypotheses' score of an event: a triangle about the edge, and less than zero beside it.
  double ScoreAt(const PixelEvent& event) const {
    const int x = static_cast<int>(std::lround(event.u_px)), y = static_cast<int>(std::lround(event.v_px));
    if (x < 0 || y < 0 || x >= camera_.width_px || y >= camera_.height_px) return 0.0;
    const double distance_px = std::sqrt(static_cast<double>(squared_[static_cast<size_t>(y) * camera_.width_px + x]));
    if (distance_px < kHalfPx) return 1.0 - distance_px / kHalfPx;
    return distance_px < 2.0 * kHalfPx ? -0.5 : 0.0;
  }

 private:
  // Half-width of the triangle, between those of hypotheses.cc; events farther than twice as much score 0.
  static constexpr double kHalfPx = 2.0;
  static constexpr int kReachPx = 4;
  static constexpr float kFar = 1e6f;  // square pixels: more than any distance that is marked

  void Mark(const Vector2d& at) {
    const int x = static_cast<int>(std::lround(at.x())), y = static_cast<int>(std::lround(at.y()));
    for (int v = std::max(0, y - kReachPx); v <= std::min(camera_.height_px - 1, y + kReachPx); ++v) {
      for (int u = std::max(0, x - kReachPx); u <= std::min(camera_.width_px - 1, x + kReachPx); ++u) {
        float& squared = squared_[static_cast<size_t>(v) * camera_.width_px + u];
        if (squared == kFar) touched_.push_back(static_cast<size_t>(v) * camera_.width_px + u);
        squared = std::min(squared, static_cast<float>((Vector2d(u, v) - at).squaredNorm()));
      }
    }
  }

  const CameraModel camera_;
  std::vector<float> squared_;
  std::vector<size_t> touched_;
};

std::optional<int64_t> TimeOfGivenPose(const FirstPoseRun& run, Tracker& tracker, int64_t start_us, int64_t end_us) {
  constexpr int64_t kStepUs = 1000;  // microseconds of events per call
  for (int64_t t_us = start_us; t_us < end_us; t_us += kStepUs) {
    std::vector<PoseEstimate> estimates;
    tracker.AddEvents(run.Between(t_us, t_us + kStepUs), estimates);
    for (const PoseEstimate& estimate : estimates) {
      const std::optional<PoseError> error = run.ErrorAt(estimate.t_us, estimate.camera_from_object);
      if (error && estimate.state == TrackState::kTracking && error->is_right()) return t_us + kStepUs - start_us;
    }
  }
  return std::nullopt;
}

// The true pose at t_us, with its twist.
std::optional<PoseProposal> TrueProposal(const FirstPoseRun& run, int64_t t_us) {
  constexpr int64_t kStepUs = 1000;  // microseconds: the step of the difference quotient of the twist
  const absl::StatusOr<RigidTransform> pose = Interpolate(run.inputs.truth, t_us);
  const absl::StatusOr<RigidTransform> before = Interpolate(run.inputs.truth, t_us - kStepUs);
  if (!pose.ok() || !before.ok()) return std::nullopt;
  PoseProposal proposal;
  proposal.t_us = t_us;
  proposal.camera_from_object = *pose;
  const double duration_s = 1e-6 * static_cast<double>(kStepUs);
  proposal.twist << (pose->translation_m - before->translation_m) / duration_s,
      LogSo3(pose->rotation * before->rotation.transpose()) / duration_s;
  return proposal;
}

}  // namespace

std::string_view StartCauseName(StartCause cause) {
  static constexpr std::array<std::string_view, kNumStartCauses> kNames = {
      "found",      "not moved",    "turn not shown", "not supported",
      "not ranked", "not proposed", "undecided",      "not confirmed"};
  return kNames[static_cast<size_t>(cause)];
}

std::vector<double> TurnEvidence(const FirstPoseRun& run, const TrackerOptions& options, int64_t begin_us,
                                 int64_t end_us) {
  constexpr int64_t kSliceUs = 3000;   // in which edges move by less than 2 px
  constexpr int64_t kViewUs = 30'000;  // between extractions of the visible edges: turns of one or two degrees
  // Points on the visible edges, around which pixels are marked. With fewer, parts of a long outline stay unmarked.
  constexpr int kSamples = 400;
  const std::optional<ContinuousSymmetry>& axis = run.template_model->near_axis();
  if (!axis) return {};
  const auto num_turns = static_cast<size_t>(run.template_model->num_spins());
  const CameraModel& camera = run.inputs.simulation.camera;
  EdgeImage image(camera);
  std::vector<std::vector<EdgeSample>> samples(num_turns);
  std::vector<double> right, differences(num_turns, 0.0), squares(num_turns, 0.0);
  for (int64_t t_us = begin_us; t_us < end_us; t_us += kSliceUs) {
    const absl::StatusOr<RigidTransform> pose = Interpolate(run.inputs.truth, t_us + kSliceUs / 2);
    if (!pose.ok()) break;
    const std::vector<PixelEvent> events = StoredEvents(run, options, t_us, t_us + kSliceUs);
    right.assign(events.size(), 0.0);
    for (size_t i = 0; i < num_turns; ++i) {
      const double turn_rad = 2.0 * std::numbers::pi / kTemplateTurns * static_cast<double>(i);
      const RigidTransform turned = *pose * AboutCentre(*axis, ExpSo3(turn_rad * axis->axis));
      if ((t_us - begin_us) % kViewUs < kSliceUs) {
        SampleVisibleEdges(run.template_model->edges(), camera, turned, kSamples, samples[i]);
      }
      image.Set(turned, samples[i]);
      for (size_t k = 0; k < events.size(); ++k) {
        const double score = image.ScoreAt(events[k]);
        if (i == 0) right[k] = score;
        differences[i] += right[k] - score;
        squares[i] += (right[k] - score) * (right[k] - score);
      }
    }
  }
  std::vector<double> sigmas;
  for (size_t i = 1; i < num_turns; ++i) {
    const double variance = options.health.dispersion * squares[i];
    sigmas.push_back(variance > 0.0 ? differences[i] / std::sqrt(variance) : 0.0);
  }
  return sigmas;
}

int RankOfRight(const FirstPoseRun& run, const TemplateMatches& found) {
  for (size_t i = 0; i < found.matches.size(); ++i) {
    const std::optional<PoseError> error = run.ErrorAt(found.t_us, found.matches[i].camera_from_object);
    if (error && error->rotation_rad <= kCaptureRad && error->translation_ratio <= kCaptureRatio) {
      return static_cast<int>(i);
    }
  }
  return -1;
}

absl::StatusOr<StartExplanation> ExplainStart(const FirstPoseRun& run, const TrackerOptions& options, int64_t start_us,
                                              int64_t end_us, bool moved, const ReportedStates& states) {
  StartExplanation result;
  const absl::StatusOr<RigidTransform> truth = Interpolate(run.inputs.truth, start_us);
  if (!moved || !truth.ok()) {
    result.cause = StartCause::kNotMoved;
    return result;
  }
  result.turn_sigmas = TurnEvidence(run, options, start_us, end_us);
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker, run.MakeTracker(options, *truth));
  result.given_right_us = TimeOfGivenPose(run, *tracker, start_us, end_us).value_or(-1);
  TemplateSearch search(run.template_model, run.inputs.simulation.camera);
  for (const int64_t after_us : kSearchTimesUs) {
    if (start_us + after_us > end_us) break;
    const std::vector<PixelEvent> events = StoredEvents(run, options, start_us, start_us + after_us);
    const TemplateMatches found = search.Find(events);
    if (!found.has_moved) continue;
    result.ranks.push_back(RankOfRight(run, found));
    std::vector<PoseProposal> proposals;
    if (const auto proposal = TrueProposal(run, found.t_us)) proposals.push_back(*proposal);
    result.proposed_ranks.push_back(RankOfRight(run, search.Find(events, proposals)));
  }
  const auto is_returned = [](const std::vector<int>& ranks) {
    return std::any_of(ranks.begin(), ranks.end(), [](int rank) { return rank >= 0; });
  };
  const auto is_not_told = [&](double sigma) { return sigma < options.initialization.decision_sigma; };
  if (std::any_of(result.turn_sigmas.begin(), result.turn_sigmas.end(), is_not_told)) {
    result.cause = StartCause::kTurnNotShown;
  } else if (result.given_right_us < 0) {
    result.cause = StartCause::kNotSupported;
  } else if (!is_returned(result.proposed_ranks)) {
    result.cause = StartCause::kNotRanked;
  } else if (!is_returned(result.ranks)) {
    result.cause = StartCause::kNotProposed;
  } else {
    result.cause = states.ambiguous > states.degraded ? StartCause::kUndecided : StartCause::kNotConfirmed;
  }
  return result;
}

}  // namespace evpose
