// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/interrupt_watch.h"

#include <utility>

namespace evpose::client {

InterruptWatch::InterruptWatch(const CliContext& context, const std::atomic<bool>& is_away, std::stop_source stop)
    : thread_([&context, &is_away, stop = std::move(stop)](std::stop_token ended) mutable {
        for (absl::Duration waited; waited < kGrace; waited += kInterruptPeriod) {
          if (!is_away || !context.IsInterrupted()) waited = absl::ZeroDuration();
          if (!SystemClock().SleepUntil(SystemClock().Now() + kInterruptPeriod, ended)) return;
        }
        stop.request_stop();
      }) {}

}  // namespace evpose::client
