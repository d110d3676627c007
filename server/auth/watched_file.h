// SPDX-License-Identifier: Apache-2.0

// The contents of a file that is read again when it changes, or after an error of reading.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "server/auth/file_stamp.h"
#include "server/auth/read_schedule.h"

namespace evpose::server {

// Thread-safe.
template <typename Contents>
class WatchedFile {
 public:
  using Read = std::function<absl::StatusOr<Contents>(const std::string& path)>;
  using Schedule = ReadSchedule<FileStamp>;
  // Called after each reading but the first, for the log; once for an error that repeats.
  using OnRead = std::function<void(const absl::StatusOr<Contents>&)>;

  // Errors: those of `read`.
  static absl::StatusOr<std::unique_ptr<WatchedFile>> Open(const std::string& path, Read read, OnRead on_read,
                                                           typename Schedule::Now now = Schedule::Clock::now) {
    const FileStamp stamp = StampOf(path);
    absl::StatusOr<Contents> contents = read(path);
    if (!contents.ok()) return contents.status();
    return std::unique_ptr<WatchedFile>(
        new WatchedFile(path, std::move(read), std::move(on_read), std::move(now), stamp, *std::move(contents)));
  }

  // When a new version of the file cannot be read, the previous contents stay in use.
  std::shared_ptr<const Contents> Current() {
    const std::lock_guard lock(mutex_);
    Refresh();
    return contents_;
  }

  // Increases whenever the contents change.
  uint64_t version() {
    const std::lock_guard lock(mutex_);
    Refresh();
    return version_;
  }

 private:
  WatchedFile(const std::string& path, Read read, OnRead on_read, typename Schedule::Now now, const FileStamp& stamp,
              Contents contents)
      : path_(path),
        read_(std::move(read)),
        on_read_(std::move(on_read)),
        schedule_(std::move(now)),
        contents_(std::make_shared<const Contents>(std::move(contents))) {
    const std::lock_guard lock(mutex_);
    schedule_.OnRead(stamp, absl::OkStatus());
  }

  void Refresh() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    const FileStamp stamp = StampOf(path_);
    if (!schedule_.IsDue(stamp)) return;
    absl::StatusOr<Contents> contents = read_(path_);
    if (schedule_.OnRead(stamp, contents.status())) on_read_(contents);
    if (!contents.ok()) return;
    contents_ = std::make_shared<const Contents>(*std::move(contents));
    ++version_;
  }

  const std::string path_;
  const Read read_;
  const OnRead on_read_;
  std::mutex mutex_;
  Schedule schedule_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const Contents> contents_ ABSL_GUARDED_BY(mutex_);
  uint64_t version_ ABSL_GUARDED_BY(mutex_) = 1;
};

}  // namespace evpose::server
