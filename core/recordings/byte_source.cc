// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/byte_source.h"

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "core/base/file_version.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// Time between two reads at the end of a growing file, or two calls of `stop`. A user does not notice it, and it is
// long compared with a system call.
constexpr int kWaitMs = 10;
constexpr size_t kPeekReadBytes = 4096;  // more than a camera's header

}  // namespace

absl::StatusOr<std::unique_ptr<ByteSource>> ByteSource::Open(const std::string& path,
                                                             const RecordingReaderOptions& options) {
  if (path == "-") return OpenDescriptor(STDIN_FILENO, "standard input", options);
  // A pipe with a name is opened without a writer, which is waited for as for its bytes.
  const int descriptor = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) return absl::ErrnoToStatus(errno, absl::StrCat(path, ": cannot be read"));
  return OpenDescriptor(descriptor, path, options);
}

absl::StatusOr<std::unique_ptr<ByteSource>> ByteSource::OpenDescriptor(int descriptor, const std::string& name,
                                                                       const RecordingReaderOptions& options) {
  std::unique_ptr<ByteSource> source(new ByteSource(descriptor, name, options));
  if (fstat(descriptor, &source->opened_) != 0) return source->Error(errno, "cannot be read");
  if (S_ISDIR(source->opened_.st_mode)) {
    return absl::InvalidArgumentError(absl::StrCat(name, ": is a directory, not a recording"));
  }
  // In a program that was started with a closed standard input, a library may have got its descriptor before main(),
  // for an object that is no file, such as an eventfd.
  if ((source->opened_.st_mode & S_IFMT) == 0) return absl::InvalidArgumentError(absl::StrCat(name, ": is closed"));
  source->is_regular_ = S_ISREG(source->opened_.st_mode);
  return source;
}

ByteSource::~ByteSource() {
  if (descriptor_ != STDIN_FILENO) close(descriptor_);
}

absl::StatusOr<std::string_view> ByteSource::Peek(size_t num_bytes) {
  uint8_t buffer[kPeekReadBytes];
  while (peeked_.size() < num_bytes) {
    EVPOSE_ASSIGN_OR_RETURN(const size_t size, ReadDescriptor(absl::MakeSpan(buffer)));
    if (size == 0) break;
    peeked_.append(reinterpret_cast<const char*>(buffer), size);
  }
  return peeked_;
}

absl::Status ByteSource::Seek(int64_t offset) {
  if (lseek(descriptor_, offset, SEEK_SET) != offset) return Error(errno, absl::StrCat("has no byte ", offset));
  peeked_.clear();
  offset_ = offset;
  return absl::OkStatus();
}

void ByteSource::Drop(size_t num_bytes) { peeked_.erase(0, num_bytes); }

absl::StatusOr<size_t> ByteSource::Read(absl::Span<uint8_t> buffer) {
  if (peeked_.empty()) return ReadDescriptor(buffer);
  const size_t size = peeked_.copy(reinterpret_cast<char*>(buffer.data()), buffer.size());
  peeked_.erase(0, size);
  return size;
}

absl::StatusOr<size_t> ByteSource::ReadDescriptor(absl::Span<uint8_t> buffer) {
  if (buffer.empty()) return 0;
  while (true) {
    if (!is_regular_ && !WaitForData()) return 0;
    const ssize_t size = read(descriptor_, buffer.data(), buffer.size());
    if (size > 0) {
      offset_ += size;
      return static_cast<size_t>(size);
    }
    if (size < 0 && errno != EINTR && errno != EAGAIN) {
      return Error(errno, absl::StrCat("reading failed at byte ", offset_));
    }
    if (size < 0) continue;
    // Only a file that was opened by its name is followed, not a file that is standard input.
    if (!is_regular_) return 0;
    if (!options_.is_following || descriptor_ == STDIN_FILENO) {
      EVPOSE_RETURN_IF_ERROR(CheckUnchanged());
      return 0;
    }
    EVPOSE_RETURN_IF_ERROR(CheckNotShrunk());
    if (MustStop()) return 0;
    poll(nullptr, 0, kWaitMs);
  }
}

bool ByteSource::WaitForData() {
  pollfd events = {descriptor_, POLLIN, 0};
  for (int wait_ms = 0;; wait_ms = kWaitMs) {
    const int num_ready = poll(&events, 1, wait_ms);
    // A signal (EINTR) counts as a timeout: a read now would block without a call of `stop`. Another error is
    // reported by the read that follows.
    if (num_ready > 0 || (num_ready < 0 && errno != EINTR)) return true;
    if (MustStop()) return false;
  }
}

bool ByteSource::MustStop() {
  is_stopped_ = is_stopped_ || (options_.stop && options_.stop());
  return is_stopped_;
}

absl::Status ByteSource::CheckUnchanged() const {
  struct stat now = {}, named = {};
  if (fstat(descriptor_, &now) != 0) return Error(errno, "cannot be read");
  std::string change = DescribeFileChange(opened_, now);
  if (change.empty() && stat(name_.c_str(), &named) == 0) change = DescribeFileChange(now, named);
  if (change.empty()) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(name_, ": changed while it was read: ", change,
                                          "; read it again when it is complete, or with --follow as it grows"));
}

absl::Status ByteSource::CheckNotShrunk() const {
  struct stat info;
  if (fstat(descriptor_, &info) != 0) return Error(errno, "cannot be followed");
  if (info.st_size >= offset_) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat(name_, ": shrank from ", offset_, " to ", info.st_size, " bytes while it was followed"));
}

absl::Status ByteSource::Error(int error_number, const std::string& what) const {
  return absl::UnavailableError(absl::StrCat(name_, ": ", what, ": ", std::generic_category().message(error_number)));
}

}  // namespace evpose
