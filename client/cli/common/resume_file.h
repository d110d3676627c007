// SPDX-License-Identifier: Apache-2.0

// A file with the position of a session, from which a client continues after a kill.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "evpose/track.h"

namespace evpose::client {

struct ResumeRecord {
  TrackPosition position;
  // The arguments of the run, by the name of the option: a run that continues needs the same ones.
  std::map<std::string, std::string> arguments;
  std::map<std::string, uint64_t> output_bytes;  // PoseFiles::Sync() at `position`
  std::map<std::string, uint64_t> output_poses;  // PoseFiles::num_poses() at `position`

  std::string ToText() const;
  // Error: INVALID_ARGUMENT describing the invalid content.
  static absl::StatusOr<ResumeRecord> FromText(const std::string& text);
};

// Holds a lock file beside the file during its lifetime.
class ResumeFile {
 public:
  // Errors name the path: INVALID_ARGUMENT for a file that is not such a record or is damaged; FAILED_PRECONDITION if
  // another process holds the lock; NOT_FOUND and similar codes if the file cannot be written.
  static absl::StatusOr<ResumeFile> Open(const std::string& path);
  ResumeFile(ResumeFile&& other) noexcept;
  ResumeFile& operator=(ResumeFile&&) = delete;
  ~ResumeFile();

  const std::string& path() const { return path_; }
  const std::optional<ResumeRecord>& record() const { return record_; }  // the record at the time of opening
  // Error: INVALID_ARGUMENT naming the first argument that differs from that of the record.
  absl::Status CheckArguments(const std::map<std::string, std::string>& arguments) const;

  // Replaces the record atomically. Only the owner can read the file, because the record contains the tokens of the
  // session.
  absl::Status Write(const ResumeRecord& record);
  // Removes the file at the end of the session.
  void Remove();

 private:
  ResumeFile(const std::string& path, int lock) : path_(path), lock_(lock) {}

  std::string path_;
  int lock_ = -1;
  std::optional<ResumeRecord> record_;
};

}  // namespace evpose::client
