// SPDX-License-Identifier: Apache-2.0
#include "core/windows/window_memory.h"

#include <utility>

#include "core/numerics/sampling.h"
#include "core/windows/window_event_state.h"

namespace evpose {

WindowMemory::WindowMemory(int64_t memory_us, int max_window_events, int max_events)
    : memory_us_(memory_us),
      max_window_events_(static_cast<size_t>(max_window_events)),
      max_events_(static_cast<size_t>(max_events)) {}

void WindowMemory::Add(const EventWindow& window) {
  Stored stored{window, {}};
  const ByPolarity samples_per_kept = DownsampleByClass(
      max_window_events_, {0.5, 0.5}, window.events, [](const WindowEvent& event) { return event.polarity; },
      stored.events);
  stored.window.events = {};
  for (int polarity = 0; polarity < 2; ++polarity) {
    stored.window.events_per_sample[polarity] *= samples_per_kept[polarity];
  }
  stored.events.shrink_to_fit();
  num_events_ += stored.events.size();
  windows_.push_back(std::move(stored));
  while (windows_.size() > 1 &&
         (num_events_ > max_events_ || windows_.front().window.t_end_us <= window.t_end_us - memory_us_)) {
    RemoveOldest();
  }
}

void WindowMemory::Clear() {
  windows_.clear();
  num_events_ = 0;
}

void WindowMemory::RemoveOldest() {
  num_events_ -= windows_.front().events.size();
  windows_.pop_front();
}

void WindowMemory::SaveState(StateWriter& writer) const {
  writer.Count(windows_.size());
  for (const auto& [window, events] : windows_) {
    writer(window.t_begin_us, window.t_end_us, window.num_events, window.has_few_events, window.events_per_sample[0],
           window.events_per_sample[1]);
    SaveWindowEvents(writer, window.t_begin_us, events);
  }
}

void WindowMemory::LoadState(StateReader& reader) {
  // 18 minutes: a window with events is far shorter, and detectors count microseconds in 32 bits.
  constexpr int64_t kMaxDurationUs = int64_t{1} << 30;
  constexpr double kMaxEventsPerSample = 1e18;  // products with numbers of events stay finite
  Clear();
  size_t count = 0;
  reader.Count(count);
  for (size_t i = 0; i < count && reader.ok(); ++i) {
    const int64_t earliest_us = windows_.empty() ? -kMaxStateTimeUs : windows_.back().window.t_end_us;
    auto& [window, events] = windows_.emplace_back();
    reader(InRange(window.t_begin_us, earliest_us, kMaxStateTimeUs));
    reader(InRange(window.t_end_us, window.t_begin_us + 1, kMaxStateTimeUs), window.num_events, window.has_few_events,
           InRange(window.events_per_sample[0], 1.0, kMaxEventsPerSample),
           InRange(window.events_per_sample[1], 1.0, kMaxEventsPerSample));
    LoadWindowEvents(reader, window.t_begin_us, window.t_end_us, max_window_events_, events);
    reader.Check(events.empty() || window.t_end_us - window.t_begin_us <= kMaxDurationUs,
                 "a window with events is too long");
    reader.Check(events.size() <= window.num_events, "a window keeps more events than it had");
    num_events_ += events.size();
  }
  const bool is_bounded =
      windows_.size() <= 1 ||
      (num_events_ <= max_events_ && windows_.front().window.t_end_us > windows_.back().window.t_end_us - memory_us_);
  reader.Check(is_bounded, "the windows exceed the bounds of the memory");
  if (!reader.ok()) Clear();
}

EventWindow WindowMemory::At(size_t index) const {
  EventWindow window = windows_[index].window;
  window.events = windows_[index].events;
  return window;
}

}  // namespace evpose
