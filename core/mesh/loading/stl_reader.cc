// SPDX-License-Identifier: Apache-2.0
#include <bit>
#include <iterator>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "core/base/byte_order.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/mesh/loading/model_readers.h"
#include "core/mesh/loading/text_lines.h"

namespace evpose {
namespace {

// The format: 80 bytes of text and a 32-bit facet count; a facet has a normal, three vertices (each three 32-bit
// floats) and a 16-bit attribute. Little endian.
constexpr size_t kStlHeaderBytes = 84;
constexpr size_t kStlFacetBytes = 50;
constexpr size_t kStlNormalBytes = 12;
constexpr size_t kStlVertexBytes = 12;

// Exporters write a few facets with NaN where their own surface is degenerate. More than one in this number of facets
// is a damaged file.
constexpr size_t kLeastFacetsPerInvalid = 100;

// Adds the triangle of the three points appended last.
void AppendFacet(RawMesh& mesh) {
  const uint32_t end = static_cast<uint32_t>(mesh.points.size());
  mesh.triangles.push_back({end - 3, end - 2, end - 1});
}

absl::StatusOr<RawMesh> ReadBinaryStl(absl::Span<const uint8_t> bytes, ElementCounter counter) {
  RawMesh mesh;
  const size_t facets = (bytes.size() - kStlHeaderBytes) / kStlFacetBytes;
  size_t first_dropped = 0, dropped = 0;  // facets; the first from 1
  for (size_t facet = 0; facet < facets; ++facet) {
    const uint8_t* vertex = bytes.data() + kStlHeaderBytes + facet * kStlFacetBytes + kStlNormalBytes;
    bool is_finite = true;
    for (int corner = 0; corner < 3; ++corner, vertex += kStlVertexBytes) {
      Eigen::Vector3d& point = mesh.points.emplace_back();
      for (Eigen::Index i = 0; i < 3; ++i) point[i] = std::bit_cast<float>(LoadLittleEndian<uint32_t>(vertex + 4 * i));
      is_finite = is_finite && point.allFinite();
    }
    EVPOSE_RETURN_IF_ERROR(counter.AddFace(3));
    if (is_finite) {
      AppendFacet(mesh);
      continue;
    }
    mesh.points.resize(mesh.points.size() - 3);
    if (dropped++ == 0) first_dropped = facet + 1;
  }
  if (dropped == 0) return mesh;
  const std::string what = absl::StrCat(Counted(dropped, "facet"), " with a coordinate that is not a finite number");
  if (kLeastFacetsPerInvalid * dropped > facets) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "%s, the first one facet %d of %d: the file is damaged; export it again", what, first_dropped, facets));
  }
  mesh.notices.push_back(absl::StrFormat("%s dropped, the first one facet %d", what, first_dropped));
  return mesh;
}

// A line of an ASCII facet: its words, in upper or lower case, and how many numbers follow them.
struct StlStatement {
  absl::string_view words;
  size_t numbers;
};
constexpr absl::string_view kStlVertex = "vertex";
constexpr StlStatement kStlFacet[] = {{"facet normal", 3}, {"outer loop", 0}, {kStlVertex, 3}, {kStlVertex, 3},
                                      {kStlVertex, 3},     {"endloop", 0},    {"endfacet", 0}};

absl::Status ReadStlStatement(const StlStatement& expected, const std::vector<absl::string_view>& words,
                              int64_t line_number, RawMesh& mesh) {
  const bool matches =
      words.size() > expected.numbers &&
      absl::EqualsIgnoreCase(absl::StrJoin(words.begin(), words.end() - expected.numbers, " "), expected.words);
  if (!matches) {
    return LineError(line_number, absl::StrCat("STL: expected '", expected.words, "'",
                                               expected.numbers > 0 ? " and 3 numbers" : ""));
  }
  // The numbers of a facet's first line are its normal, which is ignored; some writers leave NaN there.
  if (expected.words != kStlVertex) return absl::OkStatus();
  Eigen::Vector3d& point = mesh.points.emplace_back();
  for (int i = 0; i < 3; ++i) {
    EVPOSE_ASSIGN_OR_RETURN(point[i], ReadCoordinate(words[i + 1], line_number));
  }
  return absl::OkStatus();
}

absl::StatusOr<RawMesh> ReadAsciiStl(absl::string_view text, ElementCounter counter) {
  RawMesh mesh;
  LineReader lines(text);
  std::vector<absl::string_view> words;
  bool in_solid = false;
  size_t step = 0;  // number of the line within a facet
  while (const std::optional<absl::string_view> line = lines.Next()) {
    SplitWords(*line, words);
    if (words.empty()) continue;
    if (step == 0 && absl::EqualsIgnoreCase(words[0], in_solid ? "endsolid" : "solid")) {
      in_solid = !in_solid;
      continue;
    }
    if (!in_solid) return LineError(lines.line_number(), "STL: expected 'solid'");
    EVPOSE_RETURN_IF_ERROR(ReadStlStatement(kStlFacet[step], words, lines.line_number(), mesh));
    if (++step < std::size(kStlFacet)) continue;
    step = 0;
    EVPOSE_RETURN_IF_ERROR(LineError(lines.line_number(), counter.AddFace(3)));
    AppendFacet(mesh);
  }
  if (in_solid) return absl::InvalidArgumentError("STL: ends without 'endsolid'; the file is cut off");
  return mesh;
}

}  // namespace

absl::StatusOr<RawMesh> ReadStl(absl::Span<const uint8_t> bytes, const MeshLimits& limits) {
  const bool has_binary_size =
      bytes.size() >= kStlHeaderBytes &&
      bytes.size() ==
          kStlHeaderBytes + kStlFacetBytes * static_cast<size_t>(LoadLittleEndian<uint32_t>(bytes.data() + 80));
  if (has_binary_size) return ReadBinaryStl(bytes, ElementCounter(limits));
  EVPOSE_ASSIGN_OR_RETURN(const absl::string_view text, AsText(bytes));
  // Text has no zero byte; some binary files begin with 'solid', too.
  if (bytes.size() >= kStlHeaderBytes && text.find('\0') != absl::string_view::npos) {
    const uint64_t facets = LoadLittleEndian<uint32_t>(bytes.data() + 80);
    return absl::InvalidArgumentError(absl::StrFormat(
        "binary STL: the header states %s, which take %d bytes, but the file has %d: it is incomplete or no STL file",
        Counted(facets, "facet"), kStlHeaderBytes + kStlFacetBytes * facets, bytes.size()));
  }
  if (absl::StartsWithIgnoreCase(absl::StripLeadingAsciiWhitespace(text), "solid")) {
    return ReadAsciiStl(text, ElementCounter(limits));
  }
  return absl::InvalidArgumentError(
      "not an STL file: it neither begins with 'solid' nor has the size that its binary header gives");
}

}  // namespace evpose
