// SPDX-License-Identifier: Apache-2.0

// The alarm of a call.
#pragma once

#include <grpcpp/alarm.h>

#include <algorithm>
#include <chrono>
#include <memory>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {

// Not thread-safe. May be set and cancelled by its own function.
class CallAlarm {
 public:
  // Calls `function()` once after `duration`, on a thread of gRPC, unless the alarm is set again or cancelled before.
  // gRPC keeps `function` until then, also after it was called, so that it should hold a weak reference to the call.
  // Error: RESOURCE_EXHAUSTED (OUT_OF_MEMORY). `function` is then not called, and the call must be ended, because it
  // would wait for the alarm for ever.
  template <typename Function>
  [[nodiscard]] absl::Status Set(absl::Duration duration, const Function& function) {
    return OrOutOfMemory([&] {
      // A new alarm each time, because the function of the previous one may still be running.
      alarm_ = std::make_unique<grpc::Alarm>();
      alarm_->Set(std::chrono::system_clock::now() + absl::ToChronoMicroseconds(std::min(duration, kMaxDuration)),
                  [function](bool has_fired) {
                    if (has_fired) function();  // else it was cancelled
                  });
      return absl::OkStatus();
    });
  }

  void Cancel() { alarm_.reset(); }

 private:
  static constexpr absl::Duration kMaxDuration = absl::Hours(24 * 365);  // the sum with the present time is in range

  std::unique_ptr<grpc::Alarm> alarm_;
};

}  // namespace evpose::server
