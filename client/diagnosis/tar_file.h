// SPDX-License-Identifier: Apache-2.0

// Archives of regular files in the POSIX format ustar (IEEE Std 1003.1, pax), which every tar program reads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/output_file.h"

namespace evpose::client {

// The archive appears under its name when Commit() succeeds. It contains no times, owners or permissions of the
// machine, so that the same files give the same bytes.
class TarWriter {
 public:
  // Errors: those of OutputFile::Create().
  static absl::StatusOr<TarWriter> Create(const std::string& path);
  // Adds a file. The first error is returned by Commit(): INVALID_ARGUMENT for a name of more than 99 bytes or contents
  // of 8 GiB or more, and those of OutputFile.
  void Add(const std::string& name, std::string_view contents);
  absl::Status Commit();

 private:
  explicit TarWriter(OutputFile file) : file_(std::move(file)) {}

  OutputFile file_;
  absl::Status status_;
};

// Returns the contents of the regular files of an archive by name. Writes nothing to the disk. Ignores directories.
// Errors: INVALID_ARGUMENT with the position in bytes for an invalid archive. Invalid are a wrong check sum; an end
// within a file or without the final block of zeros; and a link or another kind of member. So is a name that is
// absolute, leads out of the archive, occurs twice or has characters other than letters, digits, "._-" and "/".
absl::StatusOr<std::map<std::string, std::string>> ParseTar(std::string_view archive);
// The same for an archive in a file. Errors name the path; also those of ReadFile(), among them that for an archive of
// more than `max_bytes`.
absl::StatusOr<std::map<std::string, std::string>> ReadTar(const std::string& path, size_t max_bytes);

}  // namespace evpose::client
