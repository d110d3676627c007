// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/spool.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

constexpr uint32_t kMagic = 0x31505645;  // "EVP1"
constexpr size_t kHeaderBytes = 44;
constexpr char kSuffix[] = ".spool";
// Flags of a record.
constexpr uint64_t kDiscontinuityFlag = 1;
constexpr uint64_t kResetFlag = 2;
constexpr uint64_t kMinBytes = 16 << 20;
// A number of files that can remain open.
constexpr uint64_t kMaxSegments = 128;

void Put(std::string& out, uint64_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out.push_back(static_cast<char>(value >> (8 * i)));
}

uint64_t Get(const char* in, int bytes) {
  uint64_t value = 0;
  for (int i = 0; i < bytes; ++i) value |= uint64_t{static_cast<uint8_t>(in[i])} << (8 * i);
  return value;
}

uint32_t Crc(const char* data, size_t size) { return Crc32c({reinterpret_cast<const uint8_t*>(data), size}); }

// Returns whether all bytes were written; errno has the cause otherwise.
bool WriteAll(int descriptor, const std::string& bytes, uint64_t offset) {
  for (size_t done = 0; done < bytes.size();) {
    const ssize_t size =
        pwrite(descriptor, bytes.data() + done, bytes.size() - done, static_cast<off_t>(offset + done));
    if (size < 0 && errno == EINTR) continue;
    if (size < 0) return false;
    done += static_cast<size_t>(size);
  }
  return true;
}

// Returns false with errno 0 at the end of the file.
bool ReadAll(int descriptor, char* bytes, size_t size, uint64_t offset) {
  for (size_t done = 0; done < size;) {
    const ssize_t part = pread(descriptor, bytes + done, size - done, static_cast<off_t>(offset + done));
    if (part < 0 && errno == EINTR) continue;
    if (part == 0) errno = 0;
    if (part <= 0) return false;
    done += static_cast<size_t>(part);
  }
  return true;
}

}  // namespace

struct Spool::Record {
  FeedPoint end;
  bool discontinuity = false;
  bool is_reset = false;
  uint32_t crc32c = 0;
  uint64_t payload_bytes = 0;

  uint64_t size_bytes() const { return kHeaderBytes + payload_bytes; }

  std::string Encode() const {
    std::string header;
    Put(header, kMagic, 4);
    Put(header, payload_bytes, 8);
    Put(header, end.seq, 8);
    Put(header, end.bytes, 8);
    Put(header, end.digest, 4);
    Put(header, (discontinuity ? kDiscontinuityFlag : 0) | (is_reset ? kResetFlag : 0), 4);
    Put(header, crc32c, 4);
    Put(header, Crc(header.data(), header.size()), 4);
    return header;
  }

  static bool Decode(const char* header, Record& record) {
    if (Get(header, 4) != kMagic || Get(header + 40, 4) != Crc(header, 40)) return false;
    record.payload_bytes = Get(header + 4, 8);
    record.end = {Get(header + 12, 8), Get(header + 20, 8), static_cast<uint32_t>(Get(header + 28, 4))};
    record.discontinuity = (Get(header + 32, 4) & kDiscontinuityFlag) != 0;
    record.is_reset = (Get(header + 32, 4) & kResetFlag) != 0;
    record.crc32c = static_cast<uint32_t>(Get(header + 36, 4));
    return record.end.seq > 0;
  }
};

