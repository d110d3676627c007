// SPDX-License-Identifier: Apache-2.0

// The measured load of the workers, and whether it is too high for further sessions.
#pragma once

#include <chrono>
#include <functional>
#include <mutex>
#include <optional>
#include <utility>

#include "absl/base/thread_annotations.h"

namespace evpose::server {

// Thread-safe.
class LoadMonitor {
 public:
  using Time = std::chrono::steady_clock::time_point;

  struct Options {
    int num_workers = 1;
    // Processor time of all turns of sessions since the start of the process.
    std::function<std::chrono::nanoseconds()> cpu;
    // The bound of IsOverloaded(); 0: none.
    double max_ratio = 0.0;
    std::function<Time()> now = std::chrono::steady_clock::now;
  };

  // Time constant of the average: a search for a first pose takes a part of a second, and a new session should count
  // before the next ones are distributed.
  static constexpr std::chrono::seconds kTimeConstant{5};
  // Time for which the average must be above the bound: with the average's own delay, bursts of several seconds, such
  // as the searches of sessions that have come from another server, do not refuse sessions.
  static constexpr std::chrono::seconds kHold{5};
  // Period of Update(), small against kTimeConstant.
  static constexpr std::chrono::milliseconds kPeriod{500};

  explicit LoadMonitor(Options options);

  // To be called every kPeriod.
  void Update();
  // Processor time of the workers per second and worker, averaged with kTimeConstant: 0 to 1.
  double ratio() const;
  // The ratio has been above the bound for kHold, and still is.
  bool IsOverloaded() const;
  double max_ratio() const { return options_.max_ratio; }

 private:
  const Options options_;
  mutable std::mutex mutex_;
  Time updated_at_ ABSL_GUARDED_BY(mutex_);
  std::chrono::nanoseconds cpu_ ABSL_GUARDED_BY(mutex_);
  double ratio_ ABSL_GUARDED_BY(mutex_) = 0.0;
  std::optional<Time> above_since_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
