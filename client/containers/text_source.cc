// SPDX-License-Identifier: Apache-2.0
#include "client/containers/text_source.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/containers/decimal.h"
#include "client/containers/event_source.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kMaxFields = 16;         // of a line; further ones are not looked at
constexpr size_t kMaxLineBytes = 1024;    // a longer line is no event
constexpr size_t kMaxSampledRows = 2000;  // from which the layout is found
static_assert(kReadBytes > 4 * kMaxLineBytes);

bool IsSeparator(char c) { return c == ' ' || c == '\t' || c == ',' || c == ';'; }
bool IsComment(std::string_view line) { return line.empty() || line[0] == '%' || line[0] == '#'; }

// Splits a line at spaces, tabs, commas and semicolons. Several spaces count as one.
size_t SplitFields(std::string_view line, std::string_view (&fields)[kMaxFields]) {
  size_t count = 0;
  size_t begin = 0;
  while (count < kMaxFields) {
    while (begin < line.size() && IsSeparator(line[begin])) ++begin;
    if (begin == line.size()) break;
    size_t end = begin;
    while (end < line.size() && !IsSeparator(line[end])) ++end;
    fields[count++] = line.substr(begin, end - begin);
    begin = end;
  }
  return count;
}

// Removes the first line from `text`, without its end; nullopt if the line has no end.
std::optional<std::string_view> TakeLine(std::string_view& text) {
  const size_t end = text.find('\n');
  if (end == std::string_view::npos) return std::nullopt;
  std::string_view line = text.substr(0, end);
  text.remove_prefix(end + 1);
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  return line;
}

std::optional<SensorGeometry> ReadSize(std::string_view width, std::string_view height) {
  SensorGeometry size;
  const bool is_size = absl::SimpleAtoi(absl::string_view(width.data(), width.size()), &size.width_px) &&
                       absl::SimpleAtoi(absl::string_view(height.data(), height.size()), &size.height_px);
  if (!is_size || size.width_px <= 0 || size.height_px <= 0) return std::nullopt;
  return size;
}

// "%geometry:640,480", "%time_offset_us:1700000000000000"
void ReadComment(std::string_view line, TextLayout& layout) {
  const size_t colon = line.find(':');
  if (colon == std::string_view::npos) return;
  const std::string_view key = line.substr(0, colon);
  std::string_view fields[kMaxFields];
  const size_t count = SplitFields(line.substr(colon + 1), fields);
  if (key == "%geometry" && count == 2) layout.geometry = ReadSize(fields[0], fields[1]);
  if (key == "%time_offset_us" && count == 1) {
    layout.time_offset_us = ScaledDecimal(fields[0], 0).value_or(0);
  }
}

bool IsText(std::string_view prefix) {
  return !prefix.empty() && std::all_of(prefix.begin(), prefix.end(), [](char c) {
    return static_cast<unsigned char>(c) >= 0x20 || c == '\n' || c == '\r' || c == '\t';
  });
}

bool ToNumber(std::string_view text, double& value) {
  return absl::SimpleAtod(absl::string_view(text.data(), text.size()), &value);
}

// The lines at the beginning of a text.
struct TextSample {
  std::vector<std::string> names;  // of the columns, if a line has them
  std::vector<std::vector<double>> rows;
  TextLayout layout;  // its columns are not set
};

// A name may have blanks, "t [us]", unless they separate the names.
std::vector<std::string> ColumnNames(std::string_view line) {
  const absl::string_view text(line.data(), line.size());
  const bool has_signs = line.find_first_of(",;\t") != std::string_view::npos;
  std::vector<std::string> names =
      absl::StrSplit(text, absl::ByAnyChar(has_signs ? ",;\t" : " "), absl::SkipWhitespace());
  for (std::string& name : names) {
    absl::StripAsciiWhitespace(&name);
    if (name.size() >= 2 && name.front() == '"' && name.back() == '"') name = name.substr(1, name.size() - 2);
  }
  return names;
}

