// SPDX-License-Identifier: Apache-2.0

// Serialization of large messages with yield points (core/base/yield_point.h). Only a header, because record_version.cc
// is a library of its own.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "core/base/yield_point.h"
#include "google/protobuf/io/zero_copy_stream.h"
#include "google/protobuf/message.h"

namespace evpose::server {

// Appends to a string, with a yield point after each piece.
class YieldingOutput : public google::protobuf::io::ZeroCopyOutputStream {
 public:
  static constexpr size_t kPieceBytes = size_t{64} * 1024;

  YieldingOutput(std::string& bytes, size_t expected_bytes) : bytes_(bytes) {
    bytes_.reserve(expected_bytes + kRoomAtEnd);
  }

  bool Next(void** data, int* size) override {
    YieldPoint();
    const size_t begin = bytes_.size();
    const size_t left = std::max(bytes_.capacity() - begin, kRoomAtEnd);
    bytes_.resize(begin + std::min(kPieceBytes, left));
    *data = bytes_.data() + begin;
    *size = static_cast<int>(bytes_.size() - begin);
    return true;
  }
  void BackUp(int count) override { bytes_.resize(bytes_.size() - static_cast<size_t>(count)); }
  int64_t ByteCount() const override { return static_cast<int64_t>(bytes_.size()); }

 private:
  // The serializer may ask for some bytes more than it writes.
  static constexpr size_t kRoomAtEnd = 64;

  std::string& bytes_;
};

// Returns what message.SerializeAsString() returns.
inline std::string SerializeYielding(const google::protobuf::Message& message) {
  std::string bytes;
  YieldingOutput output(bytes, message.ByteSizeLong());
  message.SerializeToZeroCopyStream(&output);
  return bytes;
}

}  // namespace evpose::server
