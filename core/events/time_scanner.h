// SPDX-License-Identifier: Apache-2.0

// Extracts the time from a stream of words without decoding its events.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/events/decoder.h"
#include "core/events/sensor_clock.h"

namespace evpose {

class TimeScanner {
 public:
  struct Result {
    size_t num_words = 0;          // scanned
    bool duration_passed = false;  // the last of them completed the duration since BeginChunk()
  };

  explicit TimeScanner(Encoding encoding) : encoding_(encoding) {}

  // Scans at most `num_words` words; stops after the word whose time is `max_duration_us` or more after the first known
  // time of the chunk.
  Result Scan(const uint8_t* words, size_t num_words, int64_t max_duration_us);

  // Ends the chunk; the next one begins at the current time.
  void BeginChunk() { chunk_start_us_ = now_us_; }

  // Bytes were lost before the next word.
  void ResetAfterLoss();

  // The current time, equal to that of a decoder of the same words; -1 before the first time word.
  int64_t now_us() const { return now_us_; }

 private:
  Result ScanEvt3(const uint8_t* words, size_t num_words, int64_t max_duration_us);
  template <typename Word>
  Result ScanEvt2(const uint8_t* words, size_t num_words, int64_t max_duration_us);
  Result ScanDat(const uint8_t* words, size_t num_words, int64_t max_duration_us);
  Result ScanFlat64(const uint8_t* words, size_t num_words, int64_t max_duration_us);

  // Sets the current time; true if the chunk has reached its duration.
  bool AdvanceTo(int64_t now_us, int64_t max_duration_us);

  Encoding encoding_;
  Evt3Clock evt3_clock_;
  Evt2Clock evt2_clock_;
  Clock32 clock32_;
  // The same rule as in the decoders: without a TIME_HIGH since the start or a loss, other words have no known time.
  // After a loss, EVT3 also needs a TIME_LOW.
  enum class Wait { kTimeHigh, kTimeLow, kNothing };
  Wait wait_ = Wait::kTimeHigh;
  bool needs_time_low_ = false;
  int vector_words_to_skip_ = 0;
  int64_t now_us_ = -1;
  int64_t chunk_start_us_ = -1;
};

}  // namespace evpose
