// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/match.h"
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
    if (elements_.empty() && !vertices_.empty()) {
      return absl::InvalidArgumentError(absl::StrCat("the OBJ file has ",
                                                     Counted(vertices_.size(), "vertex (v)", "vertices (v)"),
                                                     " but no face (f) and no line element (l): it is incomplete, or a "
                                                     "cloud of points, which has no surface; export the "
                                                     "faces of the object, or compute a mesh from the points"));
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
    if (words_[0] == "vn") return ReadNormal();
    if (words_[0] == "p") num_points_ += words_.size() - 1;
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

  // Exporters write words such as "-nan(ind)" for the normals of faces without area: they count as no normal.
  absl::Status ReadNormal() {
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    for (size_t i = 0; i < 3; ++i) {
      if (i + 1 >= words_.size() || !absl::SimpleAtod(words_[i + 1], &normal[static_cast<Eigen::Index>(i)])) {
        normal.setZero();
        break;
      }
    }
    normals_.push_back(StatedNormal(normal));
    return absl::OkStatus();
  }

  // The index of the normal in a word such as 1//3 or 1/2/3, counted from 1; 0 without one. It may be that of a later
  // normal or of none at all, which MakeMesh() finds.
  int64_t NormalIndex(absl::string_view word) const {
    const size_t first = word.find('/');
    const size_t second = first == absl::string_view::npos ? first : word.find('/', first + 1);
    int64_t index;
    if (second == absl::string_view::npos || !absl::SimpleAtoi(word.substr(second + 1), &index)) return 0;
    return index >= 0 ? index : std::max<int64_t>(0, static_cast<int64_t>(normals_.size()) + 1 + index);
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
      const int64_t normal = NormalIndex(words_[i]);
      // The list begins with the first normal that a corner refers to: most files have none.
      if (normal > 0) normal_indices_.resize(indices_.size() - 1);
      if (normal > 0 || !normal_indices_.empty()) normal_indices_.push_back(normal);
    }
    elements_.push_back({is_face, indices_.size()});
    return absl::OkStatus();
  }

  bool HasNormals() const { return !normal_indices_.empty() && !normals_.empty(); }

  // Zero for a corner without a normal, or with an index that no normal has.
  Eigen::Vector3f NormalOfCorner(size_t corner) const {
    const int64_t index = corner < normal_indices_.size() ? normal_indices_[corner] : 0;
    const bool is_known = index > 0 && index <= static_cast<int64_t>(normals_.size());
    return is_known ? normals_[static_cast<size_t>(index - 1)] : Eigen::Vector3f(Eigen::Vector3f::Zero());
  }

  RawMesh MakeMesh() const {
    constexpr uint32_t kUnused = ~0u;
    std::vector<uint32_t> point_of_vertex(vertices_.size(), kUnused);
    RawMesh mesh;
    if (num_points_ > 0) {
      mesh.notices.push_back(absl::StrCat(Counted(num_points_, "point element"),
                                          " (p) of the file not used: single points have no visible edges"));
    }
    std::vector<uint32_t> points;
    std::vector<Eigen::Vector3f> normals;
    size_t begin = 0;
    for (const Element& element : elements_) {
      points.clear();
      normals.clear();
      for (; begin < element.end; ++begin) {
        if (HasNormals()) normals.push_back(NormalOfCorner(begin));
        const size_t vertex = static_cast<size_t>(indices_[begin] - 1);
        uint32_t& point = point_of_vertex[vertex];
        if (point == kUnused) {
          point = static_cast<uint32_t>(mesh.points.size());
          mesh.points.push_back(vertices_[vertex]);
        }
        points.push_back(point);
      }
      if (element.is_face) {
        AppendPolygon(points, mesh, normals);
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
  std::vector<Eigen::Vector3f> normals_;
  std::vector<int64_t> indices_;  // from 1, of all elements; compared with the number of vertices at the end only
  std::vector<int64_t> normal_indices_;  // for each index of `indices_`: from 1, 0 for none; empty if no corner has one
  std::vector<Element> elements_;
  size_t num_points_ = 0;  // of statements p
  int64_t largest_index_ = 0;
  int64_t largest_index_line_ = 0;
};

}  // namespace

absl::StatusOr<RawMesh> ReadObj(absl::Span<const uint8_t> bytes, const MeshLimits& limits) {
  EVPOSE_ASSIGN_OR_RETURN(const absl::string_view text, AsText(bytes));
  return ObjReader(limits).Read(text);
}

}  // namespace evpose
