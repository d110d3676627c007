// SPDX-License-Identifier: Apache-2.0
#include "core/base/output_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <filesystem>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "core/base/status_macros.h"
#include "core/base/temporary_files.h"

namespace evpose {
namespace {

absl::Status FileError(const std::string& path, absl::string_view what, int error_number) {
  return absl::ErrnoToStatus(error_number, absl::StrCat(path, ": ", what));
}

absl::Status CheckIsRegular(const std::string& path, const struct stat& info) {
  if (S_ISREG(info.st_mode)) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      path, S_ISDIR(info.st_mode) ? ": is a directory, not a file"
                                  : ": is a pipe or device, not a file; write its contents to a file first"));
}

// The process number and a counter: no two writers share a temporary name.
std::string TemporaryName(const std::string& path) {
  static std::atomic<uint64_t> counter = 0;
  return absl::StrCat(path, ".partial-", getpid(), "-", counter.fetch_add(1));
}

}  // namespace

absl::StatusOr<OutputFile> OutputFile::Create(const std::string& path) {
  OutputFile result;
  std::error_code error;
  // The target of a symbolic link is replaced, not the link.
  const std::filesystem::path resolved = std::filesystem::weakly_canonical(path, error);
  result.path_ = error ? path : resolved.string();
  if (std::filesystem::is_directory(result.path_, error)) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": is a directory, not a file to write"));
  }
  const bool direct =
      std::filesystem::exists(result.path_, error) && !std::filesystem::is_regular_file(result.path_, error);
  if (!direct) result.temporary_path_ = TemporaryName(result.path_);
  const std::string& name = direct ? result.path_ : result.temporary_path_;
  const int flags = O_WRONLY | O_CLOEXEC | (direct ? 0 : O_CREAT | O_EXCL);
  const int descriptor = open(name.c_str(), flags, 0666);
  if (descriptor < 0) {
    result.temporary_path_.clear();  // not created here, so not removed by Discard()
    return FileError(path, "cannot be written", errno);
  }
  if (!direct) RegisterTemporaryFile(result.temporary_path_);
  result.file_ = fdopen(descriptor, "wb");
  if (result.file_ == nullptr) {
    const int error_number = errno;
    close(descriptor);
    return FileError(path, "cannot be written", error_number);
  }
  return result;
}

absl::StatusOr<OutputFile> OutputFile::Continue(const std::string& path, uint64_t kept_bytes) {
  OutputFile result;
  std::error_code error;
  const std::filesystem::path resolved = std::filesystem::weakly_canonical(path, error);
  result.path_ = error ? path : resolved.string();
  if (std::filesystem::exists(result.path_, error) && !std::filesystem::is_regular_file(result.path_, error)) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": is not a regular file, so that it cannot be continued"));
  }
  result.is_continued_ = true;
  result.temporary_path_ = result.path_ + ".partial";
  const int flags = O_WRONLY | O_CLOEXEC | (kept_bytes == 0 ? O_CREAT : 0);
  const int descriptor = open(result.temporary_path_.c_str(), flags, 0666);
  if (descriptor < 0) return FileError(result.temporary_path_, "cannot be written", errno);
  struct stat info;
  if (fstat(descriptor, &info) != 0) info.st_size = 0;
  if (static_cast<uint64_t>(info.st_size) < kept_bytes) {
    close(descriptor);
    return absl::DataLossError(
        absl::StrCat(result.temporary_path_, ": has ", info.st_size, " bytes, but ", kept_bytes, " had been written"));
  }
  const bool is_placed =
      ftruncate(descriptor, static_cast<off_t>(kept_bytes)) == 0 && lseek(descriptor, 0, SEEK_END) >= 0;
  result.file_ = is_placed ? fdopen(descriptor, "wb") : nullptr;
  if (result.file_ == nullptr) {
    const int error_number = errno;
    close(descriptor);
    return FileError(result.temporary_path_, "cannot be written", error_number);
  }
  return result;
}

