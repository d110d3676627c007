// SPDX-License-Identifier: Apache-2.0

// Vectorised decoding of runs of plain words, the majority of the words of a recording. A word of another type, a time
// that steps back or an address outside the sensor ends the run and is left to the decoder's scalar loop, which
// implements all rules; the events are the same with and without runs. A stream that is cut into calls of a few bytes
// has no runs, so that the tests of cut streams compare both.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "core/events/event.h"
#include "core/events/evt3_vector.h"

namespace evpose {

// State of a run in EVT3. Plain words: TIME_LOW, ADDR_Y, ADDR_X, a TIME_HIGH that changes nothing, and the four words
// of a whole vector.
struct Evt3Run {
  uint32_t width_px = 0;
  uint32_t height_px = 0;
  int64_t base_us = 0;      // time of the current TIME_HIGH
  int64_t mark_due_us = 0;  // a TIME_LOW at or after this time ends the run
  int64_t low_us = 0;       // current TIME_LOW, [0, 4095]
  uint32_t row = 0;         // current row, below height_px
  Evt3VectorBase base;
};

// State of a run in EVT2 and EVT2.1. Plain words: events (in EVT2.1, of one pixel each), and the current TIME_HIGH
// again.
struct Evt2Run {
  uint32_t width_px = 0;
  uint32_t height_px = 0;
  int64_t base_us = 0;      // time of the current TIME_HIGH, a multiple of 64
  int64_t mark_due_us = 0;  // a TIME_HIGH ends the run if this time may have been reached
  int64_t low_us = 0;       // low bits of the time of the last event, [0, 63]
};

// Decodes words while they are plain and `cursor` is below `limit`; updates `run` and `cursor` and returns the number
// of decoded words. Fewer words than a block, at most kMaxRunBlock, are not decoded. Events are stored in blocks, as if
// every word were an event, or for a whole vector: EventSink::kMaxEventsOfWord events from the limit on must be
// writable.
template <typename Run>
using DecodeRunOf = size_t (*)(const uint8_t* words, size_t count, Run& run, Event*& cursor, const Event* limit);
inline constexpr size_t kMaxRunBlock = 16;  // words of the largest block, that of EVT3 and EVT2 with AVX-512

struct WordRuns {
  DecodeRunOf<Evt3Run> evt3;
  DecodeRunOf<Evt2Run> evt2;
  DecodeRunOf<Evt2Run> evt21;
};

// Null if the processor does not have the instructions.
const WordRuns* Avx2WordRuns();
const WordRuns* Avx512WordRuns();  // since Ice Lake and Zen 4

// The fastest of both that the processor has, or null.
inline const WordRuns* BestWordRuns() {
  static const WordRuns* const best = Avx512WordRuns() != nullptr ? Avx512WordRuns() : Avx2WordRuns();
  return best;
}

// Limits the attempts to find a run. An attempt costs as much time as the scalar decoding of some words, which is a
// loss where runs are short. The costs of attempts add up, in words; the words of a run reduce the sum, and before the
// next attempt as many words as remain are decoded one by one.
class RunPause {
 public:
  // Number of words, at least 1, to decode one by one after a run of `num_words` words (0: no run was found).
  size_t WordsAfter(size_t num_words) {
    owed_ = std::min(owed_ + kWordsOfLook - std::min(owed_ + kWordsOfLook, num_words), kMaxOwed);
    return 1 + owed_;
  }

 private:
  static constexpr size_t kWordsOfLook = 12;  // the cost of an attempt
  static constexpr size_t kMaxOwed = 256;     // so that a stream that becomes plain again is noticed soon

  size_t owed_ = 0;
};

}  // namespace evpose
