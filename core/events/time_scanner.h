// SPDX-License-Identifier: Apache-2.0

// Follows the time of a stream of words without decoding its events.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/events/decoder.h"
#include "core/events/formats/sensor_clock.h"

namespace evpose {

class TimeScanner {
 public:
  struct Result {
    size_t num_words = 0;          // scanned
    bool duration_passed = false;  // the last of them brought the duration since BeginChunk() to an end
  };

  explicit TimeScanner(Encoding encoding) : encoding_(encoding) {}

  // Scans up to `num_words`; stops behind the word whose time is `max_duration_us` or more after the beginning of the
  // chunk, which is the first time known in it.
  Result Scan(const uint8_t* words, size_t num_words, int64_t max_duration_us);

  // The chunk ends here; the next begins at the present time.
  void BeginChunk() { chunk_start_us_ = now_us_; }

  // As a decoder of the same words has it; -1 before the first.
  int64_t now_us() const { return now_us_; }

 private:
  Result ScanEvt3(const uint8_t* words, size_t num_words, int64_t max_duration_us);
  template <typename Word>
  Result ScanEvt2(const uint8_t* words, size_t num_words, int64_t max_duration_us);
  Result ScanFullTime(const uint8_t* words, size_t num_words, int64_t max_duration_us, int time_shift);

  // True when the chunk is over.
  bool TimeIs(int64_t now_us, int64_t max_duration_us);

  const Encoding encoding_;
  Evt3Clock evt3_clock_;
  Evt2Clock evt2_clock_;
  Clock32 clock32_;
  int vector_words_to_skip_ = 0;
  int64_t now_us_ = -1;
  int64_t chunk_start_us_ = -1;
};

}  // namespace evpose
