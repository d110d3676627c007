// SPDX-License-Identifier: Apache-2.0

// Writes poses as text, and to files in the format of their extension.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/cli/common/pose_frame.h"
#include "core/base/output_file.h"
#include "evpose/types.h"

namespace evpose::client {

enum class PoseFormat { kTum, kCsv, kJsonLines };

// Parses .tum, .csv or .jsonl. Error: INVALID_ARGUMENT naming the extensions.
absl::StatusOr<PoseFormat> PoseFormatFromPath(const std::string& path);
// The header line, line feed included; empty for a format without a header. A file whose transform is not
// camera_from_object says so: TUM in a comment before the poses, CSV in the column `transform`, the last one, and JSON
// lines, as always, in the field `transform`.
std::string PoseHeader(PoseFormat format, const PoseFrame& frame = {});
// One line, line feed included; empty for an AMBIGUOUS pose in TUM, which has no states. It depends on the bytes of the
// session only, so that it does not contain the latency.
std::string PoseLine(PoseFormat format, const Pose& pose, const PoseFrame& frame = {});

// Writes the poses of the objects of a session as they arrive: to one file or, if the path contains "{object}", to one
// file for each object. A file appears under its name when it is complete.
class PoseFiles {
 public:
  // Errors: INVALID_ARGUMENT for an unknown extension, for a TUM file with several objects, and for an ID that cannot
  // be part of a file name.
  static absl::Status Check(const std::string& path, const std::vector<std::string>& object_ids);
  // With `kept_bytes`, continues the output of an earlier process: the number of bytes of each file, by object, that
  // Sync() returned. Additional errors: those of OutputFile.
  static absl::StatusOr<PoseFiles> Open(const std::string& path, const std::vector<std::string>& object_ids,
                                        const PoseFrame& frame = {},
                                        const std::map<std::string, uint64_t>* kept_bytes = nullptr);
  // The first error is kept and returned by Commit().
  void Write(const Pose& pose);
  // Writes all data to the disk; returns the sizes of the files, by object.
  absl::StatusOr<std::map<std::string, uint64_t>> Sync();
  absl::Status Commit();

  // The objects with files of their own, and the names of the files; the key of a single file for all objects is "".
  static std::map<std::string, std::string> Paths(const std::string& path, const std::vector<std::string>& object_ids);

 private:
  PoseFormat format_ = PoseFormat::kTum;
  PoseFrame frame_;
  std::map<std::string, OutputFile> files_;  // by object; "" for a single file
};

}  // namespace evpose::client
