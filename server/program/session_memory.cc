// SPDX-License-Identifier: Apache-2.0
#include "server/program/session_memory.h"

#include <algorithm>

namespace evpose::server {

uint64_t DefaultSessionMemory(const ServerOptions& options, uint64_t available_bytes) {
  // Bytes of the program, its threads and the fragments of its heap. A server without sessions has 73 MB
  // (deploy/sizing.md); the rest is a margin.
  constexpr double kRestOfProcess = 200e6;
  constexpr double kTransportAndResponses = 1.25;  // ServerOptions::max_transport_bytes has the reason
  // The sum is computed in floating point, because limits that users give may together exceed 64 bits.
  const auto available = static_cast<double>(available_bytes);
  const double others = options.slow_threads * static_cast<double>(options.model_budget.memory_bytes) +
                        static_cast<double>(options.max_model_store_bytes) +
                        kTransportAndResponses * static_cast<double>(options.max_transport_bytes) + kRestOfProcess;
  return static_cast<uint64_t>(std::max(std::min(0.75 * available, available - others), available / 4));
}

}  // namespace evpose::server
