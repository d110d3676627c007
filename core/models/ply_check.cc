// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/models/model_file_check.h"
#include "core/models/text_lines.h"

namespace evpose {
namespace {

enum class PlyType { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };

absl::StatusOr<PlyType> PlyTypeFromWord(absl::string_view word, int64_t line_number) {
  if (word == "char" || word == "int8") return PlyType::kInt8;
  if (word == "uchar" || word == "uint8") return PlyType::kUint8;
  if (word == "short" || word == "int16") return PlyType::kInt16;
  if (word == "ushort" || word == "uint16") return PlyType::kUint16;
  if (word == "int" || word == "int32") return PlyType::kInt32;
  if (word == "uint" || word == "uint32") return PlyType::kUint32;
  if (word == "float" || word == "float32") return PlyType::kFloat;
  if (word == "double" || word == "float64") return PlyType::kDouble;
  return LineError(line_number, absl::StrCat("'", word.substr(0, 40), "' is not a PLY type"));
}

bool IsFloat(PlyType type) { return type == PlyType::kFloat || type == PlyType::kDouble; }

size_t SizeOf(PlyType type) {
  switch (type) {
    case PlyType::kInt8:
    case PlyType::kUint8:
      return 1;
    case PlyType::kInt16:
    case PlyType::kUint16:
      return 2;
    case PlyType::kInt32:
    case PlyType::kUint32:
    case PlyType::kFloat:
      return 4;
    case PlyType::kDouble:
      return 8;
  }
  return 8;
}

struct PlyProperty {
  PlyType type = PlyType::kFloat;
  bool is_list = false;
  PlyType count_type = PlyType::kUint8;
  std::string name;
};

struct PlyElement {
  std::string name;
  int64_t count = 0;
  std::vector<PlyProperty> properties;
};

struct PlyHeader {
  enum class Format { kNone, kAscii, kLittleEndian, kBigEndian } format = Format::kNone;
  std::vector<PlyElement> elements;
  size_t size_bytes = 0;
  int64_t lines = 0;
};

// One statement of the header.
absl::Status ReadPlyStatement(const std::vector<absl::string_view>& words, int64_t line_number, PlyHeader& header) {
  if (words.empty() || words[0] == "comment" || words[0] == "obj_info") return absl::OkStatus();
  if (words[0] == "format" && words.size() == 3) {
    using Format = PlyHeader::Format;
    header.format = words[1] == "ascii"                  ? Format::kAscii
                    : words[1] == "binary_little_endian" ? Format::kLittleEndian
                    : words[1] == "binary_big_endian"    ? Format::kBigEndian
                                                         : Format::kNone;
    if (header.format != Format::kNone) return absl::OkStatus();
  }
  if (words[0] == "element" && words.size() == 3) {
    PlyElement element{std::string(words[1]), 0, {}};
    if (!absl::SimpleAtoi(words[2], &element.count) || element.count < 0) {
      return LineError(line_number, absl::StrCat("'", words[2].substr(0, 40), "' is not a count"));
    }
    header.elements.push_back(std::move(element));
    return absl::OkStatus();
  }
  if (words[0] == "property" && !header.elements.empty() &&
      (words.size() == 3 || (words.size() == 5 && words[1] == "list"))) {
    PlyProperty property;
    property.is_list = words.size() == 5;
    if (property.is_list) {
      EVPOSE_ASSIGN_OR_RETURN(property.count_type, PlyTypeFromWord(words[2], line_number));
      if (IsFloat(property.count_type))
        return LineError(line_number, "a list cannot be counted by a floating-point number");
    }
    EVPOSE_ASSIGN_OR_RETURN(property.type, PlyTypeFromWord(words[words.size() - 2], line_number));
    property.name = std::string(words.back());
    header.elements.back().properties.push_back(std::move(property));
    return absl::OkStatus();
  }
  return LineError(line_number, absl::StrCat("PLY header: '", words[0].substr(0, 40), "' is not understood here"));
}

// Exactly one `vertex` with x, y, z, then at most one `face` with its list of corners; nothing else that has instances.
absl::Status CheckPlyLayout(const PlyHeader& header) {
  bool has_vertices = false, has_faces = false;
  for (const PlyElement& element : header.elements) {
    const auto has = [&](absl::string_view name, bool is_list) {
      for (const PlyProperty& p : element.properties) {
        if (p.name == name && p.is_list == is_list && (!is_list || !IsFloat(p.type))) return true;
      }
      return false;
    };
    if (element.name == "vertex" && !has_vertices) {
      has_vertices = true;
      if (!has("x", false) || !has("y", false) || !has("z", false)) {
        return absl::InvalidArgumentError("PLY header: element vertex: needs the properties x, y and z");
      }
      for (const PlyProperty& property : element.properties) {
        if (property.is_list) return absl::InvalidArgumentError("PLY header: element vertex: has a list");
      }
      continue;
    }
    if (element.name == "face" && has_vertices && !has_faces) {
      has_faces = true;
      if (!has("vertex_indices", true) && !has("vertex_index", true)) {
        return absl::InvalidArgumentError("PLY header: element face: needs the list vertex_indices, of integers");
      }
      continue;
    }
    return absl::InvalidArgumentError(
        absl::StrCat("PLY header: element ", element.name.substr(0, 40),
                     ": only one vertex and then one face element are read; export those"));
  }
  if (!has_vertices) return absl::InvalidArgumentError("PLY header: element vertex: missing");
  return absl::OkStatus();
}

absl::StatusOr<PlyHeader> ReadPlyHeader(absl::string_view text) {
  LineReader lines(text);
  if (lines.Next() != "ply") return absl::InvalidArgumentError("line 1: not a PLY file, which begins with 'ply'");
  PlyHeader header;
  std::vector<absl::string_view> words;
  while (const std::optional<absl::string_view> line = lines.Next()) {
    SplitWords(*line, words);
    if (words.size() == 1 && words[0] == "end_header") {
      header.size_bytes = lines.offset();
      header.lines = lines.line_number();
      if (header.format == PlyHeader::Format::kNone) return absl::InvalidArgumentError("PLY header: no format");
      EVPOSE_RETURN_IF_ERROR(CheckPlyLayout(header));
      return header;
    }
    EVPOSE_RETURN_IF_ERROR(ReadPlyStatement(words, lines.line_number(), header));
  }
  return absl::InvalidArgumentError("PLY header: ends without end_header; the file is cut off");
}

// Numbers of the body, one after the other, from text or binary.
class PlyBody {
 public:
  PlyBody(const PlyHeader& header, absl::string_view body)
      : format_(header.format), body_(body), lines_(body), header_lines_(header.lines) {}

