// SPDX-License-Identifier: Apache-2.0

// Lists that are filled anew all the time.
#pragma once

#include <cstddef>
#include <vector>

namespace evpose {

// Overwrites `items` with `count` empty ones. Where there is no room for them it takes room for twice as many: a list
// whose length varies a little from call to call soon allocates no more.
template <typename T>
void Refill(size_t count, std::vector<T>& items) {
  if (items.capacity() < count) {
    items.clear();
    items.reserve(2 * count);
  }
  items.assign(count, T());
}

// The same, with room for so many from the first call on.
template <typename T>
void Refill(size_t count, size_t room, std::vector<T>& items) {
  if (items.capacity() < room) {
    items.clear();
    items.reserve(room);
  }
  Refill(count, items);
}

}  // namespace evpose
