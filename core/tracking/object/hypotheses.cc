// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/hypotheses.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "core/base/yield_point.h"
#include "core/models/continuous_symmetry.h"
#include "core/numerics/sampling.h"

namespace evpose {
namespace {

// Pixels. The widest triangle, for poses that are not refined yet, and the narrowest one: the distances of events are
// rounded to pixels.
constexpr double kWidestPx = 0.5 * PoseTrack::kScoredPx;
constexpr double kNarrowestPx = 1.5;
// Pixels. Fits to the same line differ by this much even without clutter: edges are rounded, contours approximated, and
// sensors displace edges (SensorProfile).
constexpr double kLeastDisplacementPx = 0.5;
// Score of an event in [-0.5, 1]: a triangle about the line with this half-width, and a constant negative value beside
// it, so that the integral across the line, and with it the mean over uniform clutter, is zero. The triangle has the
// spread of most lines. The events of a contour may lie farther from it, where the surface is approximated or the edge
// is soft: up to kWidestPx they count neither way.
double ScoreOf(const PoseTrack::Nearness& event, double half_px) {
  const double distance_px = event.distance_px;
  if (distance_px < half_px) return (1.0 - distance_px / half_px) * event.share;
  if (event.kind != EdgeKind::kContour) return distance_px < 2.0 * half_px ? -0.5 * event.share : 0.0;
  if (distance_px < kWidestPx) return 0.0;
  return distance_px < 2.0 * kWidestPx ? -0.5 * half_px / kWidestPx * event.share : 0.0;
}

// The half-width of the triangle with the standard deviation of the events about the lines of both poses.
double HalfWidthPx(double spread_px, double other_spread_px) {
  constexpr double kOfSpread = 2.449489742783178;  // the square root of 6
  return std::clamp(kOfSpread * std::max(spread_px, other_spread_px), kNarrowestPx, kWidestPx);
}

// Share of the score of an event that counts for the error of the model. Whether a painted line has events does not
// depend on the light; what is left is other print, and scratches. Validated by the phone of `evpose bench real`.
double ErrorShare(const PoseTrack::Nearness& event) { return event.kind == EdgeKind::kPainted ? 0.25 : 1.0; }

}  // namespace

Hypotheses::Entry Hypotheses::EntryAt(const MotionState& state) const {
  Entry entry;
  entry.track = std::make_unique<PoseTrack>(context_, state);
  entry.progress = ComparisonProgress(static_cast<int>(context_.options.windows.intervals_per_usual()));
  return entry;
}

void Hypotheses::Add(const MotionState& start) {
  if (entries_.empty()) clutter_ = ClutterShare();  // it was measured with other poses
  Append(EntryAt(start));
}

const PoseTrack* Hypotheses::AddRival(const MotionState& state, RivalKind kind, RivalPrior prior) {
  if (is_full()) return nullptr;
  Entry entry = EntryAt(state);
  if (kind == RivalKind::kSameEdges) {
    // Copies the statistics of the first hypothesis through its saved state.
    StateWriter writer;
    writer(*entries_.front().track);
    const std::string learned = writer.Take();
    StateReader reader(learned);
    reader(*entry.track);
    entry.track->set_motion(state);
    entry.are_rivals_generated = are_rivals_generated();
  }
  if (kind == RivalKind::kTilted) {
    entry.origin = Origin::kTiltedRival;
    entry.are_rivals_generated = true;
  } else {
    entry.origin = prior == RivalPrior::kUnlikely ? Origin::kUnlikelyRival : Origin::kRival;
  }
  entry.progress.Enter(ComparisonInput::kRival);
  Append(std::move(entry));
  return entries_.back().track.get();
}

bool Hypotheses::Has(const PoseTrack* track) const {
  return std::any_of(entries_.begin(), entries_.end(),
                     [track](const Entry& entry) { return entry.track.get() == track; });
}

bool Hypotheses::HasSettled(const PoseTrack* track) const {
  return std::any_of(entries_.begin(), entries_.end(),
                     [track](const Entry& entry) { return entry.track.get() == track && entry.progress.is_settled(); });
}

bool Hypotheses::HasRival() const {
  return std::any_of(entries_.begin(), entries_.end(), [this](const Entry& entry) {
    return entry.origin != Origin::kSearch && &entry != &entries_.front();
  });
}

bool Hypotheses::IsUndecided() const {
  const double least_sigma = 0.5 * context_.options.initialization.decision_sigma;
  for (size_t i = 1; i < entries_.size(); ++i) {
    const Entry& entry = entries_[i];
    const bool is_unlikely = entry.origin == Origin::kUnlikelyRival || entry.origin == Origin::kTiltedRival;
    if (entry.progress.stage() == ComparisonStage::kUndecided && (!is_unlikely || Preference(i, 0) >= least_sigma))
      return true;
  }
  return false;
}

bool Hypotheses::AreAllDegraded() const {
  return std::all_of(entries_.begin(), entries_.end(),
                     [](const Entry& entry) { return entry.track->state() == TrackState::kDegraded; });
}

void Hypotheses::Join(Hypotheses&& others) {
  const size_t num_present = entries_.size();
  for (Entry& entry : others.entries_) {
    entry.progress.Enter(ComparisonInput::kLaterSearch);
    const RigidTransform& pose = entry.track->motion().camera_from_object;
    const auto is_same = [&](const Entry& present) {
      return LooksLike(present.track->motion().camera_from_object, pose);
    };
    const auto end = entries_.begin() + static_cast<std::ptrdiff_t>(num_present);
    const bool is_known = num_present > 0 && (HasRejected(pose) || std::any_of(entries_.begin(), end, is_same));
    if (!is_known && entries_.size() < MaxEntries()) {
      Append(std::move(entry));
    } else {
      entry.track->Reject(LossCause::kBetterPose, now_us_);
    }
  }
  others.entries_.clear();
}

bool Hypotheses::HasRejected(const RigidTransform& camera_from_object) const {
  const Entry& first = entries_.front();
  const RigidTransform& pose = first.track->motion().camera_from_object;
  return std::any_of(first.rejected.begin(), first.rejected.end(),
                     [&](const RigidTransform& relative) { return LooksLike(pose * relative, camera_from_object); });
}

bool Hypotheses::LooksLike(const RigidTransform& a, const RigidTransform& b) const {
  YieldPoint();
  constexpr size_t kMaxPoints = 64;  // vertices that are compared: enough for the mean of their distances
  const RigidTransform other = NearestEquivalent(b, *context_.model, a);
  const std::vector<Eigen::Vector3d>& vertices = context_.model->vertices;
  const size_t step = vertices.size() / kMaxPoints + 1;
  double sum_px2 = 0.0, count = 0.0;
  for (size_t i = 0; i < vertices.size(); i += step) {
    const Eigen::Vector3d p = a * vertices[i], q = other * vertices[i];
    if (p.z() <= 0.0 || q.z() <= 0.0) continue;
    const Eigen::Vector2d moved = p.head<2>() / p.z() - q.head<2>() / q.z();
    sum_px2 += moved.cwiseProduct(Eigen::Vector2d(context_.camera.fx_px, context_.camera.fy_px)).squaredNorm();
    count += 1.0;
  }
  const double near_px = context_.options.health.near_px;
  return count > 0.0 && sum_px2 < near_px * near_px * count;
}

void Hypotheses::Append(Entry entry) {
  YieldPoint();  // a new track has allocated its tables
  entries_.push_back(std::move(entry));
  entries_.back().comparisons.clear();
  for (Entry& each : entries_) each.comparisons.resize(entries_.size());
}

void Hypotheses::OnWindow(const EventWindow& window, const OtherObjects* others) {
  now_us_ = window.t_end_us;
  for (Entry& entry : entries_) entry.estimate = entry.track->OnWindow(window, others);
  DropLost();
  DropRejected();
  if (entries_.size() < 2) return;
  DropEqual();
  Compare(window, others);
  DropWorse();
  DropUnsupportedRivals();
  for (Entry& entry : entries_) entry.progress.OnWindow();
}

void Hypotheses::OnGap(int64_t gap_us) {
  for (Entry& entry : entries_) entry.track->OnGap(gap_us);
}

void Hypotheses::Compare(const EventWindow& window, const OtherObjects* others) {
  std::vector<WindowEvent>& events = compared_events_;
  DownsampleByClass(
      static_cast<size_t>(context_.options.initialization.max_compared_events), {0.5, 0.5}, window.events,
      [](const WindowEvent& event) { return event.polarity; }, events);
  for (Entry& entry : entries_) entry.events.assign(events.size(), {});
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    const std::optional<Observation> event =
        Observe(context_.camera, context_.tables->undistortion, events[k], window.t_mid_us());
    if (!event) continue;
    for (Entry& entry : entries_) entry.events[k] = entry.track->NearestLine(*event, others);
  }
  const ByPolarity weights = WeighEvents(window.t_mid_us());
  for (size_t i = 0; i < entries_.size(); ++i) {
    for (size_t j = i + 1; j < entries_.size(); ++j) {
      if (entries_[i].progress.is_settled() && entries_[j].progress.is_settled()) CompareScores(i, j, weights);
    }
  }
}

