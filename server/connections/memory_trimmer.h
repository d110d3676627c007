// SPDX-License-Identifier: Apache-2.0

// Returns memory to the kernel after connections have been closed. malloc keeps the memory of many small
// allocations of a transport, for example of HTTP/2 streams that are reset at once.
#pragma once

#include <cstddef>
#include <functional>

namespace evpose::server {

class MemoryTrimmer {
 public:
  // The steps from the first closed connection to the first trim: gRPC releases the memory of a connection some time
  // after its descriptor. A flood of resets is released only when gRPC has processed it, so further trims follow, each
  // after twice as many steps as the one before, up to kMaxSteps.
  static constexpr int kSteps = 5;
  static constexpr int kMaxSteps = 160;
  // Trimming locks the heap for milliseconds. The first trim is done only when the process has grown by this much since
  // the last trim. Without a first trim there are no further ones.
  static constexpr size_t kMinGrowthBytes = size_t{64} << 20;

  MemoryTrimmer();
  // A constructor for tests: `resident_bytes` returns the resident memory of the process, `trim` replaces
  // malloc_trim().
  MemoryTrimmer(std::function<size_t()> resident_bytes, std::function<void()> trim);

  // To be called periodically with the number of connections that were closed since the last call.
  void Step(size_t num_closed);

 private:
  const std::function<size_t()> resident_bytes_;
  const std::function<void()> trim_;
  int num_steps_left_ = 0;  // until the next trim; 0: none follows
  int interval_ = 0;        // steps before that trim
  size_t trimmed_bytes_ = 0;
};

}  // namespace evpose::server
