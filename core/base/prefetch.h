// Tables with an entry for each pixel are larger than the caches near the processor, and events come from anywhere: a
// loop that asks early for what it will read does not wait for it.
#pragma once

#include <cstddef>
#include <vector>

namespace evpose {

// So many items ahead: as long as a load from memory takes.
inline constexpr size_t kPrefetchAhead = 16;

// Nothing beyond the table's end.
template <typename T>
void PrefetchEntry(const std::vector<T>& table, size_t index) {
  if (index < table.size()) __builtin_prefetch(&table[index]);
}

}  // namespace evpose
