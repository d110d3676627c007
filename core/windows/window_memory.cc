#include "core/windows/window_memory.h"

#include <utility>

#include "core/base/thin.h"

namespace evpose {

WindowMemory::WindowMemory(int64_t memory_us, int max_window_events)
    : memory_us_(memory_us), max_window_events_(static_cast<size_t>(max_window_events)) {}

void WindowMemory::Add(const EventWindow& window) {
  while (!windows_.empty() && windows_.front().t_end_us <= window.t_end_us - memory_us_) windows_.pop_front();
  Stored stored{window.t_begin_us,
                window.t_end_us,
                {window.events.begin(), window.events.end()},
                window.num_events,
                window.closed_on_time};
  ThinEvenly(max_window_events_, stored.events);
  stored.events.shrink_to_fit();
  windows_.push_back(std::move(stored));
}

EventWindow WindowMemory::At(size_t index) const {
  const Stored& stored = windows_[index];
  return {stored.t_begin_us, stored.t_end_us, stored.events, stored.num_events, stored.closed_on_time};
}

size_t WindowMemory::num_events() const {
  size_t count = 0;
  for (const Stored& window : windows_) count += window.events.size();
  return count;
}

}  // namespace evpose
