// SPDX-License-Identifier: Apache-2.0

// FLAT64: from the highest bit t_us:32, x:14, y:14, 0:3, p:1.
#include "core/events/formats/full_address_decoder.h"

namespace evpose {
namespace {

struct Flat64Layout {
  static FullAddress Parse(uint64_t word) {
    return {static_cast<uint32_t>(word >> 32), static_cast<uint32_t>(word >> 18) & 0x3fff,
            static_cast<uint32_t>(word >> 4) & 0x3fff, static_cast<uint8_t>(word & 1), (word & 0xe) == 0};
  }
};

}  // namespace

std::unique_ptr<EventDecoder> MakeFlat64Decoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<FullAddressDecoder<Flat64Layout>>(geometry, outside);
}

}  // namespace evpose
