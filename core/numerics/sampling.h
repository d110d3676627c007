// SPDX-License-Identifier: Apache-2.0

// Three methods of uniform downsampling of lists and streams. They differ in what must be known beforehand, and in
// whether the choice depends on the other items.
//
//   DownsampleByClass  a whole list of two classes, to a share for each class; low-discrepancy in each class
//   SelectionSampler   a list of known length, item by item; the number kept is exact
//   hash samples       a stream without end; each item is decided by its number alone, so that a sample does not depend
//                      on how the stream is cut into batches
//
// None uses a fixed stride: a sensor reads its rows out from left to right, so that a stride would favour one side of
// an edge. All give the same sample on every machine.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/numerics/random.h"

namespace evpose {

// Downsamples `items` to at most `max_count`, spread evenly over the input, in their order. An item belongs to class 0
// or 1 (`class_of`). Each class gets its fraction `share[k]` of the output (the shares sum to 1); a class with fewer
// items than that keeps them all, and the other class gets the rest. `kept` may alias `items`. O(items.size()).
// Returns, by class, the number of input items that an output item stands for; 1 for a class without output.
template <typename T, typename ClassOf>
std::array<double, 2> DownsampleByClass(size_t max_count, const std::array<double, 2>& share, absl::Span<const T> items,
                                        const ClassOf& class_of, std::vector<T>& kept) {
  // A multiplicative hash of an item's number within its class (Knuth, The Art of Computer Programming 3, 6.4): the
  // multiples of 2^32 over the golden ratio are a low-discrepancy sequence, so that the number kept of any run of items
  // differs little from its share.
  constexpr uint32_t kGolden = 2654435769u;
  constexpr uint64_t kAll = uint64_t{1} << 32;
  if (items.size() <= max_count) {
    if (kept.data() != items.data()) kept.assign(items.begin(), items.end());
    return {1.0, 1.0};
  }
  std::array<size_t, 2> count = {};
  for (const T& item : items) count[1] += class_of(item);
  count[0] = items.size() - count[1];
  const size_t rarer = static_cast<double>(count[1]) * share[0] < static_cast<double>(count[0]) * share[1] ? 1 : 0;
  std::array<size_t, 2> wanted = {};
  wanted[rarer] = std::min(count[rarer], static_cast<size_t>(share[rarer] * static_cast<double>(max_count)));
  wanted[1 - rarer] = max_count - wanted[rarer];
  std::array<uint64_t, 2> threshold = {};
  for (int k = 0; k < 2; ++k) {
    threshold[k] = wanted[k] >= count[k] ? kAll : (uint64_t{wanted[k]} << 32) / count[k];
  }

  // Every item is written, and the position advances only past those that stay: a branch on it could not be predicted.
  // Hence one place more than `max_count`.
  if (kept.data() != items.data()) kept.resize(max_count + 1);
  size_t seen = 0;  // number of items of class 1 so far
  std::array<size_t, 2> written = {};
  size_t write = 0;
  for (size_t read = 0; read < items.size(); ++read) {
    const size_t k = class_of(items[read]);
    const size_t number = k != 0 ? seen : read - seen;
    const uint32_t rank = static_cast<uint32_t>(number) * kGolden;  // modulo 2^32
    const bool stays = rank < threshold[k] && write < max_count;
    kept[write] = items[read];
    write += stays ? 1 : 0;
    written[1] += stays ? k : 0;
    seen += k;
  }
  kept.resize(write);
  written[0] = write - written[1];
  std::array<double, 2> items_per_kept = {1.0, 1.0};
  for (int k = 0; k < 2; ++k) {
    if (written[k] > 0) items_per_kept[k] = static_cast<double>(count[k]) / static_cast<double>(written[k]);
  }
  return items_per_kept;
}

// Selection sampling (Knuth, The Art of Computer Programming 2, 3.4.2, algorithm S): exactly min(total, wanted) of
// `total` calls return true. Every subset of that size is equally probable; the seed is fixed.
class SelectionSampler {
 public:
  SelectionSampler(size_t total, size_t wanted) : left_(total), wanted_(wanted) {}

  // Whether the next item belongs to the sample; called once for each of the `total` items.
  bool TakesNext() {
    const bool takes = wanted_ >= left_ || random_.UniformInt(left_) < wanted_;
    --left_;
    if (takes && wanted_ > 0) --wanted_;
    return takes;
  }

 private:
  size_t left_;
  size_t wanted_;
  Random random_{1};
};

// Whether item `number` of a stream belongs to the hash sample of `mask`: whether its hash has none of the mask's bits.
// A mask with k bits keeps one item in 2^k on average; the sample of a mask contains that of every mask with more bits.
bool IsInHashSample(uint64_t number, uint64_t mask);

// One mask for each of two classes of items: for OFF and ON events.
using HashSampleMasks = std::array<uint64_t, 2>;
// Sets bit k of `marks[i]` if item `first + i` belongs to the sample of `masks[k]`. Vectorised.
void MarkHashSample(uint64_t first, const HashSampleMasks& masks, absl::Span<uint8_t> marks);
// The same for item `numbers[i]`. `marks` has at least as many elements as `numbers`.
void MarkHashSample(absl::Span<const uint64_t> numbers, const HashSampleMasks& masks, absl::Span<uint8_t> marks);

}  // namespace evpose
