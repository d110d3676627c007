#include "core/windows/window_memory.h"

#include <utility>

#include "core/base/thin.h"

namespace evpose {

WindowMemory::WindowMemory(int64_t memory_us, int max_window_events, int max_events)
    : memory_us_(memory_us),
      max_window_events_(static_cast<size_t>(max_window_events)),
      max_events_(static_cast<size_t>(max_events)) {}

void WindowMemory::Add(const EventWindow& window) {
  Stored stored{window.t_begin_us,
                window.t_end_us,
                {window.events.begin(), window.events.end()},
                window.num_events,
                window.closed_on_time};
  ThinEvenly(max_window_events_, stored.events);
  stored.events.shrink_to_fit();
  num_events_ += stored.events.size();
  windows_.push_back(std::move(stored));
  while (windows_.size() > 1 &&
         (num_events_ > max_events_ || windows_.front().t_end_us <= window.t_end_us - memory_us_)) {
    Forget();
  }
}

void WindowMemory::Clear() {
  windows_.clear();
  num_events_ = 0;
}

void WindowMemory::Forget() {
  num_events_ -= windows_.front().events.size();
  windows_.pop_front();
}

EventWindow WindowMemory::At(size_t index) const {
  const Stored& stored = windows_[index];
  return {stored.t_begin_us, stored.t_end_us, stored.events, stored.num_events, stored.closed_on_time};
}

}  // namespace evpose