ByPolarity Hypotheses::WeighEvents(int64_t t_us) {
  scores_.clear();
  for (const Entry& entry : entries_) {
    if (!entry.progress.is_settled()) continue;
    const double half_px = HalfWidthPx(entry.track->spread_px(), 0.0);
    ClutterShare::Scores& sums = scores_.emplace_back();
    for (size_t k = 0; k < entry.events.size(); ++k) {
      YieldPoint(k);
      sums.Add(ScoreOf(entry.events[k], half_px), compared_events_[k].polarity);
    }
  }
  return clutter_.Update(scores_, t_us);
}

void Hypotheses::CompareScores(size_t i, size_t j, const ByPolarity& weights) {
  Entry &a = entries_[i], &b = entries_[j];
  const double half_px = HalfWidthPx(a.track->spread_px(), b.track->spread_px());
  // Difference of the distances that a displaced fit can cause (README, section 2).
  const double displacement_px = std::max(kLeastDisplacementPx, clutter_.ratio() * PoseTrack::kScoredPx);
  double sum = 0.0, squares = 0.0, explained = 0.0;
  for (size_t k = 0; k < a.events.size(); ++k) {
    YieldPoint(k);
    const double weight = weights[compared_events_[k].polarity];
    const double score_a = weight * ScoreOf(a.events[k], half_px), score_b = weight * ScoreOf(b.events[k], half_px);
    explained += 0.5 * (ErrorShare(a.events[k]) * score_a + ErrorShare(b.events[k]) * score_b);
    if (std::abs(a.events[k].distance_px - b.events[k].distance_px) < displacement_px) continue;
    sum += score_a - score_b;
    squares += (score_a - score_b) * (score_a - score_b);
  }
  a.comparisons[j].Add(sum, squares, explained);
  b.comparisons[i].Add(-sum, squares, explained);
}

