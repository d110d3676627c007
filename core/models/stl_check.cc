// SPDX-License-Identifier: Apache-2.0
#include <bit>
#include <cmath>
#include <iterator>
#include <optional>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/models/model_file_check.h"
#include "core/models/text_lines.h"

namespace evpose {
namespace {

constexpr size_t kStlHeaderBytes = 84;
constexpr size_t kStlFacetBytes = 50;

uint32_t LittleEndian32(const uint8_t* bytes) {
  return bytes[0] | bytes[1] << 8 | bytes[2] << 16 | static_cast<uint32_t>(bytes[3]) << 24;
}

absl::StatusOr<CheckedModelFile> CheckBinaryStl(absl::Span<const uint8_t> bytes, ModelFileCounter counter) {
  const size_t facets = (bytes.size() - kStlHeaderBytes) / kStlFacetBytes;
  for (size_t facet = 0; facet < facets; ++facet) {
    const uint8_t* vertices = bytes.data() + kStlHeaderBytes + facet * kStlFacetBytes + 12;
    for (int i = 0; i < 9; ++i) {
      if (std::isfinite(std::bit_cast<float>(LittleEndian32(vertices + 4 * i)))) continue;
      return absl::InvalidArgumentError(absl::StrFormat("facet %d: a coordinate is not a finite number", facet + 1));
    }
    EVPOSE_RETURN_IF_ERROR(counter.AddFace(3));
  }
  return CheckedModelFile{{}, counter.faces(), 0};
}

// A line of an ASCII facet: its words, and how many coordinates follow them.
struct StlStatement {
  const char* words[2];
  size_t word_count;
  size_t numbers;
};
constexpr StlStatement kStlFacet[] = {{{"facet", "normal"}, 2, 3}, {{"outer", "loop"}, 2, 0}, {{"vertex", ""}, 1, 3},
                                      {{"vertex", ""}, 1, 3},      {{"vertex", ""}, 1, 3},    {{"endloop", ""}, 1, 0},
                                      {{"endfacet", ""}, 1, 0}};

absl::Status CheckStlStatement(const StlStatement& expected, const std::vector<absl::string_view>& words,
                               int64_t line_number) {
  bool matches = words.size() == expected.word_count + expected.numbers;
  for (size_t i = 0; matches && i < expected.word_count; ++i) matches = words[i] == expected.words[i];
  if (!matches) {
    return LineError(line_number,
                     absl::StrFormat("STL: expected '%s%s%s'%s", expected.words[0], expected.word_count > 1 ? " " : "",
                                     expected.words[1], expected.numbers > 0 ? " and 3 numbers" : ""));
  }
  // The normal is not used; some writers leave NaN there.
  if (expected.word_count == 2) return absl::OkStatus();
  for (size_t i = expected.word_count; i < words.size(); ++i) {
    EVPOSE_RETURN_IF_ERROR(ReadCoordinate(words[i], line_number).status());
  }
  return absl::OkStatus();
}

absl::StatusOr<CheckedModelFile> CheckAsciiStl(absl::string_view text, ModelFileCounter counter) {
  LineReader lines(text);
  std::vector<absl::string_view> words;
  bool in_solid = false;
  size_t step = 0;  // within a facet
  while (const std::optional<absl::string_view> line = lines.Next()) {
    SplitWords(*line, words);
    if (words.empty()) continue;
    if (step == 0 && words[0] == (in_solid ? "endsolid" : "solid")) {
      in_solid = !in_solid;
      continue;
    }
    if (!in_solid) return LineError(lines.line_number(), "STL: expected 'solid'");
    EVPOSE_RETURN_IF_ERROR(CheckStlStatement(kStlFacet[step], words, lines.line_number()));
    if (++step < std::size(kStlFacet)) continue;
    step = 0;
    EVPOSE_RETURN_IF_ERROR(LineError(lines.line_number(), counter.AddFace(3)));
  }
  if (in_solid) return absl::InvalidArgumentError("STL: ends without 'endsolid'; the file is cut off");
  return CheckedModelFile{{}, counter.faces(), 0};
}

}  // namespace

absl::StatusOr<CheckedModelFile> CheckStl(absl::Span<const uint8_t> bytes, const ModelFileLimits& limits) {
  const bool has_binary_size =
      bytes.size() >= kStlHeaderBytes &&
      bytes.size() == kStlHeaderBytes + kStlFacetBytes * static_cast<size_t>(LittleEndian32(bytes.data() + 80));
  if (has_binary_size) return CheckBinaryStl(bytes, ModelFileCounter(limits));
  if (absl::StartsWith(AsText(bytes), "solid")) return CheckAsciiStl(AsText(bytes), ModelFileCounter(limits));
  return absl::InvalidArgumentError(
      "not an STL file: it neither begins with 'solid' nor has the size that its binary header gives");
}

}  // namespace evpose