// False if a line before the first event is neither names nor a size.
bool AddSampledLine(std::string_view line, TextSample& sample) {
  if (IsComment(line)) {
    if (!line.empty()) ReadComment(line, sample.layout);
    return true;
  }
  std::string_view fields[kMaxFields];
  const size_t count = SplitFields(line, fields);
  if (count == 0) return true;
  std::vector<double> row(count);
  size_t num_numbers = 0;
  while (num_numbers < count && ToNumber(fields[num_numbers], row[num_numbers])) ++num_numbers;
  if (num_numbers == count && count >= 4) {
    sample.layout.has_commas = sample.layout.has_commas || line.find(',') != std::string_view::npos;
    sample.rows.push_back(std::move(row));
    return true;
  }
  if (!sample.rows.empty()) return true;  // a damaged line among the events
  ++sample.layout.num_heading_lines;
  if (num_numbers == count && count == 2) {
    sample.layout.geometry = ReadSize(fields[0], fields[1]);
    return sample.layout.geometry.has_value();
  }
  if (!sample.names.empty() || num_numbers > 0) return false;
  sample.names = ColumnNames(line);
  return true;
}

std::optional<ColumnLayout> LayoutOfSample(const TextSample& sample) {
  if (sample.names.empty()) {
    std::vector<TableRow> rows;
    for (const std::vector<double>& row : sample.rows) {
      if (row.size() == 4) rows.push_back({row[0], row[1], row[2], row[3]});
    }
    return LayoutOfRows(rows);
  }
  const std::optional<ColumnLayout> layout = LayoutOfNames(sample.names, {});
  if (!layout) return std::nullopt;
  std::vector<double> times;
  for (const std::vector<double>& row : sample.rows) {
    if (row.size() < static_cast<size_t>(layout->num_columns())) continue;
    const auto at = [&row](int column) { return row[static_cast<size_t>(column)]; };
    // The other columns may have nan. TakeEvent() rounds x, y and p as well.
    const TableRow event = {at(layout->t), std::round(at(layout->x)), std::round(at(layout->y)),
                            std::round(at(layout->p))};
    if (IsEventRow({0, 1, 2, 3}, event)) times.push_back(event[0]);
  }
  return LayoutOfNames(sample.names, times);
}

class TextSource final : public EventSource {
 public:
  TextSource(std::unique_ptr<ByteSource> bytes, const TextLayout& layout)
      : bytes_(std::move(bytes)), layout_(layout), heading_left_(layout.num_heading_lines), buffer_(kReadBytes) {
    facts_ = {absl::StrCat(layout.has_commas ? "CSV" : "text", " (", layout.columns.Describe(), ", t in ",
                           TimeUnit(layout.columns.time_exponent), ")"),
              layout.geometry, layout.time_offset_us};
  }

  const SourceFacts& facts() const override { return facts_; }

  absl::StatusOr<bool> Next(std::vector<SourceEvent>& events) override {
    events.clear();
    if (is_at_end_) return false;
    std::memmove(buffer_.data(), buffer_.data() + begin_, end_ - begin_);
    end_ -= std::exchange(begin_, 0);
    EVPOSE_ASSIGN_OR_RETURN(const size_t size, bytes_->Read(absl::MakeSpan(buffer_).subspan(end_)));
    end_ += size;
    is_at_end_ = size == 0;
    if (is_at_end_ && (end_ > 0 || is_in_long_line_)) buffer_[end_++] = '\n';  // the last line may have no end
    std::string_view text(reinterpret_cast<const char*>(buffer_.data()), end_);
    while (const std::optional<std::string_view> line = TakeLine(text)) TakeEvent(*line, events);
    begin_ = end_ - text.size();
    if (text.size() > kMaxLineBytes + 1) {  // with '\r'; the rest of this line is skipped together with its beginning
      begin_ = end_;
      if (!std::exchange(is_in_long_line_, true)) is_long_comment_ = IsComment(text);
    }
    return true;
  }

