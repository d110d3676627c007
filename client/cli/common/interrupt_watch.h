// SPDX-License-Identifier: Apache-2.0

// Handles an interrupt while the server is unreachable, so that the work in progress cannot be finished.
#pragma once

#include <atomic>
#include <stop_token>
#include <thread>

#include "absl/time/time.h"
#include "client/cli/common/cli_context.h"

namespace evpose::client {

// Requests `stop` if an interrupt has occurred and `is_away` remains set for kGrace after it. After a shorter outage
// the work is finished normally.
class InterruptWatch {
 public:
  static constexpr absl::Duration kGrace = absl::Seconds(2);

  // Keeps references: they must outlive it.
  InterruptWatch(const CliContext& context, const std::atomic<bool>& is_away, std::stop_source stop);

 private:
  std::jthread thread_;
};

}  // namespace evpose::client
