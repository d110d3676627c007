// SPDX-License-Identifier: Apache-2.0

// Runs of the words that nearly all of a recording is made of, several at a time, with vector instructions. What is not
// plain there, a word of another type, a time that steps back, an address outside the sensor, ends the run and is left
// to the decoder's own loop, which knows all rules: the events are the same with and without. Cut into calls of a few
// bytes a stream has no runs, so that the tests of cut streams compare the two.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "core/events/event.h"

namespace evpose {

// EVT3: TIME_LOW, ADDR_Y, ADDR_X, and TIME_HIGH that changes nothing.
struct Evt3Run {
  uint32_t width_px = 0;
  uint32_t height_px = 0;
  int64_t base_us = 0;      // of the present TIME_HIGH
  int64_t mark_due_us = 0;  // a TIME_LOW that reaches it ends the run
  int64_t low_us = 0;       // present TIME_LOW, [0, 4095]
  uint32_t row = 0;         // present row, below height_px
};

// EVT2 and EVT2.1: events after one TIME_HIGH, which may come again; in EVT2.1, of one pixel each.
struct Evt2Run {
  uint32_t width_px = 0;
  uint32_t height_px = 0;
  int64_t base_us = 0;      // of the present TIME_HIGH, a multiple of 64
  int64_t mark_due_us = 0;  // where it may have been reached, a TIME_HIGH ends the run
  int64_t low_us = 0;       // of the last event, [0, 63]
};

// Decodes words while they are plain and `cursor` is below `limit`; returns how many. Fewer than a block, kMaxRunBlock
// at most, are no run. Moves `run` and `cursor`. Events are stored a block at a time, as if every word were one: so
// many from the cursor on must be writable.
template <typename Run>
using DecodeRunOf = size_t (*)(const uint8_t* words, size_t count, Run& run, Event*& cursor, const Event* limit);
inline constexpr size_t kMaxRunBlock = 16;

struct WordRuns {
  DecodeRunOf<Evt3Run> evt3;
  DecodeRunOf<Evt2Run> evt2;
  DecodeRunOf<Evt2Run> evt21;
};

// Null when the processor does not have the instructions.
const WordRuns* Avx2WordRuns();
const WordRuns* Avx512WordRuns();  // as of Ice Lake and Zen 4

// The fastest that the processor has, or null.
inline const WordRuns* BestWordRuns() {
  static const WordRuns* const best = Avx512WordRuns() != nullptr ? Avx512WordRuns() : Avx2WordRuns();
  return best;
}

// Looking for a run takes as long as decoding some words one by one. Where the runs are shorter, because many words are
// not plain, it does not pay: each look is a debt that the words of its run pay off, and what is still owed is waited
// for before the next.
class RunPause {
 public:
  // Behind a run of so many words, which may be none: how many words to decode one by one, at least one.
  size_t WordsAfter(size_t num_words) {
    owed_ = std::min(owed_ + kWordsOfLook - std::min(owed_ + kWordsOfLook, num_words), kMaxOwed);
    return 1 + owed_;
  }

 private:
  static constexpr size_t kWordsOfLook = 12;
  static constexpr size_t kMaxOwed = 256;

  size_t owed_ = 0;
};

}  // namespace evpose
