// SPDX-License-Identifier: Apache-2.0

// Poses that the events have to decide between (core/tracking/README.md, section 2).
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "absl/functional/function_ref.h"
#include "core/tracking/pose_track.h"

namespace evpose {

// Follows all of them, and drops those that the events turn down: the lost, the same as another, and the worse of two
// as soon as the difference is significant. Two poses are compared event by event, so that what both explain says
// nothing; the differences are summed from window to window until they decide (a sequential test).
class Hypotheses {
 public:
  explicit Hypotheses(const TrackContext& context) : context_(context) {}

  // Adds one; earlier ones are better when nothing else tells.
  void Add(const MotionState& start);
  // Takes the other's over, as challengers: they are compared with those here from the next window on. At
  // most twice InitializationOptions::max_candidates are kept.
  void Join(Hypotheses&& others);
  void Clear() { entries_.clear(); }

  // `others` as PoseTrack::OnWindow takes them.
  void OnWindow(const EventWindow& window, const Competitors* others = nullptr);
  // As PoseTrack::OnGap.
  void OnGap(int64_t gap_us);
  // Drops those that the predicate says it of.
  void DropIf(absl::FunctionRef<bool(const PoseTrack&)> is_wrong);
  // Puts the one first that the events prefer most, if they prefer it to the present first by `min_sigma` at least.
  void PutBestFirst(double min_sigma);

  bool empty() const { return entries_.empty(); }
  size_t size() const { return entries_.size(); }
  // There must be one.
  const PoseTrack& first() const { return *entries_.front().track; }
  // The first one's, of the last window; nullopt while it is INITIALIZING.
  const std::optional<PoseEstimate>& estimate() const { return entries_.front().estimate; }

  // Between windows. Into one of the same context; after a failure (reader.status()) there are none.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  size_t MaxEntries() const { return 2 * static_cast<size_t>(context_.options.initialization.max_candidates); }
  struct Entry {
    std::unique_ptr<PoseTrack> track;
    std::optional<PoseEstimate> estimate;
    std::vector<float> explains;  // of the window's sampled events
    // Against each other one, in order of `entries_`: sum of differences of `explains`, and of their squares.
    std::vector<double> difference;
    std::vector<double> squares;
    static void VisitState(auto& archive, auto& self);
  };

  void Compare(const EventWindow& window, const Competitors* others);
  // Standard deviations by which the events prefer entry i to entry j.
  double Preference(size_t i, size_t j) const;
  void DropRefused();
  void DropSame();
  void DropWorse();
  void Append(Entry entry);
  void Remove(size_t index);

  const TrackContext& context_;
  std::vector<Entry> entries_;
  std::vector<WindowEvent> compared_events_;
};

}  // namespace evpose
