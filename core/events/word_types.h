// SPDX-License-Identifier: Apache-2.0

// The types of the words of the formats (core/events/README.md, section 1). Those of Prophesee's raw formats are the
// top four bits of each word.
#pragma once

#include <cstdint>

namespace evpose {

// EVT 2.0 and EVT 2.1.
namespace evt2 {
enum WordType : uint32_t {
  kCdOff = 0x0,
  kCdOn = 0x1,
  kTimeHigh = 0x8,
  kExtTrigger = 0xA,
  kOthers = 0xE,
  kContinued = 0xF,
};
}  // namespace evt2

// EVT 3.0.
namespace evt3 {
enum WordType : uint32_t {
  kAddrY = 0x0,
  kReservedRow = 0x1,
  kAddrX = 0x2,
  kVectBaseX = 0x3,
  kVect12 = 0x4,
  kVect8 = 0x5,
  kTimeLow = 0x6,
  kContinued4 = 0x7,
  kTimeHigh = 0x8,
  kPadding = 0x9,  // with the content kPaddingContent
  kExtTrigger = 0xA,
  kOthers = 0xE,
  kContinued12 = 0xF,
};
inline constexpr uint32_t kPaddingContent = 0x999;
}  // namespace evt3

// A kind of word of the formats in which each word is a complete event: DAT and FLAT64.
enum class WordKind : uint8_t { kEvent, kTrigger, kUnknown };

// FLAT64: from the highest bit t_us:32, x:14, y:14, 0:2, trigger:1, p:1. A trigger has a row of 0 and a number of 8
// bits in the column.
inline WordKind Flat64Kind(uint64_t word) {
  if ((word & 0xe) == 0) return WordKind::kEvent;
  return (word & 0xfc03fffc) == 0 ? WordKind::kTrigger : WordKind::kUnknown;
}

}  // namespace evpose
