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
#include "core/base/byte_order.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

constexpr uint32_t kMagic = 0x31505645;  // "EVP1"
constexpr size_t kHeaderBytes = 44;
constexpr char kSuffix[] = ".spool";
// Flags of a record.
constexpr uint32_t kDiscontinuityFlag = 1;
constexpr uint32_t kResetFlag = 2;
// A file of the smallest spool has at least 128 KiB, so that few chunks need a new file.
constexpr uint64_t kMinBytes = 16 << 20;
// A number of files that can remain open.
constexpr uint64_t kMaxSegments = 128;

uint32_t Crc(const char* data, size_t size) { return Crc32c(AsBytes({data, size})); }

// Calls `transfer(done)`, which reads or writes from this position on, until `size` bytes are done. Returns false at
// the end of the file, where errno is unchanged, and on errors, of which errno has the cause.
template <typename Transfer>
bool TransferAll(size_t size, const Transfer& transfer) {
  for (size_t done = 0; done < size;) {
    const ssize_t part = transfer(done);
    if (part < 0 && errno == EINTR) continue;
    if (part <= 0) return false;
    done += static_cast<size_t>(part);
  }
  return true;
}

bool WriteAll(int descriptor, const std::string& bytes, uint64_t offset) {
  return TransferAll(bytes.size(), [&](size_t done) {
    return pwrite(descriptor, bytes.data() + done, bytes.size() - done, static_cast<off_t>(offset + done));
  });
}

// Fills `bytes`.
bool ReadAll(int descriptor, std::string& bytes, uint64_t offset) {
  return TransferAll(bytes.size(), [&](size_t done) {
    return pread(descriptor, bytes.data() + done, bytes.size() - done, static_cast<off_t>(offset + done));
  });
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
    StateWriter header;
    const uint32_t flags = (discontinuity ? kDiscontinuityFlag : 0) | (is_reset ? kResetFlag : 0);
    header(kMagic, payload_bytes, end.seq, end.bytes, end.digest, flags, crc32c);
    std::string bytes = header.Take();
    StateWriter checksum;
    checksum(Crc(bytes.data(), bytes.size()));
    return bytes + checksum.Take();
  }

  // `header` has kHeaderBytes.
  static bool Decode(absl::string_view header, Record& record) {
    StateReader reader(header);
    uint32_t magic = 0, flags = 0, header_crc32c = 0;
    reader(magic, record.payload_bytes, record.end.seq, record.end.bytes, record.end.digest, flags, record.crc32c,
           header_crc32c);
    record.discontinuity = (flags & kDiscontinuityFlag) != 0;
    record.is_reset = (flags & kResetFlag) != 0;
    return magic == kMagic && header_crc32c == Crc(header.data(), header.size() - sizeof(header_crc32c)) &&
           record.end.seq > 0;
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
    // If this fails, the incomplete record, which has no valid checksum, stays until Recover() removes it.
    [[maybe_unused]] const int ignored = ftruncate(segment.descriptor, static_cast<off_t>(segment.size_bytes));
    return status;
  }
  segment.size_bytes += bytes.size();
  total_bytes_ += bytes.size();
  last_ = chunk.end;
  return absl::OkStatus();
}

absl::Status Spool::Damaged(const Segment& segment, uint64_t offset) const {
  return absl::DataLossError(absl::StrCat(segment.path.empty() ? options_.directory : segment.path,
                                          ": the spool is damaged at byte ", offset));
}

absl::StatusOr<Spool::Record> Spool::ReadHeader(const Segment& segment, uint64_t offset) const {
  std::string header(kHeaderBytes, '\0');
  Record record;
  if (!ReadAll(segment.descriptor, header, offset) || !Record::Decode(header, record)) return Damaged(segment, offset);
  struct stat info;
  // Checked before memory of that size is allocated.
  if (fstat(segment.descriptor, &info) != 0 || offset + kHeaderBytes > static_cast<uint64_t>(info.st_size) ||
      record.payload_bytes > static_cast<uint64_t>(info.st_size) - offset - kHeaderBytes) {
    return Damaged(segment, offset);
  }
  return record;
}

absl::StatusOr<OutgoingChunk> Spool::ReadChunk(const Segment& segment, uint64_t offset) const {
  EVPOSE_ASSIGN_OR_RETURN(const Record record, ReadHeader(segment, offset));
  OutgoingChunk chunk{record.end, record.discontinuity, record.crc32c, std::string(record.payload_bytes, '\0'),
                      record.is_reset};
  if (!ReadAll(segment.descriptor, chunk.payload, offset + kHeaderBytes) ||
      Crc(chunk.payload.data(), chunk.payload.size()) != chunk.crc32c) {
    return Damaged(segment, offset);
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

void Spool::Release(uint64_t seq) {
  while (segments_.size() > 1 && segments_[1].first_seq <= seq + 1) RemoveFront();
  if (segments_.size() == 1 && !options_.outlives_process && last_.seq <= seq) RemoveFront();
}

}  // namespace evpose::client
