// SPDX-License-Identifier: Apache-2.0
#include "core/events/first_time_word.h"

namespace evpose {

FirstTimeWord::FirstTimeWord(Encoding encoding, std::optional<int64_t> stated_us)
    : scanner_(encoding), word_bytes_(static_cast<size_t>(WordBytes(encoding))), t_us_(stated_us) {
  if (t_us_.has_value()) return;
  if (encoding == Encoding::kDat || encoding == Encoding::kFlat64) t_us_ = 0;
}

void FirstTimeWord::Add(absl::Span<const uint8_t> bytes) {
  if (t_us_.has_value()) return;
  words_.insert(words_.end(), bytes.begin(), bytes.end());
  // Without a duration, the scan stops at the first time word.
  const TimeScanner::Result scan = scanner_.Scan(words_.data(), words_.size() / word_bytes_, 0);
  if (scan.duration_passed) t_us_ = scanner_.now_us();
  words_.erase(words_.begin(), words_.begin() + static_cast<std::ptrdiff_t>(scan.num_words * word_bytes_));
}

}  // namespace evpose
