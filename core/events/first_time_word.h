// SPDX-License-Identifier: Apache-2.0

// The first time word of a recording: Metavision counts the times of RAW files from there.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/events/decoder.h"
#include "core/events/time_scanner.h"

namespace evpose {

// Takes the bytes of a recording from their beginning. OpenEB subtracts the first TIME_HIGH from all times of EVT3,
// EVT2.1 and EVT2, unless its option do_time_shifting is off; it leaves the times of other formats as they are.
class FirstTimeWord {
 public:
  // `stated_us` replaces the time of the first time word.
  explicit FirstTimeWord(Encoding encoding, std::optional<int64_t> stated_us = std::nullopt);

  void Add(absl::Span<const uint8_t> bytes);

  // Time of the first time word in microseconds, 0 for encodings without time words; nullopt before it was found.
  std::optional<int64_t> t_us() const { return t_us_; }

 private:
  TimeScanner scanner_;
  size_t word_bytes_;
  std::vector<uint8_t> words_;  // not scanned: an unfinished word
  std::optional<int64_t> t_us_;
};

}  // namespace evpose
