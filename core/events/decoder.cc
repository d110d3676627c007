// SPDX-License-Identifier: Apache-2.0
#include "core/events/decoder.h"

#include <array>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/events/word_decoder.h"

namespace evpose {
namespace {

struct EncodingTraits {
  std::string_view name;
  int word_bytes;
  int num_addresses;  // number of rows and of columns
  std::unique_ptr<EventDecoder> (*make_decoder)(SensorGeometry geometry, OutsideSensor outside);
};

// Indexed by Encoding.
constexpr std::array<EncodingTraits, kNumEncodings> kEncodings = {{{"EVT3", 2, 1 << 11, MakeEvt3Decoder},
                                                                   {"EVT2.1", 8, 1 << 11, MakeEvt21Decoder},
                                                                   {"EVT2", 4, 1 << 11, MakeEvt2Decoder},
                                                                   {"DAT", 8, 1 << 14, MakeDatDecoder},
                                                                   {"FLAT64", 8, 1 << 14, MakeFlat64Decoder}}};
static_assert(!kEncodings.back().name.empty());

const EncodingTraits& TraitsOf(Encoding encoding) { return kEncodings[static_cast<size_t>(encoding)]; }

}  // namespace

std::string_view EncodingName(Encoding encoding) { return TraitsOf(encoding).name; }

int WordBytes(Encoding encoding) { return TraitsOf(encoding).word_bytes; }

absl::Status ValidateGeometry(Encoding encoding, SensorGeometry geometry) {
  const int largest = TraitsOf(encoding).num_addresses;
  if (geometry.width_px >= 1 && geometry.height_px >= 1 && geometry.width_px <= largest &&
      geometry.height_px <= largest) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat("the sensor has ", geometry.width_px, "x", geometry.height_px,
                                                 " pixels; ", std::string(EncodingName(encoding)), " addresses 1x1 to ",
                                                 largest, "x", largest));
}

absl::StatusOr<std::unique_ptr<EventDecoder>> MakeEventDecoder(Encoding encoding, SensorGeometry geometry,
                                                               OutsideSensor outside) {
  EVPOSE_RETURN_IF_ERROR(ValidateGeometry(encoding, geometry));
  return TraitsOf(encoding).make_decoder(geometry, outside);
}

void WordDecoder::Decode(absl::Span<const uint8_t> bytes, DecodedEvents& out) {
  sink_.Begin(out, bytes.size() / word_bytes_ + 1);
  const uint8_t* next = bytes.data();
  const uint8_t* const end = next + bytes.size();
  while (num_pending_ > 0 && next != end) {
    pending_[num_pending_++] = *next++;
    if (num_pending_ % word_bytes_ != 0) continue;
    if (DecodeWords(pending_.data(), num_pending_ / word_bytes_) > 0) num_pending_ = 0;
  }
  if (next != end) {
    next += DecodeWords(next, static_cast<size_t>(end - next) / word_bytes_) * word_bytes_;
    num_pending_ = static_cast<size_t>(end - next);
    std::memcpy(pending_.data(), next, num_pending_);
  }
  sink_.End();
}

void WordDecoder::ResetAfterLoss() {
  num_pending_ = 0;
  DiscardState();
}

}  // namespace evpose