double Hypotheses::Preference(size_t i, size_t j) const {
  return entries_[i].comparisons[j].Sigma(context_.options.health.dispersion,
                                          context_.options.initialization.model_error_ratio);
}

double Hypotheses::LogLikelihoodRatio(size_t i, size_t j) const {
  const double sigma = Preference(i, j);
  return 0.5 * sigma * std::abs(sigma);
}

PoseAlternatives Hypotheses::Alternatives() const {
  PoseAlternatives alternatives;
  for (size_t i = 1; i < entries_.size(); ++i) {
    if (!IsComparedWithFirst(i)) continue;
    alternatives.Add({entries_[i].track->motion().camera_from_object, LogLikelihoodRatio(i, 0)});
  }
  return alternatives;
}

size_t Hypotheses::NumCompared() const {
  size_t count = entries_.empty() ? 0 : 1;
  for (size_t i = 1; i < entries_.size(); ++i) count += IsComparedWithFirst(i) ? 1 : 0;
  return count;
}

bool Hypotheses::IsComparedWithFirst(size_t i) const {
  return entries_.front().progress.has_been_compared() && entries_[i].progress.has_been_compared();
}

void Hypotheses::DropIf(absl::FunctionRef<bool(const PoseTrack&)> is_wrong, LossCause cause) {
  for (size_t i = entries_.size(); i-- > 0;) {
    if (is_wrong(*entries_[i].track)) Remove(i, cause);
  }
}

void Hypotheses::DropLost() {
  for (size_t i = entries_.size(); i-- > 0;) {
    const PoseTrack& track = *entries_[i].track;
    if (track.state() == TrackState::kLost) Remove(i, track.loss_cause());
  }
}

void Hypotheses::DropRejected() {
  // Of two poses with nearly the same image, support of one and contradiction of the other can be due to chance. The
  // factor delays the rejection, so that in most cases the sequential comparison decides before.
  constexpr int kFactorBesideConfirmed = 5;
  const bool has_confirmed = std::any_of(entries_.begin(), entries_.end(), [](const Entry& entry) {
    return entry.track->state() != TrackState::kInitializing;
  });
  const int times = has_confirmed ? kFactorBesideConfirmed : 1;
  DropIf([times](const PoseTrack& track) { return track.is_rejected(times); }, LossCause::kContradicted);
}

bool Hypotheses::AreMerged(const Entry& a, const Entry& b) const {
  const InitializationOptions& options = context_.options.initialization;
  const RigidTransform& kept = a.track->motion().camera_from_object;
  const RigidTransform other = NearestEquivalent(b.track->motion().camera_from_object, *context_.model, kept);
  return RotationAngle(kept.rotation, other.rotation) < options.merge_rad &&
         (kept.translation_m - other.translation_m).norm() < options.merge_depth_ratio * kept.translation_m.norm();
}