absl::Status SpoolOptions::Validate() const {
  if (directory.empty()) return absl::InvalidArgumentError("the spool's directory is empty");
  if (max_bytes < kMinBytes) return absl::InvalidArgumentError(absl::StrCat("max_bytes must be at least ", kMinBytes));
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<Spool>> Spool::Open(const SpoolOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  std::unique_ptr<Spool> spool(new Spool(options));
  if (mkdir(options.directory.c_str(), 0700) != 0 && errno != EEXIST) {
    return spool->Error(options.directory, "the spool's directory cannot be made");
  }
  EVPOSE_RETURN_IF_ERROR(spool->CheckWritable());
  if (options.outlives_process) EVPOSE_RETURN_IF_ERROR(spool->Recover());
  return spool;
}

Spool::~Spool() {
  for (const Segment& segment : segments_) close(segment.descriptor);
}

absl::Status Spool::Error(const std::string& path, const std::string& what) const {
  return absl::ErrnoToStatus(errno, absl::StrCat(path, ": ", what));
}

// Reports a spool that cannot be written at the start, not during the first outage hours later.
absl::Status Spool::CheckWritable() {
  std::string name = options_.directory + "/probe-XXXXXX";
  const int descriptor = mkstemp(name.data());
  if (descriptor < 0) return Error(options_.directory, "the spool cannot be written");
  unlink(name.c_str());
  close(descriptor);
  return absl::OkStatus();
}

absl::Status Spool::Recover() {
  std::vector<std::string> paths;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(options_.directory, error)) {
    if (absl::EndsWith(entry.path().string(), kSuffix)) paths.push_back(entry.path().string());
  }
  if (error) return absl::UnavailableError(absl::StrCat(options_.directory, ": cannot be listed: ", error.message()));
  std::sort(paths.begin(), paths.end());  // a name is the number of the first chunk, in 20 digits
  for (const std::string& path : paths) EVPOSE_RETURN_IF_ERROR(RecoverSegment(path, path == paths.back()));
  return absl::OkStatus();
}

absl::Status Spool::RecoverSegment(const std::string& path, bool is_last) {
  Segment segment{path, open(path.c_str(), O_RDWR | O_CLOEXEC)};
  if (segment.descriptor < 0) return Error(path, "the spool cannot be read");
  struct stat info;
  if (fstat(segment.descriptor, &info) != 0) info.st_size = 0;
  const auto size_bytes = static_cast<uint64_t>(info.st_size);
  segments_.push_back(std::move(segment));
  Segment& added = segments_.back();
  while (added.size_bytes < size_bytes) {
    const absl::StatusOr<OutgoingChunk> chunk = ReadChunk(added, added.size_bytes);
    const bool follows = chunk.ok() && (last_.seq == 0 || chunk->end.seq == last_.seq + 1);
    if (!follows && !is_last) {
      return absl::DataLossError(absl::StrCat(path, ": damaged at byte ", added.size_bytes, "; without the directory ",
                                              options_.directory, " a new session begins"));
    }
    if (!follows) break;
    if (added.first_seq == 0) added.first_seq = chunk->end.seq;
    last_ = chunk->end;
    added.size_bytes += kHeaderBytes + chunk->payload.size();
  }
  dropped_tail_bytes_ += size_bytes - added.size_bytes;
  if (added.size_bytes < size_bytes && ftruncate(added.descriptor, static_cast<off_t>(added.size_bytes)) != 0) {
    return Error(path, "the spool cannot be written");
  }
  total_bytes_ += added.size_bytes;
  if (added.first_seq == 0) {  // empty
    unlink(path.c_str());
    close(added.descriptor);
    segments_.pop_back();
  }
  return absl::OkStatus();
}

