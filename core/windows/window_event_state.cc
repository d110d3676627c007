// SPDX-License-Identifier: Apache-2.0
#include "core/windows/window_event_state.h"

namespace evpose {
namespace {

// Map signed numbers of small magnitude to small unsigned numbers, and back.
uint64_t ZigZag(int64_t number) { return static_cast<uint64_t>(number) << 1 ^ static_cast<uint64_t>(number >> 63); }
int64_t UnZigZag(uint64_t number) { return static_cast<int64_t>(number >> 1 ^ (0 - (number & 1))); }

// The first varint of an event: the time since the previous event (zigzag, microseconds) above these three flag bits.
constexpr int kFlagBits = 3;
constexpr uint64_t kPolarityBit = 1;
constexpr int kPreviousShift = 1;
constexpr uint64_t kPreviousMask = 3;

}  // namespace

void SaveWindowEvents(StateWriter& writer, int64_t t_begin_us, absl::Span<const WindowEvent> events) {
  writer.Count(events.size());
  int64_t t_us = t_begin_us;
  for (const WindowEvent& event : events) {
    const uint64_t flags = (event.polarity != 0 ? kPolarityBit : 0) | static_cast<uint64_t>(event.previous)
                                                                          << kPreviousShift;
    writer.Varint(ZigZag(event.t_us - t_us) << kFlagBits | flags);
    writer(event.x, event.y);
    t_us = event.t_us;
  }
}

void LoadWindowEvents(StateReader& reader, int64_t t_begin_us, int64_t t_end_us, size_t max_events,
                      std::vector<WindowEvent>& events) {
  size_t count = 0;
  reader.Count(count);
  reader.Check(count <= max_events, "a window has more events than it may keep");
  events.clear();
  int64_t t_us = t_begin_us;
  for (size_t i = 0; i < count && reader.ok(); ++i) {
    uint64_t first = 0;
    WindowEvent event;
    reader.Varint(first);
    reader(event.x, event.y);
    // The magnitude of the step is below 2^61, so its sum with a window's time does not overflow.
    t_us += UnZigZag(first >> kFlagBits);
    const uint64_t previous = first >> kPreviousShift & kPreviousMask;
    reader.Check(t_us >= t_begin_us && t_us < t_end_us, "an event lies outside its window");
    reader.Check(previous <= static_cast<uint64_t>(PreviousPolarity::kOther),
                 "an event has an invalid previous polarity");
    event.t_us = t_us;
    event.polarity = first & kPolarityBit;
    event.previous = static_cast<PreviousPolarity>(previous);
    events.push_back(event);
  }
  if (!reader.ok()) events.clear();
}

}  // namespace evpose
