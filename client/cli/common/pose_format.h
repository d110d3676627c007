// SPDX-License-Identifier: Apache-2.0

// Poses as text, and as files in the format of their ending.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/lib/types.h"
#include "core/base/output_file.h"

namespace evpose::client {

enum class PoseFormat { kTum, kCsv, kJsonLines };

// .tum or .txt, .csv, .jsonl. INVALID_ARGUMENT naming the endings.
absl::StatusOr<PoseFormat> PoseFormatFromPath(const std::string& path);
// The line before the first pose, line feed included; empty for a format without.
std::string PoseHeader(PoseFormat format);
// One line, line feed included. A function of the session's bytes: the latency is left out.
std::string PoseLine(PoseFormat format, const Pose& pose);

// Poses as they come, under a name that appears when all are there.
class PoseFile {
 public:
  static absl::StatusOr<PoseFile> Create(const std::string& path);
  // Goes on after `kept_bytes` of what an earlier process wrote; the errors of OutputFile::Continue().
  static absl::StatusOr<PoseFile> Continue(const std::string& path, uint64_t kept_bytes);
  // The first error stays and comes back from Commit().
  void Write(const Pose& pose);
  absl::StatusOr<uint64_t> Sync() { return file_.Sync(); }
  absl::Status Commit() { return file_.Commit(); }

 private:
  PoseFile(OutputFile file, PoseFormat format) : file_(std::move(file)), format_(format) {}

  OutputFile file_;
  PoseFormat format_;
};

// The poses of a session's objects: in one file, or, where the path says "{object}", in one for each.
class PoseFiles {
 public:
  // INVALID_ARGUMENT for an ending that is none, a TUM file for several objects, an ID that cannot be in a file's name.
  static absl::Status Check(const std::string& path, const std::vector<std::string>& object_ids);
  // The same, and the errors of PoseFile.
  static absl::StatusOr<PoseFiles> Create(const std::string& path, const std::vector<std::string>& object_ids);
  // Goes on with what an earlier process wrote: so many bytes of each file, by object as Sync() gave them.
  static absl::StatusOr<PoseFiles> Continue(const std::string& path, const std::vector<std::string>& object_ids,
                                            const std::map<std::string, uint64_t>& kept_bytes);
  // The first error stays and comes back from Commit().
  void Write(const Pose& pose);
  // What was written is on the disk; the sizes of the files, by object.
  absl::StatusOr<std::map<std::string, uint64_t>> Sync();
  absl::Status Commit();

  // The objects that have files of their own, with the files' names; of one file for all "".
  static std::map<std::string, std::string> Paths(const std::string& path, const std::vector<std::string>& object_ids);

 private:
  std::map<std::string, PoseFile> files_;  // by object; "" for all
};

}  // namespace evpose::client
