// SPDX-License-Identifier: Apache-2.0
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/mesh/loading/model_readers.h"
#include "core/mesh/loading/text_lines.h"

namespace evpose {
namespace {

class ObjReader {
 public:
  explicit ObjReader(const MeshLimits& limits) : counter_(limits) {}

  absl::StatusOr<RawMesh> Read(absl::string_view text) {
    if (text.find('\0') != absl::string_view::npos) {
      return absl::InvalidArgumentError("contains zero bytes: not an OBJ text file");
    }
    LineReader lines(text);
    while (std::optional<absl::string_view> line = lines.Next()) {
      line_number_ = lines.line_number();
      EVPOSE_RETURN_IF_ERROR(ReadStatement(WholeLine(*line, lines)));
    }
    if (largest_index_ > static_cast<int64_t>(vertices_.size())) {
      return LineError(largest_index_line_,
                       absl::StrFormat("vertex index %d, but there are %d vertices", largest_index_, vertices_.size()));
    }
    return MakeMesh();
  }

 private:
  // A face or polyline: its indices end there in `indices_` and begin where those of the element before end.
  struct Element {
    bool is_face;
    size_t end;
  };

  // The line without its comment, together with the lines that continue it.
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

  absl::Status ReadStatement(absl::string_view line) {
    SplitWords(line, words_);
    if (words_.empty()) return absl::OkStatus();
    if (words_[0] == "v") return ReadVertex();
    const bool is_face = words_[0] == "f";
    if (!is_face && words_[0] != "l") return absl::OkStatus();
    if (!is_face && words_.size() < 3) return LineError(line_number_, "a line element (l) needs 2 points");
    EVPOSE_RETURN_IF_ERROR(
        LineError(line_number_, is_face ? counter_.AddFace(words_.size() - 1) : counter_.AddLines(words_.size() - 2)));
    return ReadIndices(is_face);
  }

  absl::Status ReadVertex() {
    if (words_.size() < 4) {
      return LineError(line_number_, absl::StrFormat("a vertex (v) needs 3 numbers, found %d", words_.size() - 1));
    }
    Eigen::Vector3d& vertex = vertices_.emplace_back();
    for (int i = 0; i < 3; ++i) {
      EVPOSE_ASSIGN_OR_RETURN(vertex[i], ReadCoordinate(words_[i + 1], line_number_));
    }
    return absl::OkStatus();
  }

  absl::Status ReadIndices(bool is_face) {
    const int64_t vertices_so_far = static_cast<int64_t>(vertices_.size());
    for (size_t i = 1; i < words_.size(); ++i) {
      int64_t index;
      if (!absl::SimpleAtoi(words_[i].substr(0, words_[i].find('/')), &index)) {
        return LineError(line_number_, Quoted(words_[i]) + " is not a vertex index");
      }
      if (index == 0) return LineError(line_number_, "vertex index 0, but OBJ counts from 1");
      const int64_t absolute = index > 0 ? index : vertices_so_far + 1 + index;
      if (absolute < 1) {
        return LineError(line_number_,
                         absl::StrFormat("vertex index %d, but there are %d vertices so far", index, vertices_so_far));
      }
      if (absolute > largest_index_) {
        largest_index_ = absolute;
        largest_index_line_ = line_number_;
      }
      indices_.push_back(absolute);
    }
    elements_.push_back({is_face, indices_.size()});
    return absl::OkStatus();
  }

  RawMesh MakeMesh() const {
    constexpr uint32_t kUnused = ~0u;
    std::vector<uint32_t> point_of_vertex(vertices_.size(), kUnused);
    RawMesh mesh;
    std::vector<uint32_t> points;
    size_t begin = 0;
    for (const Element& element : elements_) {
      points.clear();
      for (; begin < element.end; ++begin) {
        const size_t vertex = static_cast<size_t>(indices_[begin] - 1);
        uint32_t& point = point_of_vertex[vertex];
        if (point == kUnused) {
          point = static_cast<uint32_t>(mesh.points.size());
          mesh.points.push_back(vertices_[vertex]);
        }
        points.push_back(point);
      }
      if (element.is_face) {
        AppendPolygon(points, mesh);
        continue;
      }
      for (size_t i = 1; i < points.size(); ++i) mesh.lines.push_back({points[i - 1], points[i]});
    }
    return mesh;
  }

  ElementCounter counter_;
  std::string joined_;
  std::vector<absl::string_view> words_;
  int64_t line_number_ = 0;
  std::vector<Eigen::Vector3d> vertices_;
  std::vector<int64_t> indices_;  // from 1, of all elements; compared with the number of vertices at the end only
  std::vector<Element> elements_;
  int64_t largest_index_ = 0;
  int64_t largest_index_line_ = 0;
};

}  // namespace

absl::StatusOr<RawMesh> ReadObj(absl::Span<const uint8_t> bytes, const MeshLimits& limits) {
  return ObjReader(limits).Read(AsText(bytes));
}

}  // namespace evpose
