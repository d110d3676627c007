// SPDX-License-Identifier: Apache-2.0

// Lines, words and numbers of a text in memory, for the readers of model files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"

namespace evpose {

// The bytes as text without the byte order mark of UTF-8. INVALID_ARGUMENT for those of UTF-16 and UTF-32.
absl::StatusOr<absl::string_view> AsText(absl::Span<const uint8_t> bytes);

// Returns a text line by line, without the line ends (\n, \r\n or \r).
class LineReader {
 public:
  explicit LineReader(absl::string_view text) : text_(text) {}

  // nullopt at the end. A line feed at the very end starts no further line.
  std::optional<absl::string_view> Next();
  int64_t line_number() const { return line_number_; }  // number of the line returned last; the first is 1
  size_t offset() const { return offset_; }             // of the first byte not yet returned

 private:
  absl::string_view text_;
  size_t offset_ = 0;
  int64_t line_number_ = 0;
};

// Replaces `words` by the words of a line, which spaces and tabs separate.
void SplitWords(absl::string_view line, std::vector<absl::string_view>& words);

// INVALID_ARGUMENT: "line 12: <what>".
absl::Status LineError(int64_t line_number, absl::string_view what);
// Adds the line to an error; OK stays OK.
absl::Status LineError(int64_t line_number, const absl::Status& status);

// A coordinate, which must be finite in single precision. The error names the line and the word.
absl::StatusOr<float> ReadCoordinate(absl::string_view word, int64_t line_number);

}  // namespace evpose
