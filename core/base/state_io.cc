// SPDX-License-Identifier: Apache-2.0
#include "core/base/state_io.h"

#include "absl/strings/str_cat.h"
#include "core/base/yield_point.h"

namespace evpose {

void StateWriter::Count(const size_t& count) {
  const uint64_t fixed_width = count;
  Raw(&fixed_width, sizeof(fixed_width));
}

void StateWriter::Varint(const uint64_t& number) {
  uint64_t rest = number;
  for (; rest >= 0x80; rest >>= 7) piece_.push_back(static_cast<char>(0x80 | (rest & 0x7f)));
  const auto last = static_cast<char>(rest);
  Raw(&last, 1);
}

void StateWriter::Bytes(absl::string_view bytes) {
  Count(bytes.size());
  Raw(bytes.data(), bytes.size());
}

void StateWriter::EndPiece() {
  ended_bytes_ += piece_.size();
  ended_.push_back(std::exchange(piece_, std::string()));
  piece_.reserve(kPieceBytes + 64);  // the last field ends a little beyond kPieceBytes
  YieldPoint();
}

std::string StateWriter::Take() {
  if (ended_.empty()) return std::move(piece_);
  std::string bytes;
  bytes.reserve(size());
  for (std::string& piece : ended_) {
    bytes += std::exchange(piece, std::string());  // frees each piece, because the state may be large
    YieldPoint();
  }
  bytes += piece_;
  return bytes;
}

void StateReader::Count(size_t& count) {
  uint64_t fixed_width = 0;
  Raw(&fixed_width, sizeof(fixed_width));
  if (fixed_width > remaining()) {
    Fail(absl::StrCat("a list has ", fixed_width, " elements, but only ", remaining(), " bytes remain"));
    fixed_width = 0;
  }
  count = static_cast<size_t>(fixed_width);
}

void StateReader::Varint(uint64_t& number) {
  number = 0;
  for (int shift = 0; shift < 64; shift += 7) {
    uint8_t byte = 0;
    Raw(&byte, 1);
    number |= static_cast<uint64_t>(byte & 0x7f) << shift;
    if (byte < 0x80) return;
  }
  Fail("a varint has more than 10 bytes");
  number = 0;
}

absl::string_view StateReader::Bytes() {
  size_t size = 0;
  Count(size);
  const absl::string_view bytes = bytes_.substr(position_, size);
  position_ += size;
  return bytes;
}

void StateReader::Raw(void* bytes, size_t size) {
  if (size > remaining()) Fail(absl::StrCat("the bytes end where ", size, " more are needed"));
  if (!ok()) {
    std::memset(bytes, 0, size);
    return;
  }
  std::memcpy(bytes, bytes_.data() + position_, size);
  position_ += size;
}

void StateReader::Fail(absl::string_view what) {
  if (!ok()) return;
  status_ = absl::DataLossError(absl::StrCat("saved state, byte ", position_, ": ", what));
  bytes_ = {};  // no further byte is read
  position_ = 0;
}

absl::Status StateReader::Finish() {
  if (remaining() > 0) Fail(absl::StrCat(remaining(), " bytes remain after the last field"));
  return status_;
}

}  // namespace evpose
