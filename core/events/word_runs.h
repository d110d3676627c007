// Runs of the words that nearly all of a recording is made of, several at a time, with vector instructions. What is not
// plain there, a word of another type, a time that steps back, an address outside the sensor, ends the run and is left
// to the decoder's own loop, which knows all rules: the events are the same with and without. Cut into calls of a few
// bytes a stream has no runs, so that the tests of cut streams compare the two.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/events/event.h"

namespace evpose {

// Whether this processor has the instructions (AVX2). Without them the others must not be called.
bool HasWordRuns();

// Fewer words are no run. Events are stored in groups: up to so many beyond the last one must be writable.
inline constexpr size_t kWordRun = 8;

// EVT3: TIME_LOW, ADDR_Y, ADDR_X, and TIME_HIGH that changes nothing.
struct Evt3Run {
  uint32_t width_px = 0;
  uint32_t height_px = 0;
  int64_t base_us = 0;      // of the present TIME_HIGH
  int64_t mark_due_us = 0;  // a TIME_LOW that reaches it ends the run
  int64_t low_us = 0;       // present TIME_LOW, [0, 4095]
  uint32_t row = 0;         // present row, below height_px
};

// Decodes words while they are plain and `cursor` is below `limit`; returns how many. Moves `run` and `cursor`.
size_t DecodeEvt3Run(const uint8_t* words, size_t count, Evt3Run& run, Event*& cursor, const Event* limit);

// EVT2: events after one TIME_HIGH.
struct Evt2Run {
  uint32_t width_px = 0;
  uint32_t height_px = 0;
  int64_t base_us = 0;  // of the present TIME_HIGH
  int64_t low_us = 0;   // of the last event, [0, 63]
};

// As DecodeEvt3Run; every word is an event.
size_t DecodeEvt2Run(const uint8_t* words, size_t count, Evt2Run& run, Event*& cursor, const Event* limit);

}  // namespace evpose
