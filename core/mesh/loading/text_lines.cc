// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/loading/text_lines.h"

#include <cmath>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "core/base/quoted.h"

namespace evpose {

absl::StatusOr<absl::string_view> AsText(absl::Span<const uint8_t> bytes) {
  const absl::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (absl::StartsWith(text, "\xFF\xFE") || absl::StartsWith(text, "\xFE\xFF")) {
    return absl::InvalidArgumentError("the text is in UTF-16 or UTF-32; save the file as UTF-8 or ASCII");
  }
  return absl::StripPrefix(text, "\xEF\xBB\xBF");
}

std::optional<absl::string_view> LineReader::Next() {
  if (offset_ >= text_.size()) return std::nullopt;
  ++line_number_;
  const size_t end = text_.find_first_of("\r\n", offset_);
  if (end == absl::string_view::npos) {
    const absl::string_view line = text_.substr(offset_);
    offset_ = text_.size();
    return line;
  }
  const absl::string_view line = text_.substr(offset_, end - offset_);
  const bool two_bytes = text_[end] == '\r' && end + 1 < text_.size() && text_[end + 1] == '\n';
  offset_ = end + (two_bytes ? 2 : 1);
  return line;
}

void SplitWords(absl::string_view line, std::vector<absl::string_view>& words) {
  words.clear();
  for (const absl::string_view word : absl::StrSplit(line, absl::ByAnyChar(" \t"), absl::SkipEmpty())) {
    words.push_back(word);
  }
}

absl::Status LineError(int64_t line_number, absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("line ", line_number, ": ", what));
}

absl::Status LineError(int64_t line_number, const absl::Status& status) {
  return status.ok() ? status : LineError(line_number, status.message());
}

absl::StatusOr<float> ReadCoordinate(absl::string_view word, int64_t line_number) {
  double value;
  if (!absl::SimpleAtod(word, &value)) return LineError(line_number, Quoted(word) + " is not a number");
  // Read as a double first: a coordinate written with 17 digits is rounded like the double that was written.
  if (std::isfinite(static_cast<float>(value))) return static_cast<float>(value);
  return LineError(line_number, Quoted(word) + " is not a finite coordinate");
}

}  // namespace evpose
