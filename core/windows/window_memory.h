// SPDX-License-Identifier: Apache-2.0

// Stores the latest windows. The search of the first pose replays them.
#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "core/windows/event_window.h"

namespace evpose {

class WindowMemory {
 public:
  // Keeps the windows that end less than `memory_us` before the end of the latest one. Each window is downsampled to at
  // most `max_window_events` events, half of them for each polarity. The oldest windows are removed while the windows
  // hold more than `max_events` events in total; the latest window is always kept.
  WindowMemory(int64_t memory_us, int max_window_events, int max_events);

  void Add(const EventWindow& window);
  void Clear();

  size_t size() const { return windows_.size(); }
  // Index 0 is the oldest window. The result is valid until the next Add() or Clear().
  EventWindow At(size_t index) const;
  size_t num_events() const { return num_events_; }  // number of stored events, after downsampling

  // LoadState() requires a memory with the same bounds. After a failure (reader.status()) the object must not be used.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  void RemoveOldest();

  struct Stored {
    EventWindow window;  // its span of events is empty; At() sets it
    std::vector<WindowEvent> events;
  };

  const int64_t memory_us_;
  const size_t max_window_events_;
  const size_t max_events_;
  size_t num_events_ = 0;
  std::deque<Stored> windows_;
};

}  // namespace evpose