  std::vector<SkippedParts> skipped() const override {
    if (num_unreadable_ == 0) return {};
    return {{"lines that are not events", num_unreadable_, SkippedParts::Loss::kEvents}};
  }

 private:
  void TakeEvent(std::string_view line, std::vector<SourceEvent>& events) {
    // Whether `line` is the rest of a longer line. The beginning of that line exceeded the maximum and was skipped.
    const bool is_rest = std::exchange(is_in_long_line_, false);
    if (is_rest ? is_long_comment_ : IsComment(line)) return;
    if (is_rest || line.size() > kMaxLineBytes) {
      if (heading_left_ > 0) {
        --heading_left_;
      } else {
        ++num_unreadable_;
      }
      return;
    }
    std::string_view fields[kMaxFields];
    const size_t count = SplitFields(line, fields);
    if (count == 0) return;
    if (heading_left_ > 0) {
      --heading_left_;
      return;
    }
    const ColumnLayout& columns = layout_.columns;
    if (count < static_cast<size_t>(columns.num_columns())) {
      ++num_unreadable_;
      return;
    }
    const auto t_us = ScaledDecimal(fields[columns.t], columns.time_exponent);
    const auto x = ScaledDecimal(fields[columns.x], 0);
    const auto y = ScaledDecimal(fields[columns.y], 0);
    const auto p = ScaledDecimal(fields[columns.p], 0);
    if (!t_us || !x || !y || !p || *p < -1 || *p > 1) {
      ++num_unreadable_;
      return;
    }
    events.push_back({*t_us, *x, *y, *p > 0});
  }

  const std::unique_ptr<ByteSource> bytes_;
  const TextLayout layout_;
  SourceFacts facts_;
  int heading_left_;
  std::vector<uint8_t> buffer_;
  size_t begin_ = 0;  // of the bytes of lines that were not taken
  size_t end_ = 0;
  bool is_at_end_ = false;
  bool is_in_long_line_ = false;
  bool is_long_comment_ = false;  // whether this line began as a comment
  uint64_t num_unreadable_ = 0;
};

bool MatchesText(std::string_view prefix) { return FindTextLayout(prefix).has_value(); }

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenText(ContainerFile file) {
  const bool is_stream = file.path.empty();
  std::unique_ptr<ByteSource> bytes = std::move(file.bytes);
  const RecordingReaderOptions options = bytes->options();
  EVPOSE_ASSIGN_OR_RETURN(const std::string_view prefix, bytes->Peek(1));
  const TextLayout layout = *FindTextLayout(prefix);
  const auto open = [&]() -> absl::StatusOr<std::unique_ptr<EventSource>> {
    if (bytes == nullptr) {
      EVPOSE_ASSIGN_OR_RETURN(bytes, ByteSource::Open(file.path, options));
    }
    return std::make_unique<TextSource>(std::move(bytes), layout);
  };
  return MakeSourceReader(file.name, open, file.geometry, !is_stream);
}

}  // namespace

const ContainerFormat kTextFormat = {
    .name = "text or CSV", .matches = MatchesText, .open = OpenText, .reads_streams = true};

std::optional<TextLayout> FindTextLayout(std::string_view prefix) {
  if (!IsText(prefix)) return std::nullopt;
  TextSample sample;
  std::string_view rest = prefix;
  while (const std::optional<std::string_view> line = TakeLine(rest)) {
    if (!AddSampledLine(*line, sample)) return std::nullopt;
    if (sample.rows.size() == kMaxSampledRows) break;
  }
  // Without the end of a line, the last one may be incomplete; it counts if it is the only one.
  if (sample.rows.empty() && !AddSampledLine(rest, sample)) return std::nullopt;
  const std::optional<ColumnLayout> columns = LayoutOfSample(sample);
  if (!columns || sample.rows.empty()) return std::nullopt;
  sample.layout.columns = *columns;
  return sample.layout;
}

}  // namespace evpose::client
