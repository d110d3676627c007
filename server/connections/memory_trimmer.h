// SPDX-License-Identifier: Apache-2.0

// Returns memory to the kernel after connections have been closed. malloc keeps what many small allocations of a
// transport have taken, as those for HTTP/2 streams that are reset at once.
#pragma once

#include <cstddef>
#include <functional>

namespace evpose::server {

class MemoryTrimmer {
 public:
  // The steps from the first closed connection to the trim: gRPC releases the memory of a connection some time after
  // its descriptor.
  static constexpr int kSteps = 5;
  // Trimming locks the heap for milliseconds. It is done only when the process has grown by this much since the last
  // time.
  static constexpr size_t kMinGrowthBytes = size_t{64} << 20;

  MemoryTrimmer();
  // For tests: `resident_bytes` returns the resident memory of the process, `trim` replaces malloc_trim().
  MemoryTrimmer(std::function<size_t()> resident_bytes, std::function<void()> trim);

  // To be called periodically with the number of connections that were closed since the last call.
  void Step(size_t num_closed);

 private:
  const std::function<size_t()> resident_bytes_;
  const std::function<void()> trim_;
  int num_steps_left_ = 0;  // 0: no connection has been closed
  size_t trimmed_bytes_ = 0;
};

}  // namespace evpose::server
