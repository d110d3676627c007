// SPDX-License-Identifier: Apache-2.0

// Even samples of a list.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

// Copies at most `max_count` of the items, of each of two kinds, 0 and 1, evenly. Of the kind of which more came than
// its `share`, of a sum of one, fewer are kept: the other one has its own share of what is kept, or all that there are.
// `kept` may be the list that `items` are of. Returns how many items each one kept of a kind stands for.
template <typename T, typename KindOf>
std::array<double, 2> ThinEvenlyByKind(size_t max_count, const std::array<double, 2>& share, absl::Span<const T> items,
                                       const KindOf& kind_of, std::vector<T>& kept) {
  // A multiplicative hash of an item's number among its kind is a low-discrepancy sequence (golden ratio): the share
  // kept is even to within one in any stretch. A fixed stride would favour one side of an edge, because a sensor's rows
  // are read out from left to right.
  constexpr uint32_t kGolden = 2654435769u;
  constexpr uint64_t kAll = uint64_t{1} << 32;
  if (items.size() <= max_count) {
    if (kept.data() != items.data()) kept.assign(items.begin(), items.end());
    return {1.0, 1.0};
  }
  std::array<size_t, 2> count = {};
  for (const T& item : items) count[1] += kind_of(item);
  count[0] = items.size() - count[1];
  const size_t rarer = static_cast<double>(count[1]) * share[0] < static_cast<double>(count[0]) * share[1] ? 1 : 0;
  std::array<size_t, 2> wanted = {};
  wanted[rarer] = std::min(count[rarer], static_cast<size_t>(share[rarer] * static_cast<double>(max_count)));
  wanted[1 - rarer] = max_count - wanted[rarer];
  std::array<uint64_t, 2> threshold = {};
  for (int kind = 0; kind < 2; ++kind) {
    threshold[kind] = wanted[kind] >= count[kind] ? kAll : (uint64_t{wanted[kind]} << 32) / count[kind];
  }

  // One more than are kept: every item is written, and counts when it is to stay, which no branch can foretell.
  if (kept.data() != items.data()) kept.resize(max_count + 1);
  size_t seen = 0;  // of kind 1
  std::array<size_t, 2> written = {};
  size_t write = 0;
  for (size_t read = 0; read < items.size(); ++read) {
    const size_t kind = kind_of(items[read]);
    const size_t number = kind != 0 ? seen : read - seen;
    const bool stays = static_cast<uint32_t>(number) * kGolden < threshold[kind] && write < max_count;
    kept[write] = items[read];
    write += stays ? 1 : 0;
    written[1] += stays ? kind : 0;
    seen += kind;
  }
  kept.resize(write);
  written[0] = write - written[1];
  std::array<double, 2> items_per_kept = {1.0, 1.0};
  for (int kind = 0; kind < 2; ++kind) {
    if (written[kind] > 0) items_per_kept[kind] = static_cast<double>(count[kind]) / static_cast<double>(written[kind]);
  }
  return items_per_kept;
}

}  // namespace evpose
