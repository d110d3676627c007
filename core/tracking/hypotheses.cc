// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/hypotheses.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <utility>

#include "core/base/yield_point.h"
#include "core/models/continuous_symmetry.h"
#include "core/numerics/sampling.h"

namespace evpose {

void Hypotheses::Add(const MotionState& start) {
  Entry entry;
  entry.track = std::make_unique<PoseTrack>(context_, start);
  Append(std::move(entry));
}

const PoseTrack* Hypotheses::AddRival(const MotionState& state, RivalKind kind) {
  if (is_full()) return nullptr;
  Entry entry;
  entry.track = std::make_unique<PoseTrack>(context_, state);
  if (kind == RivalKind::kSameEdges) {
    StateWriter writer;
    writer(*entries_.front().track);
    const std::string learned = writer.Take();
    StateReader reader(learned);
    reader(*entry.track);
    entry.track->set_motion(state);
  }
  entry.is_rival = true;
  entry.pending = kSettlingWindows + kComparedWindows;
  Append(std::move(entry));
  return entries_.back().track.get();
}

bool Hypotheses::HasSettled(const PoseTrack* track) const {
  return std::any_of(entries_.begin(), entries_.end(),
                     [track](const Entry& entry) { return entry.track.get() == track && entry.is_settled(); });
}

bool Hypotheses::HasRival() const {
  return std::any_of(entries_.begin(), entries_.end(),
                     [this](const Entry& entry) { return entry.is_rival && &entry != &entries_.front(); });
}

bool Hypotheses::IsUndecided() const {
  return std::any_of(entries_.begin(), entries_.end(),
                     [this](const Entry& entry) { return entry.pending == 0 && &entry != &entries_.front(); });
}

bool Hypotheses::AreAllDegraded() const {
  return std::all_of(entries_.begin(), entries_.end(),
                     [](const Entry& entry) { return entry.track->state() == TrackState::kDegraded; });
}

void Hypotheses::Join(Hypotheses&& others) {
  for (Entry& entry : others.entries_) {
    entry.pending = kComparedWindows;
    if (entries_.size() < MaxEntries()) Append(std::move(entry));
  }
  others.entries_.clear();
}

void Hypotheses::Append(Entry entry) {
  entries_.push_back(std::move(entry));
  entries_.back().difference.clear();
  entries_.back().squares.clear();
  for (Entry& each : entries_) {
    each.difference.resize(entries_.size(), 0.0);
    each.squares.resize(entries_.size(), 0.0);
  }
}

void Hypotheses::OnWindow(const EventWindow& window, const Competitors* others) {
  for (Entry& entry : entries_) entry.estimate = entry.track->OnWindow(window, others);
  DropLost();
  DropRejected();
  if (entries_.size() < 2) return;
  DropEqual();
  Compare(window, others);
  DropWorse();
  DropHopelessRivals();
  for (Entry& entry : entries_) entry.pending = std::max(0, entry.pending - 1);
}

void Hypotheses::OnGap(int64_t gap_us) {
  for (Entry& entry : entries_) entry.track->OnGap(gap_us);
}

void Hypotheses::Compare(const EventWindow& window, const Competitors* others) {
  std::vector<WindowEvent>& events = compared_events_;
  DownsampleByClass(
      static_cast<size_t>(context_.options.initialization.max_compared_events), {0.5, 0.5}, window.events,
      [](const WindowEvent& event) { return event.polarity; }, events);
  for (Entry& entry : entries_) entry.explains.assign(events.size(), 0.0f);
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    const std::optional<Observation> event =
        Observe(context_.camera, context_.tables->undistortion, events[k], window.t_mid_us());
    if (!event) continue;
    for (Entry& entry : entries_) entry.explains[k] = static_cast<float>(entry.track->Explains(*event, others));
  }
  for (Entry& entry : entries_) {
    for (size_t other = 0; other < entries_.size(); ++other) {
      if (!entry.is_settled() || !entries_[other].is_settled()) continue;
      for (size_t k = 0; k < events.size(); ++k) {
        const double difference = entry.explains[k] - entries_[other].explains[k];
        entry.difference[other] += difference;
        entry.squares[other] += difference * difference;
      }
    }
  }
}

double Hypotheses::Preference(size_t i, size_t j) const {
  // Events are correlated between neighbouring pixels and at one pixel: see HealthOptions::dispersion.
  const double variance = entries_[i].squares[j] * context_.options.health.dispersion;
  return variance > 0.0 ? entries_[i].difference[j] / std::sqrt(variance) : 0.0;
}

double Hypotheses::LogLikelihoodRatio(size_t i, size_t j) const {
  const double sigma = Preference(i, j);
  return 0.5 * sigma * std::abs(sigma);
}

