// SPDX-License-Identifier: Apache-2.0

// Writes poses as text, and to files in the format of their extension.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/output_file.h"
#include "evpose/types.h"

namespace evpose::client {

enum class PoseFormat { kTum, kCsv, kJsonLines };

// Parses .tum or .txt, .csv, .jsonl. Error: INVALID_ARGUMENT naming the extensions.
absl::StatusOr<PoseFormat> PoseFormatFromPath(const std::string& path);
// The header line, line feed included; empty for a format without a header.
std::string PoseHeader(PoseFormat format);
// One line, line feed included. It depends on the bytes of the session only, so that it does not contain the latency.
std::string PoseLine(PoseFormat format, const Pose& pose);

// Writes poses as they arrive; the file appears under its name when it is complete.
class PoseFile {
 public:
  static absl::StatusOr<PoseFile> Create(const std::string& path);
  // Continues after the first `kept_bytes` of the output of an earlier process. Errors: those of
  // OutputFile::Continue().
  static absl::StatusOr<PoseFile> Continue(const std::string& path, uint64_t kept_bytes);
  // The first error is kept and returned by Commit().
  void Write(const Pose& pose);
  absl::StatusOr<uint64_t> Sync() { return file_.Sync(); }
  absl::Status Commit() { return file_.Commit(); }

 private:
  PoseFile(OutputFile file, PoseFormat format) : file_(std::move(file)), format_(format) {}

  OutputFile file_;
  PoseFormat format_;
};

// The poses of the objects of a session: in one file or, if the path contains "{object}", in one file for each object.
class PoseFiles {
 public:
  // Errors: INVALID_ARGUMENT for an unknown extension, for a TUM file with several objects, and for an ID that cannot
  // be part of a file name.
  static absl::Status Check(const std::string& path, const std::vector<std::string>& object_ids);
  // Additional errors: those of PoseFile.
  static absl::StatusOr<PoseFiles> Create(const std::string& path, const std::vector<std::string>& object_ids);
  // Continues the output of an earlier process, with the number of bytes of each file, by object, that Sync() returned.
  static absl::StatusOr<PoseFiles> Continue(const std::string& path, const std::vector<std::string>& object_ids,
                                            const std::map<std::string, uint64_t>& kept_bytes);
  // The first error is kept and returned by Commit().
  void Write(const Pose& pose);
  // Writes all data to the disk; returns the sizes of the files, by object.
  absl::StatusOr<std::map<std::string, uint64_t>> Sync();
  absl::Status Commit();

  // The objects with files of their own, and the names of the files; the key of a single file for all objects is "".
  static std::map<std::string, std::string> Paths(const std::string& path, const std::vector<std::string>& object_ids);

 private:
  std::map<std::string, PoseFile> files_;  // by object; "" for a single file
};

}  // namespace evpose::client
