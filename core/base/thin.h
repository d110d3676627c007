// An even sample of a list.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace evpose {

// Keeps at most `max_count` of the items, drawn evenly by a hash of their number: a fixed stride would favour one side
// of an edge, because a sensor's rows are read out from left to right.
template <typename T>
void ThinEvenly(size_t max_count, std::vector<T>& items) {
  const size_t count = items.size();
  if (count <= max_count) return;
  // A multiplicative hash of the index is a low-discrepancy sequence (golden ratio): the share kept is max_count /
  // count to within one in any stretch.
  const uint64_t threshold = (static_cast<uint64_t>(max_count) << 32) / count;
  size_t write = 0;
  for (size_t read = 0; read < count; ++read) {
    const uint32_t hash = static_cast<uint32_t>(read) * 2654435769u;
    if (hash < threshold) items[write++] = items[read];
  }
  items.resize(std::min(write, max_count));
}

}  // namespace evpose