  absl::Status BeginInstance() {
    if (!IsAscii()) return absl::OkStatus();
    const std::optional<absl::string_view> line = lines_.Next();
    if (!line) return absl::InvalidArgumentError("the file ends before the elements that its header counts");
    SplitWords(*line, words_);
    next_word_ = 0;
    return absl::OkStatus();
  }

  absl::Status EndInstance() const {
    if (!IsAscii() || next_word_ == words_.size()) return absl::OkStatus();
    return Error("more numbers than the header says");
  }

  absl::StatusOr<double> Next(PlyType type) { return IsAscii() ? NextWord(type) : NextBinary(type); }

  absl::Status End() {
    while (IsAscii()) {
      const std::optional<absl::string_view> line = lines_.Next();
      if (!line) return absl::OkStatus();
      SplitWords(*line, words_);
      if (!words_.empty()) return Error("more lines than the header says");
    }
    return offset_ == body_.size() ? absl::OkStatus() : Error("more bytes follow than the header says");
  }

  absl::Status Error(absl::string_view what) const {
    if (IsAscii()) return LineError(header_lines_ + lines_.line_number(), what);
    return absl::InvalidArgumentError(absl::StrCat("body, byte ", offset_, ": ", what));
  }

 private:
  bool IsAscii() const { return format_ == PlyHeader::Format::kAscii; }

