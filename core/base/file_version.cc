// SPDX-License-Identifier: Apache-2.0
#include "core/base/file_version.h"

#include <cerrno>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose {

std::string DescribeFileChange(const struct stat& before, const struct stat& now) {
  if (now.st_ino != before.st_ino || now.st_dev != before.st_dev) return "another file has replaced it";
  if (now.st_size != before.st_size) {
    return absl::StrCat("its size was ", before.st_size, " bytes and is ", now.st_size);
  }
  const bool is_written = now.st_mtim.tv_sec != before.st_mtim.tv_sec || now.st_mtim.tv_nsec != before.st_mtim.tv_nsec;
  return is_written ? "it was written to" : "";
}

absl::StatusOr<FileVersion> FileVersion::Of(const std::string& path) {
  struct stat info = {};
  if (stat(path.c_str(), &info) == 0) return FileVersion(path, info);
  return absl::UnavailableError(absl::StrCat("cannot be read: ", std::generic_category().message(errno)));
}

absl::Status FileVersion::CheckUnchanged() const {
  EVPOSE_ASSIGN_OR_RETURN(const FileVersion present, Of(path_));
  const std::string change = DescribeFileChange(info_, present.info_);
  if (change.empty()) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat("changed while it was read: ", change, "; read it again when it is complete"));
}

}  // namespace evpose
