// SPDX-License-Identifier: Apache-2.0

// Scratch vectors that are filled again in every window and keep their memory.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace evpose {

// Sets `items` to `count` value-initialised elements. If the capacity is too small, it becomes twice `count`: a vector
// that has similar lengths in all calls soon needs no more allocations.
template <typename T>
void AssignDefaults(size_t count, std::vector<T>& items) {
  if (items.capacity() < count) {
    items.clear();
    items.reserve(2 * count);
  }
  items.assign(count, T());
}

// The same with a capacity of at least `min_capacity` from the first call on, for a caller that has a bound of `count`.
template <typename T>
void AssignDefaults(size_t count, size_t min_capacity, std::vector<T>& items) {
  if (items.capacity() < min_capacity) {
    items.clear();
    items.reserve(min_capacity);
  }
  AssignDefaults(count, items);
}

// The same without setting the elements: those that the vector had before keep their values. For a caller that sets all
// elements that it reads.
template <typename T>
void ResizeUnset(size_t count, size_t min_capacity, std::vector<T>& items) {
  if (items.capacity() < std::max(count, min_capacity)) {
    items.clear();
    items.reserve(std::max(2 * count, min_capacity));
  }
  items.resize(count);
}

}  // namespace evpose
