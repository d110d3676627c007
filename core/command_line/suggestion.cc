// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/suggestion.h"

#include <algorithm>
#include <cstddef>

#include "absl/strings/match.h"
#include "absl/strings/string_view.h"

namespace evpose {
namespace {

// The optimal string alignment distance: Damerau-Levenshtein without edits inside exchanged pairs.
size_t EditDistance(absl::string_view a, absl::string_view b) {
  std::vector<std::vector<size_t>> distance(a.size() + 1, std::vector<size_t>(b.size() + 1));
  for (size_t i = 0; i <= a.size(); ++i) {
    for (size_t j = 0; j <= b.size(); ++j) {
      if (i == 0 || j == 0) {
        distance[i][j] = i + j;
        continue;
      }
      const size_t replaced = distance[i - 1][j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
      distance[i][j] = std::min({distance[i - 1][j] + 1, distance[i][j - 1] + 1, replaced});
      const bool is_exchanged = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
      if (is_exchanged) distance[i][j] = std::min(distance[i][j], distance[i - 2][j - 2] + 1);
    }
  }
  return distance[a.size()][b.size()];
}

// Longer words are no misspelled names, and their distance would take time.
constexpr size_t kMaxWord = 64;

}  // namespace

std::string NearestName(absl::string_view word, const std::vector<std::string>& names) {
  std::string nearest;
  size_t least = 0;
  if (word.size() > kMaxWord) return nearest;
  for (const std::string& name : names) {
    const bool is_beginning = word.size() >= 3 && absl::StartsWith(name, word);
    const size_t distance = is_beginning ? 1 : EditDistance(word, name);
    if (distance > std::max<size_t>(1, word.size() / 3) || distance >= name.size()) continue;
    if (!nearest.empty() && distance >= least) continue;
    nearest = name;
    least = distance;
  }
  return nearest;
}

}  // namespace evpose
