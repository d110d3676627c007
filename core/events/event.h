// SPDX-License-Identifier: Apache-2.0

// What an event camera says: a change of brightness at a pixel, or an edge on a trigger input.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

namespace evpose {

// No sensor time of a saved state lies beyond it, 36 thousand years, to either side: sums and differences of such times
// do not overflow.
inline constexpr int64_t kMaxStateTime_us = int64_t{1} << 60;

// A contrast-detection event. Time is the sensor's clock, unwrapped, in microseconds; x to the right, y down,
// (0, 0) the centre of the top-left pixel.
struct Event {
  int64_t t_us = 0;
  uint16_t x = 0;
  uint16_t y = 0;
  uint8_t polarity = 0;  // 1: brighter (ON), 0: darker (OFF)

  friend bool operator==(const Event&, const Event&) = default;
};

// Something of OFF events, and of ON events.
using ByPolarity = std::array<double, 2>;

// An edge on an external trigger input.
struct Trigger {
  int64_t t_us = 0;
  uint8_t id = 0;
  uint8_t polarity = 0;  // 1: rising, 0: falling

  friend bool operator==(const Trigger&, const Trigger&) = default;
};

struct SensorGeometry {
  int width_px = 0;
  int height_px = 0;

  friend bool operator==(const SensorGeometry&, const SensorGeometry&) = default;
};

// The sensor's clock read t_us before events[event_index] (or at the end, when event_index equals their number).
struct TimeMark {
  size_t event_index = 0;
  int64_t t_us = 0;

  friend bool operator==(const TimeMark&, const TimeMark&) = default;
};

// Memory that begins where a cache line does, and is not written before the events are: a decoder makes room for many
// and fills it.
template <typename T>
struct UnwrittenMemory {
  static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);
  using value_type = T;
  static constexpr std::align_val_t kAlignment{64};

  UnwrittenMemory() = default;
  template <typename U>
  UnwrittenMemory(const UnwrittenMemory<U>&) {}  // NOLINT(google-explicit-constructor): as allocators are converted

  T* allocate(size_t count) { return static_cast<T*>(::operator new(count * sizeof(T), kAlignment)); }
  void deallocate(T* memory, size_t) { ::operator delete(memory, kAlignment); }
  void construct(T*) {}
  template <typename... Arguments>
  void construct(T* place, Arguments&&... arguments) {
    ::new (static_cast<void*>(place)) T(std::forward<Arguments>(arguments)...);
  }

  friend bool operator==(const UnwrittenMemory&, const UnwrittenMemory&) { return true; }
};

// resize() leaves new events unwritten.
using EventVector = std::vector<Event, UnwrittenMemory<Event>>;

// Decoded output; decoders append and never clear.
struct DecodedEvents {
  EventVector events;
  std::vector<Trigger> triggers;
  // Time passing without events: a mark where the clock has advanced by 1 ms or more since the last event or mark.
  // A function of the stream alone, never of how it was cut into calls: consumers close windows on it.
  std::vector<TimeMark> time_marks;
};

}  // namespace evpose
