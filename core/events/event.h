// SPDX-License-Identifier: Apache-2.0

// The data of an event camera: changes of brightness at pixels, and edges on trigger inputs.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <new>
#include <type_traits>
#include <vector>

namespace evpose {

// Largest absolute sensor time in a saved state, 36 thousand years: sums and differences of such times do not overflow.
inline constexpr int64_t kMaxStateTimeUs = int64_t{1} << 60;

// A contrast-detection event. The time is that of the sensor clock, unwrapped, in microseconds; x points right, y down,
// (0, 0) is the centre of the top-left pixel.
struct Event {
  int64_t t_us = 0;
  uint16_t x = 0;
  uint16_t y = 0;
  uint8_t polarity = 0;  // 1: brighter (ON), 0: darker (OFF)

  friend bool operator==(const Event&, const Event&) = default;
};

// A quantity of OFF events and of ON events, indexed by polarity.
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

// The sensor clock was at t_us before events[event_index], or after the last event if event_index is their number.
struct TimeMark {
  size_t event_index = 0;
  int64_t t_us = 0;

  friend bool operator==(const TimeMark&, const TimeMark&) = default;
};

// An allocator of memory that starts at a cache line and is not initialised: a decoder makes room for many events and
// fills it, and initialising the room first would cost as much as writing the events.
template <typename T>
struct UnwrittenMemory {
  static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);
  using value_type = T;
  static constexpr std::align_val_t kAlignment{64};  // bytes of a cache line

  UnwrittenMemory() = default;
  template <typename U>
  UnwrittenMemory(const UnwrittenMemory<U>&) {}  // NOLINT(google-explicit-constructor): required of an allocator

  T* allocate(size_t count) { return static_cast<T*>(::operator new(count * sizeof(T), kAlignment)); }
  void deallocate(T* memory, size_t) { ::operator delete(memory, kAlignment); }
  void construct(T*) {}  // with arguments, std::allocator_traits constructs the element

  friend bool operator==(const UnwrittenMemory&, const UnwrittenMemory&) { return true; }
};

// resize() leaves new events uninitialised.
using EventVector = std::vector<Event, UnwrittenMemory<Event>>;

// The output of decoders, which append and never clear.
struct DecodedEvents {
  EventVector events;
  std::vector<Trigger> triggers;
  // Times without events: a mark where the clock has advanced by 1 ms or more since the last event or mark. A function
  // of the stream, not of its cuts into calls. Consumers close windows at marks.
  std::vector<TimeMark> time_marks;
};

}  // namespace evpose
