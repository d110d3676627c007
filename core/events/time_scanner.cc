// SPDX-License-Identifier: Apache-2.0
#include "core/events/time_scanner.h"

#include "core/events/word_decoder.h"
#include "core/events/word_types.h"

namespace evpose {

void TimeScanner::ResetAfterLoss() {
  vector_words_to_skip_ = 0;
  wait_ = Wait::kTimeHigh;
  needs_time_low_ = encoding_ == Encoding::kEvt3;
}

bool TimeScanner::AdvanceTo(int64_t now_us, int64_t max_duration_us) {
  now_us_ = now_us;
  // After a step back the duration starts again.
  if (chunk_start_us_ < 0 || now_us < chunk_start_us_) chunk_start_us_ = now_us;
  return now_us - chunk_start_us_ >= max_duration_us;
}

TimeScanner::Result TimeScanner::Scan(const uint8_t* words, size_t num_words, int64_t max_duration_us) {
  switch (encoding_) {
    case Encoding::kEvt3:
      return ScanEvt3(words, num_words, max_duration_us);
    case Encoding::kEvt21:
      return ScanEvt2<uint64_t>(words, num_words, max_duration_us);
    case Encoding::kEvt2:
      return ScanEvt2<uint32_t>(words, num_words, max_duration_us);
    case Encoding::kDat:
      return ScanDat(words, num_words, max_duration_us);
    case Encoding::kFlat64:
      return ScanFlat64(words, num_words, max_duration_us);
  }
  return {};
}

TimeScanner::Result TimeScanner::ScanEvt3(const uint8_t* words, size_t num_words, int64_t max_duration_us) {
  for (size_t i = 0; i < num_words; ++i) {
    const uint32_t word = LoadWord<uint16_t>(words + 2 * i);
    const uint32_t type = word >> 12;
    if (vector_words_to_skip_ > 0) {
      --vector_words_to_skip_;
    } else if (type == evt3::kVect12) {
      vector_words_to_skip_ = wait_ == Wait::kNothing ? 2 : 0;
    } else if (type == evt3::kTimeHigh || (type == evt3::kTimeLow && wait_ != Wait::kTimeHigh)) {
      const bool needs_low = type == evt3::kTimeHigh && wait_ != Wait::kNothing && needs_time_low_;
      wait_ = needs_low ? Wait::kTimeLow : Wait::kNothing;
      const uint32_t content = word & 0xfff;
      type == evt3::kTimeHigh ? evt3_clock_.SetHigh(content) : evt3_clock_.SetLow(content);
      if (AdvanceTo(evt3_clock_.now_us(), max_duration_us)) return {i + 1, true};
    }
  }
  return {num_words, false};
}

template <typename Word>
TimeScanner::Result TimeScanner::ScanEvt2(const uint8_t* words, size_t num_words, int64_t max_duration_us) {
  // The low time bits of the last event. The clock needs them only before the next TIME_HIGH and at the end.
  int64_t low_us = -1;
  const auto apply_low = [&] {
    if (low_us >= 0 && wait_ == Wait::kNothing) {
      evt2_clock_.SetLow(low_us);
      now_us_ = evt2_clock_.now_us();
    }
    low_us = -1;
  };
  for (size_t i = 0; i < num_words; ++i) {
    const auto word = static_cast<uint32_t>(LoadWord<Word>(words + sizeof(Word) * i) >> (8 * sizeof(Word) - 32));
    const uint32_t type = word >> 28;
    if (type <= 1 || type == evt2::kExtTrigger) {
      low_us = (word >> 22) & 0x3f;
    } else if (type == evt2::kTimeHigh) {
      apply_low();
      evt2_clock_.SetHigh(word & 0xfffffff);
      wait_ = Wait::kNothing;
      if (AdvanceTo(evt2_clock_.now_us(), max_duration_us)) return {i + 1, true};
    }
  }
  apply_low();
  return {num_words, false};
}

TimeScanner::Result TimeScanner::ScanDat(const uint8_t* words, size_t num_words, int64_t max_duration_us) {
  for (size_t i = 0; i < num_words; ++i) {
    clock32_.Set(static_cast<uint32_t>(LoadWord<uint64_t>(words + 8 * i)));
    if (AdvanceTo(clock32_.now_us(), max_duration_us)) return {i + 1, true};
  }
  return {num_words, false};
}

TimeScanner::Result TimeScanner::ScanFlat64(const uint8_t* words, size_t num_words, int64_t max_duration_us) {
  for (size_t i = 0; i < num_words; ++i) {
    const auto word = LoadWord<uint64_t>(words + 8 * i);
    if (Flat64Kind(word) == WordKind::kUnknown) continue;
    clock32_.Set(static_cast<uint32_t>(word >> 32));
    if (AdvanceTo(clock32_.now_us(), max_duration_us)) return {i + 1, true};
  }
  return {num_words, false};
}

}  // namespace evpose
