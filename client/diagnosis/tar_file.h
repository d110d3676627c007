// SPDX-License-Identifier: Apache-2.0

// Archives in the POSIX format ustar (IEEE Std 1003.1, pax) of regular files, which every tar reads.
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

// The archive appears under its name in Commit(), or not at all. It has neither times, owners nor permissions of the
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

// The contents of the regular files of an archive, by their names. Nothing is written to the disk. Members that are
// directories are left out. Errors: INVALID_ARGUMENT with the byte for what is no ustar archive: a wrong check sum, an
// end within a file or without the block of zeros that marks it, a name that is absolute, leads out of the archive or
// has other characters than letters, digits, "._-" and "/", a name twice, a link or another kind of member.
absl::StatusOr<std::map<std::string, std::string>> ParseTar(std::string_view archive);
// The same for a file. Errors have the path; also those of ReadFile(), for an archive of more than `max_bytes`, too.
absl::StatusOr<std::map<std::string, std::string>> ReadTar(const std::string& path, size_t max_bytes);

}  // namespace evpose::client
