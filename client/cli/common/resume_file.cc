// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/resume_file.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/byte_order.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t kMaxBytes = 1 << 20;  // a record has a few kilobytes
constexpr uint32_t kVersion = 1;       // of the record; another one is refused

absl::Status Error(const std::string& path, const char* what) {
  return absl::ErrnoToStatus(errno, absl::StrCat(path, ": ", what));
}

uint32_t Checksum(const Json& json) {
  const std::string text = json.dump();
  return Crc32c(AsBytes(text));
}

// Json::get() converts any number, and the conversion of one outside the range is undefined.
template <typename Number>
absl::StatusOr<Number> WholeNumber(const Json& json, const char* field) {
  constexpr uint64_t kMax = std::numeric_limits<Number>::max();
  if (json.is_number_unsigned() && json.get<uint64_t>() <= kMax) return static_cast<Number>(json.get<uint64_t>());
  return absl::InvalidArgumentError(absl::StrCat("is damaged: ", field, " is not a whole number of at most ", kMax));
}

template <typename Number>
absl::Status ReadWholeNumber(const Json& json, const char* field, Number& value) {
  EVPOSE_ASSIGN_OR_RETURN(value, WholeNumber<Number>(json.at(field), field));
  return absl::OkStatus();
}

// File systems without this operation return EINVAL. A directory may be one that the user cannot read.
absl::Status SyncDirectoryOf(const std::string& path) {
  const std::filesystem::path parent = std::filesystem::path(path).parent_path();
  const int descriptor = open(parent.empty() ? "." : parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return absl::OkStatus();
  const bool has_failed = fsync(descriptor) != 0 && errno != EINVAL && errno != ENOTSUP;
  const absl::Status status = has_failed ? Error(path, "writing failed") : absl::OkStatus();
  close(descriptor);
  return status;
}

// When this returns, the content and the name of the file are on the disk; a crash leaves either the old file or the
// new one.
absl::Status WriteDurably(const std::string& path, const std::string& text) {
  const std::string temporary = path + ".new";
  const int descriptor = open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
  if (descriptor < 0) return Error(path, "cannot be written");
  size_t done = 0;
  while (done < text.size()) {
    const ssize_t size = write(descriptor, text.data() + done, text.size() - done);
    if (size < 0 && errno == EINTR) continue;
    if (size < 0) break;
    done += static_cast<size_t>(size);
  }
  const bool is_written = done == text.size() && fsync(descriptor) == 0;
  absl::Status status = is_written ? absl::OkStatus() : Error(path, "writing failed");
  close(descriptor);
  if (status.ok() && rename(temporary.c_str(), path.c_str()) != 0) status = Error(path, "cannot be renamed");
  if (status.ok()) return SyncDirectoryOf(path);
  unlink(temporary.c_str());
  return status;
}

bool IsRecord(const Json& json) { return json.is_object() && json.contains("evpose_resume"); }

// An error if the file exists and is none of this program, which could be any file of the user.
absl::Status CheckIsOwn(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return absl::OkStatus();
  const absl::StatusOr<std::string> text = ReadFile(path, kMaxBytes);
  if (text.ok() && IsRecord(Json::parse(*text, nullptr, false))) return absl::OkStatus();
  if (absl::IsPermissionDenied(text.status())) return text.status();
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": is not a file of --resume: give --resume the name of another file"));
}

// Whether `path` is still the name of the open file.
bool IsNamed(int descriptor, const std::string& path) {
  struct stat opened = {}, named = {};
  return fstat(descriptor, &opened) == 0 && stat(path.c_str(), &named) == 0 && opened.st_dev == named.st_dev &&
         opened.st_ino == named.st_ino;
}

// Returns a descriptor with the lock of the file `path`, until it is closed.
absl::StatusOr<int> Lock(const std::string& path) {
  const std::string lock_path = path + ".lock";
  while (true) {
    const int lock = open(lock_path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (lock < 0) return Error(path, "cannot be written");
    const bool is_locked = flock(lock, LOCK_EX | LOCK_NB) == 0;
    // Between open() and flock(), another process may have removed the file at its end, and a third one may have
    // created and locked a new one.
    if (is_locked && IsNamed(lock, lock_path)) return lock;
    close(lock);
    if (is_locked) continue;
    return absl::FailedPreconditionError(
        absl::StrCat(path, ": another evpose is using it: wait for its end, or give another file to --resume"));
  }
}

}  // namespace

