// SPDX-License-Identifier: Apache-2.0

// DAT version 2, 2D events: 32 bits of time, then x:14, y:14 and polarity in 32 bits.
#include "core/events/formats/full_address_decoder.h"

namespace evpose {
namespace {

struct DatLayout {
  static FullAddress Parse(uint64_t word) {
    // The three bits above the polarity have no meaning in 2D events.
    return {static_cast<uint32_t>(word), static_cast<uint32_t>(word >> 32) & 0x3fff,
            static_cast<uint32_t>(word >> 46) & 0x3fff, static_cast<uint8_t>((word >> 60) & 1), true};
  }
};

}  // namespace

std::unique_ptr<EventDecoder> MakeDatDecoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<FullAddressDecoder<DatLayout>>(geometry, outside);
}

}  // namespace evpose
