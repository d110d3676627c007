// SPDX-License-Identifier: Apache-2.0

// Stores chunks in the files of a directory: chunks that exceed the memory, or that must survive the process.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lib/stream/outgoing_chunk.h"

namespace evpose::client {

struct SpoolOptions {
  std::string directory;  // created with mode 0700 if it does not exist; its files have mode 0600
  // Limit of all files together, at least 16 MiB; each file has at most about a 128th of it.
  uint64_t max_bytes = 8ull << 30;
  // Whether the files have names, so that the next Open() finds them. Otherwise they are unlinked, and the disk space
  // is released when the process ends for any reason. They are not synced: a power failure loses the last chunks.
  bool outlives_process = false;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// A queue of chunks with consecutive numbers. Each record has checksums. Not thread-safe.
class Spool {
 public:
  // Errors name the directory: PERMISSION_DENIED and similar codes if it is not writable; DATA_LOSS naming the file and
  // the offset if the data of an earlier process is damaged. An incomplete record at the end is dropped.
  static absl::StatusOr<std::unique_ptr<Spool>> Open(const SpoolOptions& options);
  ~Spool();
  Spool(const Spool&) = delete;
  Spool& operator=(const Spool&) = delete;

  // Error: RESOURCE_EXHAUSTED if the disk is full; the stored chunks remain readable.
  absl::Status Append(const OutgoingChunk& chunk);
  // Returns a chunk from first_seq() to last_seq(). Fast for the successor of the previous one. Error: DATA_LOSS if its
  // bytes have changed.
  absl::StatusOr<OutgoingChunk> Read(uint64_t seq);
  // The position after a chunk from first_seq() to last_seq(); fast in sequential order.
  absl::StatusOr<FeedPoint> PointAfter(uint64_t seq);
  // Deletes the files without a chunk above `seq`; a persistent spool keeps its last file.
  void Release(uint64_t seq);

  // Deletes all files.
  void Clear();

  bool empty() const { return last_.seq == 0 || last_.seq < first_seq(); }
  uint64_t first_seq() const { return segments_.empty() ? last_.seq + 1 : segments_.front().first_seq; }
  const FeedPoint& last() const { return last_; }  // after the last chunk; zeros if there never was one
  bool HasRoomFor(const OutgoingChunk& chunk) const;

 private:
  struct Segment {
    std::string path;
    int descriptor = -1;
    uint64_t first_seq = 0;
    uint64_t size_bytes = 0;
  };
  struct Record;
  struct Cursor {
    uint64_t seq = 0;
    uint64_t offset = 0;  // position of the chunk `seq` in its segment
  };

  explicit Spool(const SpoolOptions& options) : options_(options) {}
  absl::Status Recover();
  absl::Status RecoverSegment(const std::string& path, bool is_last);
  absl::Status AddSegment(uint64_t first_seq);
  absl::Status CheckWritable();
  absl::StatusOr<Record> ReadHeader(const Segment& segment, uint64_t offset) const;
  absl::StatusOr<OutgoingChunk> ReadChunk(const Segment& segment, uint64_t offset) const;
  absl::Status Damaged(const Segment& segment, uint64_t offset) const;
  absl::Status Error(const std::string& path, const std::string& what) const;
  // Moves the cursor to the chunk; returns its segment.
  absl::StatusOr<const Segment*> Seek(uint64_t seq, Cursor& cursor) const;
  void RemoveFront();

  const SpoolOptions options_;
  std::deque<Segment> segments_;
  FeedPoint last_;
  uint64_t total_bytes_ = 0;
  Cursor read_cursor_;
  Cursor point_cursor_;
};

}  // namespace evpose::client
