// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/clock_log.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"

namespace evpose::client {

absl::StatusOr<std::unique_ptr<ClockLog>> ClockLog::Open(const std::string& path, std::optional<uint64_t> kept_bytes,
                                                         Now now) {
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file,
                          kept_bytes ? OutputFile::Continue(path, *kept_bytes) : OutputFile::Create(path));
  if (kept_bytes.value_or(0) == 0) EVPOSE_RETURN_IF_ERROR(file.Append("kind,t_us,host_unix_us,input,rising\n"));
  return std::unique_ptr<ClockLog>(new ClockLog(std::move(file), std::move(now)));
}

void ClockLog::Append(const std::string& line) { file_.Append(line).IgnoreError(); }  // Commit() returns the error

void ClockLog::AddChunk(int64_t t_us) {
  if (t_us < 0) return;
  const absl::Time now = now_();
  const absl::Duration difference = now - absl::FromUnixMicros(t_us);
  const std::lock_guard lock(mutex_);
  smallest_ = std::min(smallest_.value_or(difference), difference);
  Append(absl::StrFormat("chunk,%d,%d,,\n", t_us, absl::ToUnixMicros(now)));
}

void ClockLog::AddPose(int64_t t_us) {
  const int64_t now_us = absl::ToUnixMicros(now_());
  const std::lock_guard lock(mutex_);
  Append(absl::StrFormat("pose,%d,%d,,\n", t_us, now_us));
}

void ClockLog::AddTriggers(const Triggers& triggers) {
  const int64_t now_us = absl::ToUnixMicros(now_());
  const std::lock_guard lock(mutex_);
  for (const Trigger& trigger : triggers.triggers) {
    Append(absl::StrFormat("trigger,%d,%d,%d,%d\n", trigger.t_us, now_us, trigger.input, trigger.is_rising ? 1 : 0));
  }
}

absl::StatusOr<uint64_t> ClockLog::Sync() {
  const std::lock_guard lock(mutex_);
  return file_.Sync();
}

absl::Status ClockLog::Commit() {
  const std::lock_guard lock(mutex_);
  return file_.Commit();
}

std::optional<absl::Duration> ClockLog::SmallestDifference() const {
  const std::lock_guard lock(mutex_);
  return smallest_;
}

}  // namespace evpose::client
