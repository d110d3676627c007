// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/data_directory.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

constexpr mode_t kOwnerOnlyDirectory = 0700;
constexpr mode_t kOwnerOnlyFile = 0600;

// Thread-safe, unlike strerror().
std::string Words(int error) { return std::generic_category().message(error); }

absl::Status PathError(const std::string& path, int error) {
  const std::string message = absl::StrCat("data directory ", path, ": ", Words(error));
  switch (error) {
    case ENOENT:
      return absl::NotFoundError(absl::StrCat(message, ": make the directory above it, or choose another --data-dir"));
    case ENOTDIR:
    case EEXIST:
      return absl::FailedPreconditionError(absl::StrCat(message, ": choose another --data-dir"));
    case ENOSPC:
    case EDQUOT:
      return absl::ResourceExhaustedError(absl::StrCat(message, ": free space on its disk"));
    default:
      return absl::PermissionDeniedError(
          absl::StrCat(message, ": let the server's user write there, or choose another --data-dir"));
  }
}

absl::Status MakeDirectory(const std::string& path) {
  if (mkdir(path.c_str(), kOwnerOnlyDirectory) == 0) return absl::OkStatus();
  const int error = errno;
  struct stat found = {};
  if (error == EEXIST && stat(path.c_str(), &found) == 0 && S_ISDIR(found.st_mode)) return absl::OkStatus();
  return PathError(path, error == EEXIST ? ENOTDIR : error);
}

}  // namespace

absl::StatusOr<std::unique_ptr<DataDirectory>> DataDirectory::Open(const std::string& path) {
  if (path.empty()) return absl::InvalidArgumentError("the SQLite store needs a directory: give --data-dir");
  EVPOSE_RETURN_IF_ERROR(MakeDirectory(path));
  // The lock is on a separate file, because SQLite's file may be renamed while the lock is held.
  const std::string lock_path = path + "/evpose.lock";
  const int descriptor = open(lock_path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, kOwnerOnlyFile);
  if (descriptor < 0) return PathError(path, errno);
  std::unique_ptr<DataDirectory> directory(new DataDirectory(path, descriptor));
  if (flock(descriptor, LOCK_EX | LOCK_NB) == 0) return directory;
  if (errno != EWOULDBLOCK) return PathError(path, errno);
  return absl::FailedPreconditionError(absl::StrCat(
      "data directory ", path, " is in use by another server: stop that one, or give this one its own --data-dir"));
}

DataDirectory::~DataDirectory() { close(lock_descriptor_); }

absl::Status MakePrivateFile(const std::string& path) {
  const int descriptor = open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, kOwnerOnlyFile);
  if (descriptor < 0) {
    return absl::PermissionDeniedError(
        absl::StrCat(path, ": ", Words(errno), ": let the server's user write it, or choose another --data-dir"));
  }
  close(descriptor);
  return absl::OkStatus();
}

}  // namespace evpose::server
