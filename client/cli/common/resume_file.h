// SPDX-License-Identifier: Apache-2.0

// How far a session is, in a file: what a client that was killed goes on from.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lib/track.h"

namespace evpose::client {

struct ResumeRecord {
  TrackPosition position;
  uint64_t max_piece_bytes = 0;  // by which the chunks were cut
  // What the run was begun with, by the option's name: the same is needed to go on.
  std::map<std::string, std::string> arguments;
  std::map<std::string, uint64_t> output_bytes;  // PoseFiles::Sync() at `position`

  std::string ToText() const;
  // INVALID_ARGUMENT saying what is wrong.
  static absl::StatusOr<ResumeRecord> FromText(const std::string& text);
};

// Holds a lock beside the file for as long as it lives.
class ResumeFile {
 public:
  // Errors name the path: INVALID_ARGUMENT for a file that is no such record or was damaged; FAILED_PRECONDITION when
  // another process has it; NOT_FOUND and the like when it cannot be written there.
  static absl::StatusOr<ResumeFile> Open(const std::string& path);
  ResumeFile(ResumeFile&& other) noexcept;
  ResumeFile& operator=(ResumeFile&&) = delete;
  ~ResumeFile();

  const std::string& path() const { return path_; }
  const std::optional<ResumeRecord>& record() const { return record_; }  // what was there
  // INVALID_ARGUMENT naming the first argument that is another than in the record.
  absl::Status CheckArguments(const std::map<std::string, std::string>& arguments) const;

  // The file has this record or the one before, whatever happens, and is readable by its owner only: the record has the
  // session's tokens.
  absl::Status Write(const ResumeRecord& record);
  // The session is done.
  void Remove();

 private:
  ResumeFile(const std::string& path, int lock) : path_(path), lock_(lock) {}

  std::string path_;
  int lock_ = -1;
  std::optional<ResumeRecord> record_;
};

}  // namespace evpose::client
