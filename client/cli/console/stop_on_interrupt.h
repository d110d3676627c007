// SPDX-License-Identifier: Apache-2.0

// Ends the calls of a command to a server at an interrupt.
#pragma once

#include <stop_token>
#include <thread>

#include "client/cli/console/cli_context.h"

namespace evpose::client {

class StopOnInterrupt {
 public:
  // `context` must outlive the object.
  explicit StopOnInterrupt(const CliContext& context)
      : thread_([&context, stop = stop_](const std::stop_token& ended) mutable {
          while (!context.IsInterrupted()) {
            if (!SystemClock().SleepUntil(SystemClock().Now() + kInterruptPeriod, ended)) return;
          }
          stop.request_stop();
        }) {}

  // Requested at an interrupt; the command may request it, too.
  std::stop_source& stop() { return stop_; }

 private:
  std::stop_source stop_;
  std::jthread thread_;
};

}  // namespace evpose::client
