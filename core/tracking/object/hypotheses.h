// SPDX-License-Identifier: Apache-2.0

// Competing hypotheses about the pose of one object (core/tracking/README.md, section 2).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "absl/functional/function_ref.h"
#include "core/events/event.h"
#include "core/tracking/evidence/clutter_share.h"
#include "core/tracking/evidence/score_comparison.h"
#include "core/tracking/object/comparison_stage.h"
#include "core/tracking/object/pose_track.h"
#include "core/tracking/object/rivals.h"

namespace evpose {

// Tracks all hypotheses and removes those that are lost, that have converged to another one, or that are significantly
// less likely than another one. Two poses are compared event by event, so that events that both explain do not count;
// the differences are summed from window to window until they are significant (a sequential test).
class Hypotheses {
 public:
  explicit Hypotheses(const TrackContext& context) : context_(context) {}

  // Adds a hypothesis that starts at `start`. Among equally supported hypotheses the earlier one takes precedence.
  void Add(const MotionState& start);
  // Adds a rival of the first hypothesis (rivals.h), unless as many hypotheses are followed as Join() keeps. In its
  // first windows its pose is refined: it is neither compared with the others nor merged with them. A rival that
  // explains less than half of what the first hypothesis explains after three windows is removed. Returns the rival, or
  // null if there is no room. Requires !empty().
  // kSameEdges: both see the same edges, and the rival starts with all that the first hypothesis has learned about
  // them. kTilted: the rival is near the first hypothesis and has the same generated rivals; it is unlikely, and
  // removed once it has converged to the first hypothesis.
  enum class RivalKind { kSameEdges, kOtherEdges, kTilted };
  const PoseTrack* AddRival(const MotionState& state, RivalKind kind, RivalPrior prior = RivalPrior::kEqual);
  // Whether the hypothesis is still followed.
  bool Has(const PoseTrack* track) const;
  // Whether it is still followed and its refinement has ended, so that it takes part in the comparisons.
  bool HasSettled(const PoseTrack* track) const;
  // Moves the hypotheses of `others` here; they are compared with the present ones from the next window on. At most
  // twice InitializationOptions::max_candidates are kept, the earliest ones. Poses that are followed already, or that
  // the first hypothesis was preferred to, are left out: a new comparison would start without the earlier evidence.
  void Join(Hypotheses&& others);
  void Clear() { entries_.clear(); }

  // `others`: see PoseTrack::OnWindow.
  void OnWindow(const EventWindow& window, const OtherObjects* others = nullptr);
  // See PoseTrack::OnGap.
  void OnGap(int64_t gap_us);
  // Removes the hypotheses for which `is_wrong` is true, for that reason.
  void DropIf(absl::FunctionRef<bool(const PoseTrack&)> is_wrong, LossCause cause);
  // Removes the tilted rivals of the first hypothesis, as after its loss: they are tests of it. Requires !empty().
  void RemoveTilted() { RemoveTiltedFrom(1); }
  // Moves the best hypothesis to the front if the events prefer it to the first one by at least `min_sigma` standard
  // deviations.
  void PutBestFirst(double min_sigma);

  // Whether a pose that looks like this one was rejected because the events prefer the first hypothesis. Requires
  // !empty().
  bool HasRejected(const RigidTransform& camera_from_object) const;
  // Records that the generated rivals of the first hypothesis are not to be added again.
  void MarkRivalsGenerated() { entries_.front().are_rivals_generated = true; }
  // True after that call. A rival with the same edges inherits the value, because it has the same rivals.
  bool are_rivals_generated() const { return entries_.front().are_rivals_generated; }
  // Whether the first hypothesis has rivals that AddRival() has added.
  bool HasRival() const;
  // Whether the first hypothesis was added by AddRival(), and as a tilted rival. Requires !empty().
  bool is_first_rival() const { return entries_.front().origin != Origin::kSearch; }
  bool is_first_tilted() const { return entries_.front().origin == Origin::kTiltedRival; }
  // Whether another hypothesis was compared with the first one in several windows, and the test has rejected neither.
  // RivalPrior::kUnlikely is taken into account.
  bool IsUndecided() const;

