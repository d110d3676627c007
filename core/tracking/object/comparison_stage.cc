// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/comparison_stage.h"

namespace evpose {
namespace {

// The number of windows of a stage; 0 for kUndecided, which has no end.
int WindowsOf(ComparisonStage stage) {
  switch (stage) {
    case ComparisonStage::kStarted:
      return ComparisonProgress::kStartedWindows;
    case ComparisonStage::kRefined:
      return ComparisonProgress::kSettlingWindows - ComparisonProgress::kStartedWindows;
    case ComparisonStage::kCompared:
      return ComparisonProgress::kComparedWindows;
    case ComparisonStage::kUndecided:
      break;
  }
  return 0;
}

}  // namespace

ComparisonStage NextStage(ComparisonStage stage, ComparisonInput input) {
  switch (input) {
    case ComparisonInput::kRival:
      return ComparisonStage::kStarted;
    case ComparisonInput::kLaterSearch:
      return ComparisonStage::kCompared;
    case ComparisonInput::kLastWindow:
      break;
  }
  if (stage == ComparisonStage::kStarted) return ComparisonStage::kRefined;
  return stage == ComparisonStage::kRefined ? ComparisonStage::kCompared : ComparisonStage::kUndecided;
}

void ComparisonProgress::Enter(ComparisonInput input) {
  stage_ = NextStage(stage_, input);
  windows_left_ = windows_factor_ * WindowsOf(stage_);
}

void ComparisonProgress::OnWindow() {
  if (stage_ == ComparisonStage::kUndecided) return;
  if (--windows_left_ == 0) Enter(ComparisonInput::kLastWindow);
}

void ComparisonProgress::SaveState(StateWriter& writer) const {
  int until_undecided = windows_left_;
  for (ComparisonStage stage = stage_; stage != ComparisonStage::kUndecided;) {
    stage = NextStage(stage, ComparisonInput::kLastWindow);
    until_undecided += windows_factor_ * WindowsOf(stage);
  }
  writer(until_undecided);
}

void ComparisonProgress::LoadState(StateReader& reader) {
  int until_undecided = 0;
  const int all_windows = windows_factor_ * (kSettlingWindows + kComparedWindows);
  reader(AtMost(until_undecided, all_windows));
  stage_ = ComparisonStage::kUndecided;
  windows_left_ = 0;
  if (!reader.ok() || until_undecided == 0) return;
  Enter(ComparisonInput::kRival);
  for (int windows = all_windows; windows > until_undecided; --windows) OnWindow();
}

}  // namespace evpose
