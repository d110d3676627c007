// SPDX-License-Identifier: Apache-2.0

// An interrupt while nothing of what was begun can be finished.
#pragma once

#include <atomic>
#include <stop_token>
#include <thread>

#include "absl/time/time.h"
#include "client/cli/common/cli_context.h"

namespace evpose::client {

// Requests `stop` when there has been an interrupt and `is_away` stays set for kGrace after it, until it goes out of
// scope: what a short outage holds up is still finished.
class InterruptWatch {
 public:
  static constexpr absl::Duration kGrace = absl::Seconds(2);

  // Keeps references: they must outlive it.
  InterruptWatch(const CliContext& context, const std::atomic<bool>& is_away, std::stop_source stop);

 private:
  std::jthread thread_;
};

}  // namespace evpose::client
