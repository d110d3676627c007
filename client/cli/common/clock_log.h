// SPDX-License-Identifier: Apache-2.0

// --clock-log: the host's time at the receipt of events, poses and triggers, with their sensor times.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "core/base/output_file.h"
#include "evpose/types.h"

namespace evpose::client {

// A CSV with the columns kind (chunk, pose or trigger), t_us (sensor time), host_unix_us (the host's clock, UTC), and,
// for triggers, input and rising. The sensor time of a chunk is that of its last event. It depends on the host's clock,
// so that it is a file of its own: the files of poses are functions of the events. Thread-safe.
class ClockLog {
 public:
  using Now = std::function<absl::Time()>;
  // With `kept_bytes`, continues the file of an earlier process (OutputFile::Continue). Errors: those of OutputFile.
  static absl::StatusOr<std::unique_ptr<ClockLog>> Open(const std::string& path, std::optional<uint64_t> kept_bytes,
                                                        Now now = absl::Now);

  // Each is called when the data arrive. A chunk of unknown time (-1) is left out.
  void AddChunk(int64_t t_us);
  void AddPose(int64_t t_us);
  void AddTriggers(const Triggers& triggers);

  // Writes all lines to the disk; returns the size of the file.
  absl::StatusOr<uint64_t> Sync();
  absl::Status Commit();

  // The smallest difference of host and sensor time of all chunks: data arrive late and never early, so that it is the
  // difference of the clocks plus the shortest delay. nullopt without chunks.
  std::optional<absl::Duration> SmallestDifference() const;

 private:
  ClockLog(OutputFile file, Now now) : now_(std::move(now)), file_(std::move(file)) {}
  void Append(const std::string& line) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const Now now_;
  mutable std::mutex mutex_;
  OutputFile file_ ABSL_GUARDED_BY(mutex_);
  std::optional<absl::Duration> smallest_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client