std::string ResumeRecord::ToText() const {
  Json json;
  json["evpose_resume"] = kVersion;
  json["session"] = position.session;
  json["resume_token"] = position.resume_token;
  json["previous_token"] = position.previous_token;
  json["last_pose_seq"] = position.last_pose_seq;
  json["lost_poses"] = position.lost_poses;
  json["durable"] = {
      {"seq", position.durable.seq}, {"bytes", position.durable.bytes}, {"digest", position.durable.digest}};
  json["max_piece_bytes"] = position.max_piece_bytes;
  json["arguments"] = arguments;
  json["output_bytes"] = output_bytes;
  json["output_poses"] = output_poses;
  json["crc32c"] = Checksum(json);
  return json.dump(2) + "\n";
}

absl::StatusOr<ResumeRecord> ResumeRecord::FromText(const std::string& text) {
  Json json = Json::parse(text, nullptr, false);
  if (!IsRecord(json)) return absl::InvalidArgumentError("is not a file of --resume");
  EVPOSE_ASSIGN_OR_RETURN(const auto version, WholeNumber<uint32_t>(json["evpose_resume"], "evpose_resume"));
  if (version != kVersion) return absl::InvalidArgumentError("was written by another version of evpose");
  ResumeRecord record;
  try {
    EVPOSE_ASSIGN_OR_RETURN(const auto checksum, WholeNumber<uint32_t>(json.at("crc32c"), "crc32c"));
    json.erase("crc32c");
    if (checksum != Checksum(json)) return absl::InvalidArgumentError("is damaged: its checksum does not match");
    TrackPosition& position = record.position;
    position.session = json.at("session").get<std::string>();
    position.resume_token = json.at("resume_token").get<std::string>();
    position.previous_token = json.at("previous_token").get<std::string>();
    const Json& durable = json.at("durable");
    EVPOSE_RETURN_IF_ERROR(ReadWholeNumber(json, "last_pose_seq", position.last_pose_seq));
    EVPOSE_RETURN_IF_ERROR(ReadWholeNumber(json, "lost_poses", position.lost_poses));
    EVPOSE_RETURN_IF_ERROR(ReadWholeNumber(durable, "seq", position.durable.seq));
    EVPOSE_RETURN_IF_ERROR(ReadWholeNumber(durable, "bytes", position.durable.bytes));
    EVPOSE_RETURN_IF_ERROR(ReadWholeNumber(durable, "digest", position.durable.digest));
    EVPOSE_RETURN_IF_ERROR(ReadWholeNumber(json, "max_piece_bytes", position.max_piece_bytes));
    record.arguments = json.at("arguments").get<std::map<std::string, std::string>>();
    for (const auto& [path, bytes] : json.at("output_bytes").items()) {
      EVPOSE_ASSIGN_OR_RETURN(record.output_bytes[path], WholeNumber<uint64_t>(bytes, "output_bytes"));
      // A record of an earlier version shows only whether the client has received poses.
      record.output_poses[path] = position.last_pose_seq;
    }
    if (!json.contains("output_poses")) return record;
    record.output_poses.clear();
    for (const auto& [path, poses] : json.at("output_poses").items()) {
      EVPOSE_ASSIGN_OR_RETURN(record.output_poses[path], WholeNumber<uint64_t>(poses, "output_poses"));
    }
  } catch (const std::exception&) {  // its words would quote the file
    return absl::InvalidArgumentError("is damaged: a field is missing or of another kind");
  }
  return record;
}

absl::StatusOr<ResumeFile> ResumeFile::Open(const std::string& path) {
  EVPOSE_RETURN_IF_ERROR(CheckIsOwn(path));
  EVPOSE_ASSIGN_OR_RETURN(const int lock, Lock(path));
  ResumeFile file(path, lock);
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return file;
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxBytes));
  absl::StatusOr<ResumeRecord> record = ResumeRecord::FromText(text);
  if (!record.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", record.status().message(), ": remove the file, and a new session begins"));
  }
  file.record_ = *std::move(record);
  return file;
}

ResumeFile::ResumeFile(ResumeFile&& other) noexcept
    : path_(std::move(other.path_)), lock_(std::exchange(other.lock_, -1)), record_(std::move(other.record_)) {}

ResumeFile::~ResumeFile() {
  if (lock_ >= 0) close(lock_);
}

absl::Status ResumeFile::CheckArguments(const std::map<std::string, std::string>& arguments) const {
  for (const auto& [name, value] : arguments) {
    const auto recorded = record_->arguments.find(name);
    // An option that did not exist when the file was written was not given.
    if (recorded == record_->arguments.end() ? value.empty() : recorded->second == value) continue;
    return absl::InvalidArgumentError(absl::StrCat(path_, ": was started with another ", name,
                                                   ": give the same value, or remove the file to begin a new session"));
  }
  return absl::OkStatus();
}

absl::Status ResumeFile::Write(const ResumeRecord& record) { return WriteDurably(path_, record.ToText()); }

void ResumeFile::Remove() {
  unlink(path_.c_str());
  unlink((path_ + ".lock").c_str());
}

}  // namespace evpose::client
