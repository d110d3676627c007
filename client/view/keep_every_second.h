// SPDX-License-Identifier: Apache-2.0

// Removes every second item of a series that has become too long.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace evpose::client {

// Keeps the items `first`, first + 2, first + 4 ...
template <typename Item>
void KeepEverySecond(std::vector<Item>& items, size_t first = 0) {
  size_t kept = 0;
  for (size_t i = first; i < items.size(); i += 2) std::swap(items[kept++], items[i]);
  items.resize(kept);
}

}  // namespace evpose::client
