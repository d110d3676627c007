// SPDX-License-Identifier: Apache-2.0
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/models/model_file_check.h"
#include "core/models/text_lines.h"

namespace evpose {
namespace {

class ObjChecker {
 public:
  explicit ObjChecker(const ModelFileLimits& limits) : counter_(limits) {}

  absl::StatusOr<CheckedModelFile> Check(absl::string_view text) {
    if (text.find('\0') != absl::string_view::npos) {
      return absl::InvalidArgumentError("holds zero bytes: not an OBJ text file");
    }
    LineReader lines(text);
    while (std::optional<absl::string_view> line = lines.Next()) {
      line_number_ = lines.line_number();
      EVPOSE_RETURN_IF_ERROR(CheckStatement(WholeLine(*line, lines)));
    }
    if (largest_index_ > vertices_) {
      return LineError(largest_index_line_,
                       absl::StrFormat("vertex index %d, but there are %d vertices", largest_index_, vertices_));
    }
    return CheckedModelFile{std::move(out_), counter_.faces(), counter_.lines()};
  }

 private:
  // Without its comment, and with the lines that a backslash at its end continues.
  absl::string_view WholeLine(absl::string_view line, LineReader& lines) {
    line = line.substr(0, line.find('#'));
    if (!absl::EndsWith(line, "\\")) return line;
    joined_.clear();
    while (absl::EndsWith(line, "\\")) {
      absl::StrAppend(&joined_, line.substr(0, line.size() - 1), " ");
      line = lines.Next().value_or(absl::string_view());
      line = line.substr(0, line.find('#'));
    }
    absl::StrAppend(&joined_, line);
    return joined_;
  }

  absl::Status CheckStatement(absl::string_view line) {
    SplitWords(line, words_);
    if (words_.empty()) return absl::OkStatus();
    if (words_[0] == "v") return CheckVertex();
    if (words_[0] == "f") {
      EVPOSE_RETURN_IF_ERROR(LineError(line_number_, counter_.AddFace(words_.size() - 1)));
      return CopyIndices();
    }
    if (words_[0] == "l") {
      if (words_.size() < 3) return LineError(line_number_, "a line element (l) needs 2 points");
      EVPOSE_RETURN_IF_ERROR(LineError(line_number_, counter_.AddLines(words_.size() - 2)));
      return CopyIndices();
    }
    return absl::OkStatus();
  }

  absl::Status CheckVertex() {
    if (words_.size() < 4) {
      return LineError(line_number_, absl::StrFormat("a vertex (v) needs 3 numbers, found %d", words_.size() - 1));
    }
    out_ += 'v';
    for (int i = 1; i <= 3; ++i) {
      EVPOSE_ASSIGN_OR_RETURN(const float coordinate, ReadCoordinate(words_[i], line_number_));
      absl::StrAppendFormat(&out_, " %.9g", coordinate);  // not as written: Assimp skips a vertex that has ".5"
    }
    out_ += '\n';
    ++vertices_;
    return absl::OkStatus();
  }

  absl::Status CopyIndices() {
    absl::StrAppend(&out_, words_[0]);
    for (size_t i = 1; i < words_.size(); ++i) {
      int64_t index;
      if (!absl::SimpleAtoi(words_[i].substr(0, words_[i].find('/')), &index)) {
        return LineError(line_number_, absl::StrCat("'", words_[i].substr(0, 40), "' is not a vertex index"));
      }
      if (index == 0) return LineError(line_number_, "vertex index 0, but OBJ counts from 1");
      const int64_t absolute = index > 0 ? index : vertices_ + 1 + index;
      if (absolute < 1) {
        return LineError(line_number_,
                         absl::StrFormat("vertex index %d, but there are %d vertices so far", index, vertices_));
      }
      if (absolute > largest_index_) {
        largest_index_ = absolute;
        largest_index_line_ = line_number_;
      }
      absl::StrAppend(&out_, " ", absolute);
    }
    out_ += '\n';
    return absl::OkStatus();
  }

  ModelFileCounter counter_;
  std::string out_;
  std::string joined_;
  std::vector<absl::string_view> words_;
  int64_t line_number_ = 0;
  int64_t vertices_ = 0;
  int64_t largest_index_ = 0;
  int64_t largest_index_line_ = 0;
};

}  // namespace

absl::StatusOr<CheckedModelFile> CheckObj(absl::Span<const uint8_t> bytes, const ModelFileLimits& limits) {
  return ObjChecker(limits).Check(AsText(bytes));
}

}  // namespace evpose