  absl::StatusOr<double> NextWord(PlyType type) {
    if (next_word_ == words_.size()) return Error("fewer numbers than the header says");
    const absl::string_view word = words_[next_word_++];
    double value = 0.0;
    int64_t integer = 0;
    // Assimp reads "+3" as 0, and a face of no corner ends its process.
    const bool is_number =
        IsFloat(type) ? absl::SimpleAtod(word, &value) : word[0] != '+' && absl::SimpleAtoi(word, &integer);
    if (!is_number) {
      return Error(absl::StrCat("'", word.substr(0, 40), "' is not ", IsFloat(type) ? "a number" : "a whole number"));
    }
    return IsFloat(type) ? value : static_cast<double>(integer);
  }

  template <typename T>
  double Load() {
    char raw[sizeof(T)];
    std::memcpy(raw, body_.data() + offset_, sizeof(T));
    if (format_ == PlyHeader::Format::kBigEndian) std::reverse(raw, raw + sizeof(T));
    offset_ += sizeof(T);
    T value;
    std::memcpy(&value, raw, sizeof(T));
    return static_cast<double>(value);
  }

  absl::StatusOr<double> NextBinary(PlyType type) {
    if (body_.size() - offset_ < SizeOf(type)) return Error("the file ends before the elements that its header counts");
    switch (type) {
      case PlyType::kInt8:
        return Load<int8_t>();
      case PlyType::kUint8:
        return Load<uint8_t>();
      case PlyType::kInt16:
        return Load<int16_t>();
      case PlyType::kUint16:
        return Load<uint16_t>();
      case PlyType::kInt32:
        return Load<int32_t>();
      case PlyType::kUint32:
        return Load<uint32_t>();
      case PlyType::kFloat:
        return Load<float>();
      case PlyType::kDouble:
        return Load<double>();
    }
    return Error("unknown type");
  }

  const PlyHeader::Format format_;
  const absl::string_view body_;
  LineReader lines_;
  const int64_t header_lines_;
  std::vector<absl::string_view> words_;
  size_t next_word_ = 0;
  size_t offset_ = 0;
};

absl::Status CheckPlyProperty(const PlyElement& element, const PlyProperty& property, int64_t vertices, PlyBody& body,
                              ModelFileCounter& counter) {
  const bool is_corners = property.is_list && (property.name == "vertex_indices" || property.name == "vertex_index");
  const bool is_coordinate =
      element.name == "vertex" && (property.name == "x" || property.name == "y" || property.name == "z");
  double count = 1;
  if (property.is_list) {
    EVPOSE_ASSIGN_OR_RETURN(count, body.Next(property.count_type));
    if (count < 0) return body.Error("a list of negative length");
  }
  if (is_corners) {
    const absl::Status status = counter.AddFace(static_cast<size_t>(count));
    if (!status.ok()) return body.Error(status.message());
  }
  for (double i = 0; i < count; ++i) {
    EVPOSE_ASSIGN_OR_RETURN(const double value, body.Next(property.type));
    if (is_corners && !(value >= 0 && value < static_cast<double>(vertices))) {
      return body.Error(
          absl::StrFormat("vertex index %.0f, but there are %d vertices (counted from 0)", value, vertices));
    }
    if (is_coordinate && !std::isfinite(static_cast<float>(value))) {
      return body.Error(absl::StrCat(property.name, " is not a finite coordinate"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<CheckedModelFile> CheckPly(absl::Span<const uint8_t> bytes, const ModelFileLimits& limits) {
  EVPOSE_ASSIGN_OR_RETURN(const PlyHeader header, ReadPlyHeader(AsText(bytes)));
  PlyBody body(header, AsText(bytes).substr(header.size_bytes));
  ModelFileCounter counter(limits);
  const int64_t vertices = header.elements.front().count;
  for (const PlyElement& element : header.elements) {
    for (int64_t i = 0; i < element.count; ++i) {
      EVPOSE_RETURN_IF_ERROR(body.BeginInstance());
      for (const PlyProperty& property : element.properties) {
        EVPOSE_RETURN_IF_ERROR(CheckPlyProperty(element, property, vertices, body, counter));
      }
      EVPOSE_RETURN_IF_ERROR(body.EndInstance());
    }
  }
  EVPOSE_RETURN_IF_ERROR(body.End());
  return CheckedModelFile{{}, counter.faces(), 0};
}

}  // namespace evpose
