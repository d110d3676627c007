// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/counted.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"
#include "core/mesh/loading/model_readers.h"
#include "core/mesh/loading/text_lines.h"

namespace evpose {
namespace {

template <typename T>
double LoadNumber(const char* raw) {
  T value;
  std::memcpy(&value, raw, sizeof(T));
  return static_cast<double>(value);
}

struct PlyType {
  absl::string_view name, other_name;
  size_t bytes;
  double (*load)(const char*);  // from the machine's byte order
  bool is_float;
};
constexpr PlyType kPlyTypes[] = {
    {"char", "int8", 1, LoadNumber<int8_t>, false},    {"uchar", "uint8", 1, LoadNumber<uint8_t>, false},
    {"short", "int16", 2, LoadNumber<int16_t>, false}, {"ushort", "uint16", 2, LoadNumber<uint16_t>, false},
    {"int", "int32", 4, LoadNumber<int32_t>, false},   {"uint", "uint32", 4, LoadNumber<uint32_t>, false},
    {"float", "float32", 4, LoadNumber<float>, true},  {"double", "float64", 8, LoadNumber<double>, true}};

absl::StatusOr<const PlyType*> PlyTypeFromWord(absl::string_view word, int64_t line_number) {
  for (const PlyType& type : kPlyTypes) {
    if (word == type.name || word == type.other_name) return &type;
  }
  return LineError(line_number, Quoted(word) + " is not a PLY type");
}

struct PlyProperty {
  const PlyType* type = nullptr;
  const PlyType* count_type = nullptr;  // type of the count, for a list only
  std::string name;

  bool is_list() const { return count_type != nullptr; }
  bool is_corner_list() const { return is_list() && (name == "vertex_indices" || name == "vertex_index"); }
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

// Adds one statement to the header.
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
      return LineError(line_number, Quoted(words[2]) + " is not a count");
    }
    header.elements.push_back(std::move(element));
    return absl::OkStatus();
  }
  if (words[0] == "property" && !header.elements.empty() &&
      (words.size() == 3 || (words.size() == 5 && words[1] == "list"))) {
    PlyProperty property;
    if (words.size() == 5) {
      EVPOSE_ASSIGN_OR_RETURN(property.count_type, PlyTypeFromWord(words[2], line_number));
      if (property.count_type->is_float) {
        return LineError(line_number, "a list cannot be counted by a floating-point number");
      }
    }
    EVPOSE_ASSIGN_OR_RETURN(property.type, PlyTypeFromWord(words[words.size() - 2], line_number));
    property.name = std::string(words.back());
    header.elements.back().properties.push_back(std::move(property));
    return absl::OkStatus();
  }
  return LineError(line_number, absl::StrCat("PLY header: ", Quoted(words[0]), " is not understood here"));
}

constexpr absl::string_view kPlyNormal[] = {"nx", "ny", "nz"};

absl::Status PlyElementError(absl::string_view element, absl::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat("PLY header: element ", absl::CHexEscape(element.substr(0, 40)), ": ", what));
}

absl::Status CheckVertexProperties(const std::vector<PlyProperty>& properties) {
  for (const absl::string_view axis : {"x", "y", "z"}) {
    if (std::none_of(properties.begin(), properties.end(),
                     [&](const PlyProperty& p) { return p.name == axis && !p.is_list(); })) {
      return PlyElementError("vertex", "needs the properties x, y and z");
    }
  }
  const bool has_list = std::any_of(properties.begin(), properties.end(), [](const auto& p) { return p.is_list(); });
  return has_list ? PlyElementError("vertex", "has a list") : absl::OkStatus();
}

absl::Status CheckFaceProperties(const std::vector<PlyProperty>& properties) {
  size_t integer_lists = 0, float_lists = 0;
  for (const PlyProperty& property : properties) {
    if (property.is_corner_list()) ++(property.type->is_float ? float_lists : integer_lists);
  }
  if (integer_lists == 1 && float_lists == 0) return absl::OkStatus();
  return PlyElementError("face", "needs the list vertex_indices, of integers, exactly once");
}

bool IsUsed(const PlyElement& element) { return element.name == "vertex" || element.name == "face"; }

