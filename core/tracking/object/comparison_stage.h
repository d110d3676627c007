// SPDX-License-Identifier: Apache-2.0

// How far the comparison of a hypothesis with the other ones has proceeded (core/tracking/README.md, section 3).
#pragma once

#include "core/base/state_io.h"

namespace evpose {

enum class ComparisonStage {
  kStarted,    // a rival in its first windows: its lines may still have to reach its events
  kRefined,    // a rival that is removed if it explains too few events, but that is neither compared nor merged yet
  kCompared,   // it is compared and merged with the others
  kUndecided,  // the same, but the comparison has lasted so long that the hypothesis competes with the first one
};
inline constexpr int kNumComparisonStages = 4;  // number of enumerators; likewise below

// Events that may change the stage of a hypothesis.
enum class ComparisonInput {
  kRival,        // it is a rival of the first hypothesis (rivals.h)
  kLaterSearch,  // it was found by a search beside the present hypotheses
  kLastWindow,   // it was followed for as many windows as its stage has
};
inline constexpr int kNumComparisonInputs = 3;

// Returns the stage after `input`, by the table of the README; `stage` itself if nothing changes.
ComparisonStage NextStage(ComparisonStage stage, ComparisonInput input);

// The stage of one hypothesis, and the windows that are left in it. Those of the search that found the first one start
// undecided, because none of them takes precedence.
class ComparisonProgress {
 public:
  // `windows_factor`: of the numbers of windows below, for windows that are shorter than 1 ms
  // (WindowOptions::intervals_per_usual()).
  explicit ComparisonProgress(int windows_factor = 1) : windows_factor_(windows_factor) {}

  // Windows of kStarted. In these windows a rival that explains less than half of what the first hypothesis explains is
  // not removed: the refinement of a right rival may still have to bring its lines to the events. Not validated
  // separately.
  static constexpr int kStartedWindows = 3;
  // Windows of kStarted and kRefined, about 10 ms: a first pose with errors of 2 px converges in them. Validated by
  // hypotheses_test: an equal rival is not merged within 4 ms, but within 30 ms.
  static constexpr int kSettlingWindows = 8;
  // Windows of kCompared. One window suffices to reject most wrong poses. Validated by half_turns_test: a rival that
  // cannot be rejected counts as undecided within 40 ms.
  static constexpr int kComparedWindows = 8;

  ComparisonStage stage() const { return stage_; }
  // Whether the refinement has ended, so that the hypothesis takes part in the comparisons.
  bool is_settled() const { return stage_ == ComparisonStage::kCompared || stage_ == ComparisonStage::kUndecided; }

  // Whether it also took part in the comparison of the last window.
  bool has_been_compared() const { return is_settled() && windows_left_ < windows_factor_ * kComparedWindows; }

  // Applies the transition function. No other function changes the stage.
  void Enter(ComparisonInput input);
  // To be called at the end of each window with several hypotheses.
  void OnWindow();

  // Saved as the number of windows until kUndecided.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  int windows_factor_;
  ComparisonStage stage_ = ComparisonStage::kUndecided;
  int windows_left_ = 0;  // in the stage; 0 in kUndecided, which has no end
};

}  // namespace evpose
