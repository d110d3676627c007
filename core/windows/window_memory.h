// SPDX-License-Identifier: Apache-2.0

// The latest windows, kept for whoever has to look back.
#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "core/windows/event_window.h"

namespace evpose {

class WindowMemory {
 public:
  // Keeps windows that end later than `memory_us` before the latest one's end, and of each at most `max_window_events`
  // events, evenly drawn by polarity. The oldest go early when there would be more than `max_events` events in all.
  WindowMemory(int64_t memory_us, int max_window_events, int max_events);

  void Add(const EventWindow& window);
  void Clear();

  size_t size() const { return windows_.size(); }
  // The oldest is number 0. Valid until the next Add.
  EventWindow At(size_t index) const;
  size_t num_events() const { return num_events_; }  // kept

  // Into a memory of the same bounds; after a failure (reader.status()) it must not be used.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  void Forget();

  struct Stored {
    int64_t t_begin_us = 0;
    int64_t t_end_us = 0;
    std::vector<WindowEvent> events;
    uint64_t num_events = 0;
    bool closed_on_time = false;
    ByPolarity events_per_sample = {1.0, 1.0};
  };

  const int64_t memory_us_;
  const size_t max_window_events_;
  const size_t max_events_;
  size_t num_events_ = 0;
  std::deque<Stored> windows_;
};

}  // namespace evpose
