// SPDX-License-Identifier: Apache-2.0

// Vectors of EVT3: a base word, then masks of 12 + 12 + 8 pixels from the base on, in one row and of one polarity.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>

#include "core/events/event.h"
#include "core/events/word_decoder.h"
#include "core/events/word_types.h"

namespace evpose {

inline constexpr uint32_t kEvt3MaskPixels = 32;  // number of pixels of the three masks

// The position and polarity that the last VECT_BASE_X has set; each three masks advance x.
struct Evt3VectorBase {
  bool is_set = false;
  uint32_t x = 0;
  uint8_t polarity = 0;

  friend bool operator==(const Evt3VectorBase&, const Evt3VectorBase&) = default;
};

// Stores an event for each bit of `mask`, the lowest at column x; returns the end. Stores four at a time, because most
// vectors have fewer and a branch for each event would be unpredictable: up to three events after the end are written.
inline Event* StorePixels(uint32_t mask, int64_t t_us, uint32_t x, uint32_t y, uint32_t polarity, Event* cursor) {
  Event* const end = cursor + std::popcount(mask);
  do {
    for (int i = 0; i < 4; ++i) {
      StoreEvent(cursor++, t_us, x + static_cast<uint32_t>(std::countr_zero(mask)), y, polarity);
      mask &= mask - 1;
    }
  } while (mask != 0);
  return end;
}

// Four words that cameras send in succession: VECT_BASE_X and the three masks.
class Evt3WholeVector {
 public:
  static constexpr size_t kWords = 4;

  explicit Evt3WholeVector(const uint8_t* words) : words_(LoadWord<uint64_t>(words)) {}

  // True if the words have these types and all pixels of the masks are inside a sensor of this width.
  bool IsInside(uint32_t width_px) const {
    constexpr uint64_t kTypes = uint64_t{evt3::kVectBaseX} << 12 | uint64_t{evt3::kVect12} << 28 |
                                uint64_t{evt3::kVect12} << 44 | uint64_t{evt3::kVect8} << 60;
    return (words_ & 0xf000'f000'f000'f000) == kTypes && x() + kEvt3MaskPixels <= width_px;
  }
  // Stores the events as StorePixels() and sets `base` to the state after them.
  Event* Store(int64_t t_us, uint32_t y, Evt3VectorBase& base, Event* cursor) const {
    base = {true, x() + kEvt3MaskPixels, static_cast<uint8_t>(words_ >> 11 & 1)};
    const uint64_t mask = (words_ >> 16 & 0xfff) | (words_ >> 20 & 0xfff000) | (words_ >> 24 & 0xff000000);
    return StorePixels(static_cast<uint32_t>(mask), t_us, x(), y, base.polarity, cursor);
  }

 private:
  uint32_t x() const { return static_cast<uint32_t>(words_ & 0x7ff); }

  uint64_t words_;
};

}  // namespace evpose
