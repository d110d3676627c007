// SPDX-License-Identifier: Apache-2.0

// Tables with an entry for each pixel are larger than the caches near the processor, and events come from anywhere: a
// loop that asks early for what it will read does not wait for it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace evpose {

// So many items ahead: as long as a load from memory takes.
inline constexpr size_t kPrefetchAhead = 32;

// Nothing beyond the table's end.
template <typename T>
void PrefetchEntry(const std::vector<T>& table, size_t index) {
  if (index < table.size()) __builtin_prefetch(&table[index]);
}

// What lies so many items beyond this one, if anything does: for a long list that is read once, in order.
template <typename T>
void PrefetchBeyond(const T& item, size_t count) {
  // A number: there need be no item to point to.
  __builtin_prefetch(reinterpret_cast<const void*>(reinterpret_cast<uintptr_t>(&item) + count * sizeof(T)));
}

}  // namespace evpose