OutputFile::OutputFile(OutputFile&& other) noexcept { *this = std::move(other); }

OutputFile& OutputFile::operator=(OutputFile&& other) noexcept {
  if (this == &other) return *this;
  Discard();
  path_ = std::exchange(other.path_, {});
  temporary_path_ = std::exchange(other.temporary_path_, {});
  is_continued_ = other.is_continued_;
  file_ = std::exchange(other.file_, nullptr);
  status_ = std::exchange(other.status_, absl::OkStatus());
  return *this;
}

OutputFile::~OutputFile() { Discard(); }

void OutputFile::Discard() {
  if (file_ != nullptr) std::fclose(std::exchange(file_, nullptr));
  if (!temporary_path_.empty() && !is_continued_) {
    unlink(temporary_path_.c_str());
    UnregisterTemporaryFile(temporary_path_);
  }
  temporary_path_.clear();
}

void OutputFile::Remove() {
  is_continued_ = false;
  Discard();
}

absl::Status OutputFile::Append(std::string_view bytes) {
  if (!status_.ok()) return status_;
  if (!bytes.empty() && std::fwrite(bytes.data(), 1, bytes.size(), file_) != bytes.size()) {
    status_ = FileError(path_, "writing failed", errno);
  }
  return status_;
}

absl::Status OutputFile::Flush() {
  EVPOSE_RETURN_IF_ERROR(status_);
  if (std::fflush(file_) != 0) status_ = FileError(path_, "writing failed", errno);
  return status_;
}

absl::StatusOr<uint64_t> OutputFile::Sync() {
  EVPOSE_RETURN_IF_ERROR(Flush());
  struct stat info;
  if (fdatasync(fileno(file_)) != 0 || fstat(fileno(file_), &info) != 0) {
    return status_ = FileError(path_, "writing failed", errno);
  }
  return static_cast<uint64_t>(info.st_size);
}

absl::Status OutputFile::Commit() {
  EVPOSE_RETURN_IF_ERROR(status_);
  // fclose reports write errors that were delayed, a full disk in particular.
  if (std::fclose(std::exchange(file_, nullptr)) != 0) return status_ = FileError(path_, "writing failed", errno);
  if (temporary_path_.empty()) return absl::OkStatus();
  if (rename(temporary_path_.c_str(), path_.c_str()) != 0) {
    return status_ = FileError(path_, "cannot be renamed to its final name", errno);
  }
  UnregisterTemporaryFile(temporary_path_);
  temporary_path_.clear();
  return absl::OkStatus();
}

absl::Status WriteFile(const std::string& path, std::string_view contents) {
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(path));
  EVPOSE_RETURN_IF_ERROR(file.Append(contents));
  return file.Commit();
}

absl::Status CheckIsFile(const std::string& path) {
  struct stat info;
  if (stat(path.c_str(), &info) != 0) return FileError(path, "cannot be read", errno);
  return CheckIsRegular(path, info);
}

absl::StatusOr<std::string> ReadFile(const std::string& path, size_t max_bytes) {
  // Without O_NONBLOCK a named pipe is opened when a process writes to it, which may never happen.
  const int descriptor = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) return FileError(path, "cannot be read", errno);
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(fdopen(descriptor, "rb"), std::fclose);
  if (file == nullptr) {
    const int error_number = errno;
    close(descriptor);
    return FileError(path, "cannot be read", error_number);
  }
  struct stat info;
  if (fstat(descriptor, &info) == 0) EVPOSE_RETURN_IF_ERROR(CheckIsRegular(path, info));
  std::string contents;
  char buffer[1 << 16];
  for (size_t size; (size = std::fread(buffer, 1, sizeof(buffer), file.get())) > 0;) {
    if (contents.size() + size > max_bytes) {
      return absl::InvalidArgumentError(absl::StrCat(path, ": is larger than ", max_bytes, " bytes"));
    }
    contents.append(buffer, size);
  }
  if (std::ferror(file.get())) return FileError(path, "reading failed", errno);
  return contents;
}

}  // namespace evpose