  // Whether all have been supported in part, and none as a whole.
  bool AreAllDegraded() const;

  bool empty() const { return entries_.empty(); }
  size_t size() const { return entries_.size(); }
  bool is_full() const { return entries_.size() >= MaxEntries(); }
  // Requires !empty().
  const PoseTrack& first() const { return *entries_.front().track; }
  // Estimate of the first hypothesis for the last window; nullopt while it is tentative. Requires !empty().
  const std::optional<PoseEstimate>& estimate() const { return entries_.front().estimate; }
  // The hypotheses that were compared with the first one in the last window, with their likelihoods relative to it
  // (README, equation (4)). Rivals whose refinement has not ended are left out: nothing is known of their likelihood.
  PoseAlternatives Alternatives() const;
  // The first hypothesis and those that were compared with it in the last window; 0 if there are no hypotheses.
  size_t NumCompared() const;
  // Why the hypothesis that was the first one was removed; to be read after the call that removed it.
  LossCause first_removed_because() const { return first_removed_because_; }

  // To be called between windows. LoadState() requires the same context; after a failure (reader.status()) there are no
  // hypotheses.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  static constexpr size_t kMaxRejected = 16;  // bounds the memory; the oldest is removed first

  // The origin of a hypothesis: a search or a given pose, or AddRival() with its kind or prior. It does not change.
  enum class Origin { kSearch, kRival, kUnlikelyRival, kTiltedRival };

  size_t MaxEntries() const { return 2 * static_cast<size_t>(context_.options.initialization.max_candidates); }
  struct Entry {
    std::unique_ptr<PoseTrack> track;
    std::optional<PoseEstimate> estimate;
    std::vector<PoseTrack::Nearness> events;   // the compared ones of the window
    std::vector<ScoreComparison> comparisons;  // with each other entry, in the order of `entries_`
    Origin origin = Origin::kSearch;
    bool are_rivals_generated = false;  // MarkRivalsGenerated()
    ComparisonProgress progress;
    // Poses that this one was preferred to, relative to it, object_from_object; at most kMaxRejected.
    std::vector<RigidTransform> rejected;
    double Explained() const;  // sum of the scores
    static void VisitState(auto& archive, auto& self);
  };

  Entry EntryAt(const MotionState& state) const;
  void Compare(const EventWindow& window, const OtherObjects* others);
  // Returns the weights of the compared events of a window (README, section 2), and updates clutter_.
  ByPolarity WeighEvents(int64_t t_us);
  // Adds the differences of the scores of the compared events to the comparisons of both.
  void CompareScores(size_t i, size_t j, const ByPolarity& weights);
  // Whether entry i and the first one were compared in the last window.
  bool IsComparedWithFirst(size_t i) const;
  // Standard deviations by which entry i is better supported than entry j.
  double Preference(size_t i, size_t j) const;
  // Natural logarithm of the likelihood of entry i divided by that of entry j.
  double LogLikelihoodRatio(size_t i, size_t j) const;
  // Whether both poses have the same image up to the width of a line's events. Of the poses that are equal to `b` by
  // the symmetry of the object, the one nearest to `a` is compared.
  bool LooksLike(const RigidTransform& a, const RigidTransform& b) const;
  // Whether the poses, the nearer one of those that are equal by symmetry, are so near that one of them is removed.
  bool AreMerged(const Entry& a, const Entry& b) const;
  void DropLost();
  void DropRejected();
  void DropEqual();
  void DropWorse();
  void DropUnsupportedRivals();
  void Append(Entry entry);
  void Remove(size_t index, LossCause cause);
  void RemoveTiltedFrom(size_t begin);

  const TrackContext& context_;
  std::vector<Entry> entries_;
  std::vector<WindowEvent> compared_events_;
  std::vector<ClutterShare::Scores> scores_;  // of the settled hypotheses in the window
  ClutterShare clutter_;
  LossCause first_removed_because_ = LossCause::kNone;
  int64_t now_us_ = 0;  // end of the latest window; not saved, because it is the time of reported transitions alone
};

}  // namespace evpose