void NoteUnusedElements(const PlyHeader& header, std::vector<std::string>& notices) {
  std::vector<std::string> names;
  for (const PlyElement& element : header.elements) {
    if (!IsUsed(element) && element.count > 0) names.push_back(Escaped(element.name));
  }
  if (names.empty()) return;
  notices.push_back(absl::StrCat(Counted(names.size(), "PLY element"), " other than vertex and face not used: ",
                                 names.front(), names.size() > 1 ? " and others" : ""));
}

// One element `vertex`, then at most one `face`; others are skipped.
absl::Status CheckPlyLayout(const PlyHeader& header) {
  size_t vertex_elements = 0, face_elements = 0;
  for (const PlyElement& element : header.elements) {
    if (element.name == "vertex") {
      if (++vertex_elements > 1) return PlyElementError("vertex", "only one is read");
      EVPOSE_RETURN_IF_ERROR(CheckVertexProperties(element.properties));
    } else if (element.name == "face") {
      if (++face_elements > 1) return PlyElementError("face", "only one is read");
      if (vertex_elements == 0) return PlyElementError("face", "must follow the element vertex");
      EVPOSE_RETURN_IF_ERROR(CheckFaceProperties(element.properties));
    } else if (element.name == "tristrips") {
      return PlyElementError("tristrips", "triangle strips are not read; export the model as faces");
    } else if (element.properties.empty()) {
      return PlyElementError(element.name, "has no property");  // and no size: any number of them would fit in the file
    }
  }
  return vertex_elements == 0 ? PlyElementError("vertex", "missing") : absl::OkStatus();
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

// The numbers of the body one after another, from text or binary data.
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
    return Error("more numbers than the header declares");
  }

  absl::StatusOr<double> Next(const PlyType& type) { return IsAscii() ? NextWord(type) : NextBinary(type); }

  absl::Status End() {
    while (IsAscii()) {
      const std::optional<absl::string_view> line = lines_.Next();
      if (!line) return absl::OkStatus();
      SplitWords(*line, words_);
      if (!words_.empty()) return Error("more lines than the header declares");
    }
    return offset_ == body_.size() ? absl::OkStatus() : Error("more bytes follow than the header declares");
  }

  absl::Status Error(absl::string_view what) const {
    if (IsAscii()) return LineError(header_lines_ + lines_.line_number(), what);
    return absl::InvalidArgumentError(absl::StrCat("body, byte ", offset_, ": ", what));
  }

 private:
  bool IsAscii() const { return format_ == PlyHeader::Format::kAscii; }

  absl::StatusOr<double> NextWord(const PlyType& type) {
    if (next_word_ == words_.size()) return Error("fewer numbers than the header declares");
    const absl::string_view word = words_[next_word_++];
    double value = 0.0;
    int64_t integer = 0;
    if (type.is_float) {
      if (!absl::SimpleAtod(word, &value)) return Error(Quoted(word) + " is not a number");
      return value;
    }
    // A plus sign is refused: other readers stop at it and read 0.
    if (word[0] == '+' || !absl::SimpleAtoi(word, &integer)) return Error(Quoted(word) + " is not a whole number");
    return static_cast<double>(integer);
  }

  absl::StatusOr<double> NextBinary(const PlyType& type) {
    if (body_.size() - offset_ < type.bytes) return Error("the file ends before the elements that its header counts");
    char raw[sizeof(double)];
    std::memcpy(raw, body_.data() + offset_, type.bytes);
    if (format_ == PlyHeader::Format::kBigEndian) std::reverse(raw, raw + type.bytes);
    offset_ += type.bytes;
    return type.load(raw);
  }

  const PlyHeader::Format format_;
  const absl::string_view body_;
  LineReader lines_;
  const int64_t header_lines_;
  std::vector<absl::string_view> words_;
  size_t next_word_ = 0;
  size_t offset_ = 0;
};

bool HasNormals(const std::vector<PlyProperty>& properties) {
  return std::all_of(std::begin(kPlyNormal), std::end(kPlyNormal), [&](absl::string_view name) {
    return std::any_of(properties.begin(), properties.end(), [&](const PlyProperty& p) { return p.name == name; });
  });
}

// The place and the normal of one vertex. The normal is zero if the file has none.
struct PlyVertex {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
};

