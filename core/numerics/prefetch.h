// SPDX-License-Identifier: Apache-2.0

// Prefetching for loops over events. Tables with an entry for each pixel are larger than the first caches, and
// consecutive events lie in unrelated pixels: a loop that requests its entries early does not wait for memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace evpose {

// Distance in items between the prefetch and its use: in that time of the loop a load from main memory completes.
inline constexpr size_t kPrefetchAhead = 32;

// Requests one entry of a table; does nothing for an index beyond its end.
template <typename T>
void PrefetchEntry(const std::vector<T>& table, size_t index) {
  if (index < table.size()) __builtin_prefetch(&table[index]);
}

// Requests the item that lies `count` items after `item`: for a long array that is read once, in order. There need be
// no such item.
template <typename T>
void PrefetchBeyond(const T& item, size_t count) {
  // Computed as a number, because a pointer beyond the array's end would be undefined.
  // NOLINTNEXTLINE(performance-no-int-to-ptr)
  __builtin_prefetch(reinterpret_cast<const void*>(reinterpret_cast<uintptr_t>(&item) + count * sizeof(T)));
}

}  // namespace evpose
