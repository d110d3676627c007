// SPDX-License-Identifier: Apache-2.0

// The word types of Prophesee's raw formats, the top four bits of each word (core/events/README.md, section 1).
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

}  // namespace evpose
