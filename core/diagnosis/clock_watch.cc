// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/clock_watch.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Events that a gap would have had at the smaller of the rates before and after it. By chance a gap has none with the
// probability e^-50; slow changes of the rate are covered, because the rates are those of 10 ms.
constexpr double kMinExpectedEvents = 50.0;
// Share of the differences that are multiples of a step: the others may be due to late words. With fewer differences
// than kMinStepSamples, chance makes most of them multiples.
constexpr double kMinMultiples = 0.95;
constexpr size_t kMinStepSamples = 50;

}  // namespace

void ClockWatch::Add(absl::Span<const Event> events) {
  for (const Event& event : events) {
    if (!has_event_) {
      has_event_ = true;
      t_us_ = event.t_us;
      slot_ = event.t_us / kSlotUs;
    }
    const int64_t step_us = event.t_us - t_us_;
    if (step_us < 0) {
      if (-step_us > result_.largest_step_back_us) {
        result_.largest_step_back_us = -step_us;
        result_.largest_step_back_at_us = event.t_us;
      }
      // Events slightly out of order do not move the clock; after a jump it continues from there.
      if (-step_us < kMinGapUs) continue;
      recent_.fill(0);
      has_open_ = false;
      slot_ = event.t_us / kSlotUs;
    }
    if (step_us > 0) AddStep(step_us);
    if (step_us >= kMinGapUs) {
      if (has_open_) AddGap();
      has_open_ = true;
      open_ = {t_us_, step_us, 0.0};
      before_ = static_cast<double>(std::accumulate(recent_.begin(), recent_.end(), uint64_t{0}));
      after_ = 0.0;
    }
    if (has_open_) {
      if (event.t_us - open_.begin_us - open_.duration_us < kSlots * kSlotUs) {
        after_ += 1.0;
      } else {
        AddGap();
      }
    }
    const int64_t slot = event.t_us / kSlotUs;
    for (int64_t s = slot - slot_ >= kSlots ? slot - kSlots + 1 : slot_ + 1; s <= slot; ++s) {
      recent_[static_cast<size_t>((s % kSlots + kSlots) % kSlots)] = 0;
    }
    slot_ = slot;
    ++recent_[static_cast<size_t>((slot % kSlots + kSlots) % kSlots)];
    t_us_ = event.t_us;
  }
}

void ClockWatch::AddGap() {
  has_open_ = false;
  open_.expected_events =
      std::min(before_, after_) * static_cast<double>(open_.duration_us) / static_cast<double>(kSlots * kSlotUs);
  if (open_.expected_events < kMinExpectedEvents) return;
  ++result_.num_gaps;
  std::vector<Gap>& gaps = result_.gaps;
  gaps.push_back(open_);
  std::stable_sort(gaps.begin(), gaps.end(), [](const Gap& a, const Gap& b) { return a.duration_us > b.duration_us; });
  if (gaps.size() > kMaxListed) gaps.pop_back();
}

void ClockWatch::AddStep(int64_t step_us) {
  if (num_steps_++ % stride_ != 0) return;
  steps_.push_back(step_us);
  if (steps_.size() < kMaxSteps) return;
  for (size_t i = 0; 2 * i < steps_.size(); ++i) steps_[i] = steps_[2 * i];
  steps_.resize(steps_.size() / 2);
  stride_ *= 2;
}

int64_t ClockWatch::TimeStepUs() const {
  if (steps_.size() < kMinStepSamples) return 0;
  std::vector<int64_t> steps = steps_;
  const int64_t least_us = UpperQuantile(steps, 1.0 - kMinMultiples);
  if (least_us <= 1) return 1;
  // Frames of 30 Hz are 33,333 and 33,334 us apart.
  const double tolerance_us = least_us >= 100 ? 1.5 : 0.0;
  size_t multiples = 0;
  for (const int64_t step_us : steps) {
    const double ratio = static_cast<double>(step_us) / static_cast<double>(least_us);
    const double whole = std::max(1.0, std::round(ratio));
    multiples += std::abs(ratio - whole) * static_cast<double>(least_us) <= tolerance_us * whole;
  }
  const bool is_quantised = static_cast<double>(multiples) >= kMinMultiples * static_cast<double>(steps.size());
  return is_quantised ? least_us : 1;
}

ClockWatch::Result ClockWatch::Measure() const {
  ClockWatch copy = *this;
  if (copy.has_open_) copy.AddGap();
  copy.result_.time_step_us = copy.TimeStepUs();
  return copy.result_;
}

}  // namespace evpose
