// SPDX-License-Identifier: Apache-2.0
#include "core/events/decoder.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/events/formats/word_decoder.h"

namespace evpose {

std::string_view EncodingName(Encoding encoding) {
  switch (encoding) {
    case Encoding::kEvt3:
      return "EVT3";
    case Encoding::kEvt21:
      return "EVT2.1";
    case Encoding::kEvt2:
      return "EVT2";
    case Encoding::kDat:
      return "DAT";
    case Encoding::kFlat64:
      return "FLAT64";
  }
  return "unknown";
}

int WordBytes(Encoding encoding) {
  switch (encoding) {
    case Encoding::kEvt3:
      return 2;
    case Encoding::kEvt2:
      return 4;
    case Encoding::kEvt21:
    case Encoding::kDat:
    case Encoding::kFlat64:
      return 8;
  }
  return 8;
}

SensorGeometry AddressableGeometry(Encoding encoding) {
  switch (encoding) {
    case Encoding::kEvt3:
    case Encoding::kEvt21:
    case Encoding::kEvt2:
      return {1 << 11, 1 << 11};
    case Encoding::kDat:
    case Encoding::kFlat64:
      return {1 << 14, 1 << 14};
  }
  return {};
}

absl::Status ValidateGeometry(Encoding encoding, SensorGeometry geometry) {
  const SensorGeometry largest = AddressableGeometry(encoding);
  if (geometry.width_px >= 1 && geometry.height_px >= 1 && geometry.width_px <= largest.width_px &&
      geometry.height_px <= largest.height_px) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat("the sensor has ", geometry.width_px, "x", geometry.height_px,
                                                 " pixels; ", std::string(EncodingName(encoding)), " addresses 1x1 to ",
                                                 largest.width_px, "x", largest.height_px));
}

absl::StatusOr<std::unique_ptr<EventDecoder>> MakeEventDecoder(Encoding encoding, SensorGeometry geometry,
                                                               OutsideSensor outside) {
  EVPOSE_RETURN_IF_ERROR(ValidateGeometry(encoding, geometry));
  switch (encoding) {
    case Encoding::kEvt3:
      return MakeEvt3Decoder(geometry, outside);
    case Encoding::kEvt21:
      return MakeEvt21Decoder(geometry, outside);
    case Encoding::kEvt2:
      return MakeEvt2Decoder(geometry, outside);
    case Encoding::kDat:
      return MakeDatDecoder(geometry, outside);
    case Encoding::kFlat64:
      return MakeFlat64Decoder(geometry, outside);
  }
  return absl::InvalidArgumentError("the encoding is unknown; use EVT3, EVT2.1, EVT2, DAT or FLAT64");
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
  Forget();
}

}  // namespace evpose