absl::StatusOr<PlyVertex> ReadPlyVertex(const std::vector<PlyProperty>& properties, PlyBody& body) {
  PlyVertex vertex;
  for (const PlyProperty& property : properties) {
    EVPOSE_ASSIGN_OR_RETURN(const double value, body.Next(*property.type));
    const auto normal = std::find(std::begin(kPlyNormal), std::end(kPlyNormal), property.name);
    if (normal != std::end(kPlyNormal)) vertex.normal[normal - std::begin(kPlyNormal)] = value;
    if (property.name != "x" && property.name != "y" && property.name != "z") continue;
    const float coordinate = static_cast<float>(value);
    if (!std::isfinite(coordinate)) return body.Error(property.name + " is not a finite coordinate");
    vertex.point[property.name[0] - 'x'] = coordinate;
  }
  return vertex;
}

// The properties of one face, which becomes triangles of the mesh. `normals` are those of the vertices, or empty;
// `corners` is a buffer.
absl::Status ReadPlyFace(const std::vector<PlyProperty>& properties, absl::Span<const Eigen::Vector3f> normals,
                         PlyBody& body, ElementCounter& counter, std::vector<uint32_t>& corners, RawMesh& mesh) {
  const double vertices = static_cast<double>(mesh.points.size());
  for (const PlyProperty& property : properties) {
    double count = 1;
    if (property.is_list()) {
      EVPOSE_ASSIGN_OR_RETURN(count, body.Next(*property.count_type));
      if (count < 0) return body.Error("a list of negative length");
    }
    if (property.is_corner_list()) {
      const absl::Status status = counter.AddFace(static_cast<size_t>(count));
      if (!status.ok()) return body.Error(status.message());
      corners.clear();
    }
    for (double i = 0; i < count; ++i) {
      EVPOSE_ASSIGN_OR_RETURN(const double value, body.Next(*property.type));
      if (!property.is_corner_list()) continue;
      if (!(value >= 0 && value < vertices)) {
        return body.Error(
            absl::StrFormat("vertex index %.0f, but there are %.0f vertices (counted from 0)", value, vertices));
      }
      corners.push_back(static_cast<uint32_t>(value));
    }
  }
  std::vector<Eigen::Vector3f> corner_normals;
  if (!normals.empty()) {
    for (const uint32_t corner : corners) corner_normals.push_back(normals[corner]);
  }
  AppendPolygon(corners, mesh, corner_normals);
  return absl::OkStatus();
}

// Reads over the properties of one instance of an element that is not used.
absl::Status SkipPlyInstance(const std::vector<PlyProperty>& properties, PlyBody& body) {
  for (const PlyProperty& property : properties) {
    double count = 1;
    if (property.is_list()) {
      EVPOSE_ASSIGN_OR_RETURN(count, body.Next(*property.count_type));
    }
    for (double i = 0; i < count; ++i) EVPOSE_RETURN_IF_ERROR(body.Next(*property.type).status());
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<RawMesh> ReadPly(absl::Span<const uint8_t> bytes, const MeshLimits& limits) {
  EVPOSE_ASSIGN_OR_RETURN(const absl::string_view text, AsText(bytes));
  EVPOSE_ASSIGN_OR_RETURN(const PlyHeader header, ReadPlyHeader(text));
  PlyBody body(header, text.substr(header.size_bytes));
  ElementCounter counter(limits);
  RawMesh mesh;
  NoteUnusedElements(header, mesh.notices);
  std::vector<Eigen::Vector3f> normals;
  std::vector<uint32_t> corners;
  for (const PlyElement& element : header.elements) {
    const bool has_normals = HasNormals(element.properties);
    const bool is_used = IsUsed(element);
    for (int64_t i = 0; i < element.count; ++i) {
      EVPOSE_RETURN_IF_ERROR(body.BeginInstance());
      if (element.name == "vertex") {
        EVPOSE_ASSIGN_OR_RETURN(const PlyVertex vertex, ReadPlyVertex(element.properties, body));
        mesh.points.push_back(vertex.point);
        if (has_normals) normals.push_back(StatedNormal(vertex.normal));
      } else if (!is_used) {
        EVPOSE_RETURN_IF_ERROR(SkipPlyInstance(element.properties, body));
      } else {
        EVPOSE_RETURN_IF_ERROR(ReadPlyFace(element.properties, normals, body, counter, corners, mesh));
      }
      EVPOSE_RETURN_IF_ERROR(body.EndInstance());
    }
  }
  EVPOSE_RETURN_IF_ERROR(body.End());
  return mesh;
}

}  // namespace evpose
