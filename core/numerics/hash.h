// SPDX-License-Identifier: Apache-2.0

// Digests: SHA-256 identifies models and recordings, CRC-32C detects damaged chunks and records.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/types/span.h"

namespace evpose {

// Incremental SHA-256.
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(const Sha256&) = delete;
  Sha256& operator=(const Sha256&) = delete;

  void Update(absl::Span<const uint8_t> bytes);
  // The digest as 64 lower-case hexadecimal digits. The last call.
  std::string FinishHex();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// The same for bytes that are all in memory.
std::string Sha256Hex(absl::Span<const uint8_t> bytes);

// CRC-32C (Castagnoli), as in RFC 3720 appendix B.4.
uint32_t Crc32c(absl::Span<const uint8_t> bytes);

}  // namespace evpose