PoseAlternatives Hypotheses::Alternatives() const {
  PoseAlternatives alternatives;
  for (size_t i = 1; i < entries_.size(); ++i) {
    alternatives.Add({entries_[i].track->motion().camera_from_object, LogLikelihoodRatio(i, 0)});
  }
  return alternatives;
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
  // When two poses look nearly the same, support of one and contradiction of the other can be chance. The sequential
  // comparison decides within a few windows in most cases, and this factor gives it that time.
  constexpr int kFactorBesideConfirmed = 5;
  const bool has_confirmed = std::any_of(entries_.begin(), entries_.end(), [](const Entry& entry) {
    return entry.track->state() != TrackState::kInitializing;
  });
  const int times = has_confirmed ? kFactorBesideConfirmed : 1;
  DropIf([times](const PoseTrack& track) { return track.is_rejected(times); }, LossCause::kContradicted);
}

void Hypotheses::DropEqual() {
  const InitializationOptions& options = context_.options.initialization;
  for (size_t i = 0; i < entries_.size(); ++i) {
    if (!entries_[i].is_settled()) continue;
    const RigidTransform& kept = entries_[i].track->motion().camera_from_object;
    for (size_t j = entries_.size(); --j > i;) {
      YieldPoint();
      if (!entries_[j].is_settled()) continue;
      const RigidTransform other =
          NearestEquivalent(entries_[j].track->motion().camera_from_object, *context_.model, kept);
      if (RotationAngle(kept.rotation, other.rotation) < options.merge_rad &&
          (kept.translation_m - other.translation_m).norm() < options.merge_depth_ratio * kept.translation_m.norm()) {
        Remove(j, LossCause::kBetterPose);
      }
    }
  }
}

void Hypotheses::DropWorse() {
  for (size_t i = entries_.size(); i-- > 0;) {
    for (size_t j = 0; j < entries_.size(); ++j) {
      if (j == i || Preference(j, i) < context_.options.initialization.decision_sigma) continue;
      // Entry j is significantly better than a supported pose, so that the contradictions of j were chance.
      if (entries_[i].track->state() != TrackState::kInitializing) entries_[j].track->ClearContradictions();
      Remove(i, LossCause::kBetterPose);
      break;
    }
  }
}

double Hypotheses::Entry::Explained() const { return std::accumulate(explains.begin(), explains.end(), 0.0); }

void Hypotheses::DropHopelessRivals() {
  // Most generated poses explain next to nothing; the settling of those would take most of the time of all rivals.
  constexpr double kLeastShare = 0.5;
  constexpr double kMinExplained = 20.0;  // with fewer events the shares are chance
  const double first = entries_.front().Explained();
  if (first < kMinExplained) return;
  for (size_t i = entries_.size(); --i > 0;) {
    const Entry& entry = entries_[i];
    const bool is_early = entry.pending > kSettlingWindows + kComparedWindows - kFirstWindows;
    if (entry.is_rival && !entry.is_settled() && !is_early && entry.Explained() < kLeastShare * first) {
      Remove(i, LossCause::kBetterPose);
    }
  }
}

void Hypotheses::PutBestFirst(double min_sigma) {
  size_t best = 0;
  for (size_t i = 1; i < entries_.size(); ++i) {
    if (Preference(i, best) > 0.0) best = i;
  }
  if (best == 0 || Preference(best, 0) < min_sigma) return;
  std::swap(entries_[0], entries_[best]);
  for (Entry& entry : entries_) {
    std::swap(entry.difference[0], entry.difference[best]);
    std::swap(entry.squares[0], entry.squares[best]);
  }
}

void Hypotheses::Entry::VisitState(auto& archive, auto& self) {
  auto& [track, estimate, explains, difference, squares, is_rival, pending] = self;
  archive(*track, estimate, is_rival, AtMost(pending, kSettlingWindows + kComparedWindows));
  // Both have one element per entry.
  for (auto& value : difference) archive(Finite(value));
  for (auto& value : squares) archive(Finite(value));
}

void Hypotheses::SaveState(StateWriter& writer) const {
  writer.Count(entries_.size());
  for (const Entry& entry : entries_) writer(entry);
}

void Hypotheses::LoadState(StateReader& reader) {
  entries_.clear();
  size_t count = 0;
  reader.Count(count);
  // A single pose that was given needs no candidates.
  reader.Check(count <= std::max<size_t>(1, MaxEntries()), "more hypotheses than are followed");
  for (size_t i = 0; i < count && reader.ok(); ++i) Add(MotionState());
  for (Entry& entry : entries_) reader(entry);
  if (!reader.ok()) entries_.clear();
}

void Hypotheses::Remove(size_t index, LossCause cause) {
  if (index == 0) first_removed_because_ = cause;
  const auto offset = static_cast<std::ptrdiff_t>(index);
  entries_.erase(entries_.begin() + offset);
  for (Entry& entry : entries_) {
    entry.difference.erase(entry.difference.begin() + offset);
    entry.squares.erase(entry.squares.begin() + offset);
  }
}

}  // namespace evpose