void Hypotheses::DropEqual() {
  for (size_t i = 0; i < entries_.size(); ++i) {
    if (!entries_[i].progress.is_settled()) continue;
    for (size_t j = entries_.size(); --j > i;) {
      YieldPoint();
      if (entries_[j].progress.is_settled() && AreMerged(entries_[i], entries_[j])) Remove(j, LossCause::kBetterPose);
    }
  }
}

void Hypotheses::DropWorse() {
  for (size_t i = entries_.size(); i-- > 0;) {
    for (size_t j = 0; j < entries_.size(); ++j) {
      if (j == i || Preference(j, i) < context_.options.initialization.decision_sigma) continue;
      // Entry j is significantly better than a supported pose, so that the contradictions of j were chance.
      if (entries_[i].track->state() != TrackState::kInitializing) entries_[j].track->ClearContradictions();
      std::vector<RigidTransform>& rejected = entries_[j].rejected;
      if (rejected.size() == kMaxRejected) rejected.erase(rejected.begin());
      rejected.push_back(entries_[j].track->motion().camera_from_object.Inverse() *
                         entries_[i].track->motion().camera_from_object);
      Remove(i, LossCause::kBetterPose);
      break;
    }
  }
}

double Hypotheses::Entry::Explained() const {
  double sum = 0.0;
  for (const PoseTrack::Nearness& event : events) sum += ScoreOf(event, kWidestPx);
  return sum;
}

void Hypotheses::DropUnsupportedRivals() {
  // Most generated rivals explain few events. Their complete refinement would take most of the time of all rivals.
  constexpr double kLeastShare = 0.5;
  constexpr double kMinExplained = 20.0;  // with fewer events the shares are chance
  const double first = entries_.front().Explained();
  if (first < kMinExplained) return;
  for (size_t i = entries_.size(); --i > 0;) {
    const Entry& entry = entries_[i];
    if (entry.progress.stage() != ComparisonStage::kRefined) continue;
    const bool has_converged = entry.origin == Origin::kTiltedRival && AreMerged(entries_.front(), entry);
    if (has_converged || entry.Explained() < kLeastShare * first) Remove(i, LossCause::kBetterPose);
  }
}

void Hypotheses::PutBestFirst(double min_sigma) {
  size_t best = 0;
  for (size_t i = 1; i < entries_.size(); ++i) {
    if (Preference(i, best) > 0.0) best = i;
  }
  if (best == 0 || Preference(best, 0) < min_sigma) return;
  std::swap(entries_[0], entries_[best]);
  for (Entry& entry : entries_) std::swap(entry.comparisons[0], entry.comparisons[best]);
}

void Hypotheses::Entry::VisitState(auto& archive, auto& self) {
  auto& [track, estimate, events, comparisons, origin, are_rivals_generated, progress, rejected] = self;
  archive(*track, estimate, AtMost(origin, Origin::kTiltedRival), are_rivals_generated, progress, rejected);
  archive.Check(rejected.size() <= kMaxRejected, "more rejected poses than are kept");
  for (auto& comparison : comparisons) archive(comparison);  // one for each entry
}

void Hypotheses::SaveState(StateWriter& writer) const {
  writer.Count(entries_.size());
  for (const Entry& entry : entries_) writer(entry);
  writer(clutter_);
}

void Hypotheses::LoadState(StateReader& reader) {
  entries_.clear();
  size_t count = 0;
  reader.Count(count);
  // A single pose that was given needs no candidates.
  reader.Check(count <= std::max<size_t>(1, MaxEntries()), "more hypotheses than are followed");
  for (size_t i = 0; i < count && reader.ok(); ++i) Add(MotionState());
  for (Entry& entry : entries_) reader(entry);
  reader(clutter_);
  if (!reader.ok()) entries_.clear();
}

void Hypotheses::Remove(size_t index, LossCause cause) {
  const bool is_first_lost = index == 0 && cause != LossCause::kBetterPose;
  if (index == 0) first_removed_because_ = cause;
  entries_[index].track->Reject(cause, now_us_);
  const auto offset = static_cast<std::ptrdiff_t>(index);
  entries_.erase(entries_.begin() + offset);
  for (Entry& entry : entries_) entry.comparisons.erase(entry.comparisons.begin() + offset);
  if (is_first_lost) RemoveTiltedFrom(0);
}

void Hypotheses::RemoveTiltedFrom(size_t begin) {
  const LossCause first_removed_because = first_removed_because_;
  for (size_t i = entries_.size(); i-- > begin;) {
    if (entries_[i].origin == Origin::kTiltedRival) Remove(i, LossCause::kBetterPose);
  }
  first_removed_because_ = first_removed_because;
}

}  // namespace evpose
