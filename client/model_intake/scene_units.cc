// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/scene_units.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "core/mesh/loading/text_lines.h"

namespace evpose::client {
namespace {

// The asset element, with the unit, is near the beginning of a COLLADA file.
constexpr size_t kHeadBytes = size_t{64} << 10;

// The value of an attribute of the first element of this name; nullopt if there is none.
std::optional<std::string> Attribute(absl::string_view xml, absl::string_view element, absl::string_view name) {
  size_t begin = 0;
  do {
    begin = xml.find(absl::StrCat("<", element), begin);
    if (begin == absl::string_view::npos) return std::nullopt;
    begin += element.size() + 1;
  } while (begin < xml.size() && !absl::ascii_isspace(xml[begin]));
  absl::string_view rest = absl::StripLeadingAsciiWhitespace(xml.substr(begin));
  while (!rest.empty() && rest[0] != '>' && rest[0] != '/') {
    const size_t sign = rest.find('=');
    if (sign == absl::string_view::npos) return std::nullopt;
    const absl::string_view found = absl::StripTrailingAsciiWhitespace(rest.substr(0, sign));
    rest = absl::StripLeadingAsciiWhitespace(rest.substr(sign + 1));
    if (rest.empty() || (rest[0] != '"' && rest[0] != '\'')) return std::nullopt;
    const size_t end = rest.find(rest[0], 1);
    if (end == absl::string_view::npos) return std::nullopt;
    if (found == name) return std::string(rest.substr(1, end - 1));
    rest = absl::StripLeadingAsciiWhitespace(rest.substr(end + 1));
  }
  return std::nullopt;
}

// Assimp reads an OFF file that is cut off as far as it goes.
absl::Status CheckOffIsComplete(absl::string_view contents) {
  LineReader lines(contents);
  std::vector<absl::string_view> words;
  std::vector<int64_t> counts;  // numbers of points, faces and edges
  int64_t elements = 0;
  while (const std::optional<absl::string_view> line = lines.Next()) {
    SplitWords(line->substr(0, line->find('#')), words);
    if (words.size() == 2 && absl::EndsWith(words[0], "OFF") && words[1] == "BINARY") {
      return absl::InvalidArgumentError("is a binary OFF file, which is not read: export it as text, or as STL or PLY");
    }
    if (counts.size() >= 2) {
      elements += words.empty() ? 0 : 1;
      continue;
    }
    int64_t count;
    for (const absl::string_view word : words) {
      if (absl::SimpleAtoi(word, &count)) counts.push_back(count);
    }
  }
  if (counts.size() < 2) return absl::InvalidArgumentError("does not state the numbers of its points and faces");
  if (counts[1] == 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "states ", counts[0],
        " points and no face: a cloud of points has no surface; export the faces of the object, or compute a mesh from "
        "the points"));
  }
  if (counts[0] <= elements && counts[1] <= elements - counts[0]) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("is cut off: it states ", counts[0], " points and ", counts[1],
                                                 " faces, but has ", elements, " lines for them"));
}

bool HasSignature(absl::string_view contents, SceneFormat format) {
  const absl::string_view text =
      absl::StripLeadingAsciiWhitespace(absl::StartsWith(contents, "\xEF\xBB\xBF") ? contents.substr(3) : contents);
  switch (format) {
    case SceneFormat::kObj:
      return true;
    case SceneFormat::kGltf:
      return absl::StartsWith(text, "{");
    case SceneFormat::kGlb:
      return absl::StartsWith(contents, "glTF");
    case SceneFormat::kDae:
      return absl::StrContains(contents.substr(0, kHeadBytes), "<COLLADA");
    case SceneFormat::kOff:
      return absl::StrContains(text.substr(0, 8), "OFF");  // also COFF, NOFF, STOFF
    case SceneFormat::k3mf:
      return absl::StartsWith(contents, "PK");
  }
  return false;
}

}  // namespace

absl::Status CheckContents(absl::string_view contents, SceneFormat format) {
  if (contents.empty()) return absl::InvalidArgumentError("the model file is empty");
  if (!HasSignature(contents, format)) {
    return absl::InvalidArgumentError("its content is not of the format that the extension of its name states");
  }
  if (format == SceneFormat::kOff) return CheckOffIsComplete(contents);
  if (format != SceneFormat::kDae) return absl::OkStatus();
  const std::optional<std::string> unit = Attribute(contents.substr(0, kHeadBytes), "unit", "meter");
  double metres = 1.0;
  if (!unit || (absl::SimpleAtod(*unit, &metres) && metres > 0.0 && std::isfinite(metres))) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("its unit has \"", *unit, "\" metres; it must be a number above 0"));
}

}  // namespace evpose::client