absl::Status Spool::AddSegment(uint64_t first_seq) {
  Segment segment;
  segment.first_seq = first_seq;
  if (options_.outlives_process) {
    segment.path = absl::StrFormat("%s/%020d%s", options_.directory, first_seq, kSuffix);
    segment.descriptor = open(segment.path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  } else {
    std::string name = options_.directory + "/evpose-XXXXXX";
    segment.descriptor = mkostemp(name.data(), O_CLOEXEC);
    if (segment.descriptor >= 0) unlink(name.c_str());
  }
  if (segment.descriptor < 0) return Error(options_.directory, "the spool cannot be written");
  segments_.push_back(std::move(segment));
  return absl::OkStatus();
}

bool Spool::HasRoomFor(const OutgoingChunk& chunk) const {
  return total_bytes_ + kHeaderBytes + chunk.payload.size() <= options_.max_bytes;
}

absl::Status Spool::Append(const OutgoingChunk& chunk) {
  if (segments_.empty() || segments_.back().size_bytes >= options_.max_bytes / kMaxSegments) {
    EVPOSE_RETURN_IF_ERROR(AddSegment(chunk.end.seq));
  }
  Segment& segment = segments_.back();
  std::string bytes =
      Record{chunk.end, chunk.discontinuity, chunk.is_reset, chunk.crc32c, chunk.payload.size()}.Encode();
  bytes += chunk.payload;
  if (!WriteAll(segment.descriptor, bytes, segment.size_bytes)) {
    const absl::Status status = Error(options_.directory, "the spool cannot be written");
    // Best effort: the incomplete record has no valid checksum, and the next record overwrites it.
    if (ftruncate(segment.descriptor, static_cast<off_t>(segment.size_bytes)) != 0) return status;
    return status;
  }
  segment.size_bytes += bytes.size();
  total_bytes_ += bytes.size();
  last_ = chunk.end;
  return absl::OkStatus();
}

absl::StatusOr<Spool::Record> Spool::ReadHeader(const Segment& segment, uint64_t offset) const {
  const auto damaged = [&] {
    return absl::DataLossError(absl::StrCat(segment.path.empty() ? options_.directory : segment.path,
                                            ": the spool is damaged at byte ", offset));
  };
  char header[kHeaderBytes];
  Record record;
  if (!ReadAll(segment.descriptor, header, sizeof(header), offset) || !Record::Decode(header, record)) return damaged();
  struct stat info;
  // Checked before memory of that size is allocated.
  if (fstat(segment.descriptor, &info) != 0 || offset + kHeaderBytes > static_cast<uint64_t>(info.st_size) ||
      record.payload_bytes > static_cast<uint64_t>(info.st_size) - offset - kHeaderBytes) {
    return damaged();
  }
  return record;
}

absl::StatusOr<OutgoingChunk> Spool::ReadChunk(const Segment& segment, uint64_t offset) const {
  EVPOSE_ASSIGN_OR_RETURN(const Record record, ReadHeader(segment, offset));
  OutgoingChunk chunk{record.end, record.discontinuity, record.crc32c, std::string(record.payload_bytes, '\0'),
                      record.is_reset};
  if (!ReadAll(segment.descriptor, chunk.payload.data(), chunk.payload.size(), offset + kHeaderBytes) ||
      Crc(chunk.payload.data(), chunk.payload.size()) != chunk.crc32c) {
    return absl::DataLossError(absl::StrCat(segment.path.empty() ? options_.directory : segment.path,
                                            ": the spool is damaged at byte ", offset));
  }
  return chunk;
}

absl::StatusOr<const Spool::Segment*> Spool::Seek(uint64_t seq, Cursor& cursor) const {
  const auto after = std::upper_bound(segments_.begin(), segments_.end(), seq,
                                      [](uint64_t value, const Segment& each) { return value < each.first_seq; });
  if (after == segments_.begin() || seq > last_.seq) {
    return absl::InternalError(absl::StrCat("the spool has no chunk ", seq));
  }
  const Segment& segment = *std::prev(after);
  if (cursor.seq <= segment.first_seq || cursor.seq > seq) cursor = {segment.first_seq, 0};
  for (; cursor.seq < seq; ++cursor.seq) {
    EVPOSE_ASSIGN_OR_RETURN(const Record record, ReadHeader(segment, cursor.offset));
    cursor.offset += record.size_bytes();
  }
  return &segment;
}

absl::StatusOr<OutgoingChunk> Spool::Read(uint64_t seq) {
  EVPOSE_ASSIGN_OR_RETURN(const Segment* const segment, Seek(seq, read_cursor_));
  return ReadChunk(*segment, read_cursor_.offset);
}

absl::StatusOr<FeedPoint> Spool::PointAfter(uint64_t seq) {
  EVPOSE_ASSIGN_OR_RETURN(const Segment* const segment, Seek(seq, point_cursor_));
  EVPOSE_ASSIGN_OR_RETURN(const Record record, ReadHeader(*segment, point_cursor_.offset));
  return record.end;
}

void Spool::RemoveFront() {
  Segment& front = segments_.front();
  if (!front.path.empty()) unlink(front.path.c_str());
  close(front.descriptor);
  total_bytes_ -= front.size_bytes;
  segments_.pop_front();
}

void Spool::Clear() {
  while (!segments_.empty()) RemoveFront();
}

void Spool::Forget(uint64_t seq) {
  while (segments_.size() > 1 && segments_[1].first_seq <= seq + 1) RemoveFront();
  if (segments_.size() == 1 && !options_.outlives_process && last_.seq <= seq) RemoveFront();
}

}  // namespace evpose::client
