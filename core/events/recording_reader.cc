// SPDX-License-Identifier: Apache-2.0
#include "core/events/recording_reader.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <optional>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// Between two reads at the end of a growing file, or two calls of `stop`: short against a user's patience, long against
// the cost of a system call.
constexpr int kWait_ms = 10;
constexpr size_t kHeaderReadBytes = 4096;  // more than a camera's header

class DescriptorReader final : public RecordingReader {
 public:
  DescriptorReader(int descriptor, std::string name, RecordingReaderOptions options)
      : descriptor_(descriptor), name_(std::move(name)), options_(std::move(options)) {}
  ~DescriptorReader() override {
    if (descriptor_ != STDIN_FILENO) close(descriptor_);
  }

  // Reads the header and, unless following, the first byte after it.
  absl::Status Start() {
    if (fstat(descriptor_, &opened_) != 0) return Error(errno, "cannot be read");
    if (S_ISDIR(opened_.st_mode))
      return absl::InvalidArgumentError(absl::StrCat(name_, ": is a directory, not a recording"));
    is_regular_ = S_ISREG(opened_.st_mode);
    std::optional<RecordingHeader> header;
    while (!header.has_value()) {
      EVPOSE_ASSIGN_OR_RETURN(const bool is_end, ReadPrefix());
      if (is_end && stopped_) {
        return absl::CancelledError(absl::StrCat(name_, ": stopped before the end of its header"));
      }
      if (is_end && prefix_.empty()) return absl::InvalidArgumentError(absl::StrCat(name_, ": is empty"));
      auto parsed = ParseRecordingHeader(prefix_, is_end);
      if (!parsed.ok()) {
        return absl::Status(parsed.status().code(), absl::StrCat(name_, ": ", parsed.status().message()));
      }
      header = *std::move(parsed);
    }
    header_ = *std::move(header);
    if (is_regular_ && !options_.follow) data_size_bytes_ = opened_.st_size - static_cast<int64_t>(header_.size_bytes);
    prefix_.erase(0, header_.size_bytes);
    while (!options_.follow && prefix_.empty()) {
      EVPOSE_ASSIGN_OR_RETURN(const bool is_end, ReadPrefix());
      if (is_end) return absl::InvalidArgumentError(absl::StrCat(name_, ": has a header but no events"));
    }
    return absl::OkStatus();
  }

  const RecordingHeader& header() const override { return header_; }
  int64_t data_size_bytes() const override { return data_size_bytes_; }

  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    if (prefix_.empty()) return ReadDescriptor(buffer);
    const size_t size = prefix_.copy(reinterpret_cast<char*>(buffer.data()), buffer.size());
    prefix_.erase(0, size);
    return size;
  }

 private:
  // Appends the next bytes to prefix_; true at the end.
  absl::StatusOr<bool> ReadPrefix() {
    uint8_t buffer[kHeaderReadBytes];
    EVPOSE_ASSIGN_OR_RETURN(const size_t size, ReadDescriptor(absl::MakeSpan(buffer)));
    prefix_.append(reinterpret_cast<const char*>(buffer), size);
    return size == 0;
  }

  // Reads the next bytes; 0 at the end or if `stop` returned true.
  absl::StatusOr<size_t> ReadDescriptor(absl::Span<uint8_t> buffer) {
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
      if (!options_.follow || descriptor_ == STDIN_FILENO) {
        EVPOSE_RETURN_IF_ERROR(CheckUnchanged());
        return 0;
      }
      EVPOSE_RETURN_IF_ERROR(CheckNotShrunk());
      if (MustStop()) return 0;
      poll(nullptr, 0, kWait_ms);
    }
  }

  // Waits until there are bytes to read; false if `stop` returned true before.
  bool WaitForData() {
    pollfd events = {descriptor_, POLLIN, 0};
    for (int wait_ms = 0;; wait_ms = kWait_ms) {
      const int num_ready = poll(&events, 1, wait_ms);
      // A signal (EINTR) counts as a timeout: a read now would block without a call of `stop`. Another error is
      // reported by the read that follows.
      if (num_ready > 0 || (num_ready < 0 && errno != EINTR)) return true;
      if (MustStop()) return false;
    }
  }

  bool MustStop() {
    stopped_ = stopped_ || (options_.stop && options_.stop());
    return stopped_;
  }

  // What was read is a recording only if the file was the same from its first byte to its last.
  absl::Status CheckUnchanged() const {
    struct stat now = {}, named = {};
    if (fstat(descriptor_, &now) != 0) return Error(errno, "cannot be read");
    const timespec &before = opened_.st_mtim, &after = now.st_mtim;
    std::string change;
    if (now.st_size != opened_.st_size) {
      change = absl::StrCat("its size was ", opened_.st_size, " bytes and is ", now.st_size);
    } else if (before.tv_sec != after.tv_sec || before.tv_nsec != after.tv_nsec) {
      change = "it was written to";
    } else if (stat(name_.c_str(), &named) == 0 && (named.st_ino != now.st_ino || named.st_dev != now.st_dev)) {
      change = "another file has replaced it";
    } else {
      return absl::OkStatus();
    }
    return absl::DataLossError(absl::StrCat(name_, ": changed while it was read: ", change,
                                            "; read it again when it is complete, or with --follow as it grows"));
  }

  absl::Status CheckNotShrunk() const {
    struct stat info;
    if (fstat(descriptor_, &info) != 0) return Error(errno, "cannot be followed");
    if (info.st_size >= offset_) return absl::OkStatus();
    return absl::DataLossError(
        absl::StrCat(name_, ": shrank from ", offset_, " to ", info.st_size, " bytes while it was followed"));
  }

  absl::Status Error(int error_number, const std::string& what) const {
    return absl::UnavailableError(absl::StrCat(name_, ": ", what, ": ", std::generic_category().message(error_number)));
  }

  const int descriptor_;
  const std::string name_;
  const RecordingReaderOptions options_;
  struct stat opened_ = {};  // the file when it was opened
  bool is_regular_ = false;
  bool stopped_ = false;
  RecordingHeader header_;
  // The bytes that were read together with the header; after Start(), those of them that Read() has not returned.
  std::string prefix_;
  int64_t offset_ = 0;
  int64_t data_size_bytes_ = -1;
};

}  // namespace

absl::StatusOr<std::unique_ptr<RecordingReader>> RecordingReader::Open(const std::string& path,
                                                                       const RecordingReaderOptions& options) {
  if (path == "-") return OpenDescriptor(STDIN_FILENO, "standard input", options);
  const int descriptor = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) return absl::ErrnoToStatus(errno, absl::StrCat(path, ": cannot be read"));
  return OpenDescriptor(descriptor, path, options);
}

absl::StatusOr<std::unique_ptr<RecordingReader>> RecordingReader::OpenDescriptor(
    int descriptor, const std::string& name, const RecordingReaderOptions& options) {
  auto reader = std::make_unique<DescriptorReader>(descriptor, name, options);
  EVPOSE_RETURN_IF_ERROR(reader->Start());
  return reader;
}

}  // namespace evpose
