// SPDX-License-Identifier: Apache-2.0

// Chunks in files of a directory: those for which there is no room in memory, or which must outlive the process.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lib/outgoing_chunk.h"

namespace evpose::client {

struct SpoolOptions {
  std::string directory;            // made with mode 0700 when it is missing; its files have mode 0600
  uint64_t max_bytes = 8ull << 30;  // of its files, each of which has a 128th of it; at least 16 MiB
  // The files keep their names and are found again by the next Open(). Otherwise they have none: when the process ends,
  // however it ends, the disk is free again. They are not synced: a machine that loses its power loses the last ones.
  bool outlives_process = false;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// A queue of chunks with consecutive numbers. Each record carries checksums. Not thread-safe.
class Spool {
 public:
  // Errors name the directory: PERMISSION_DENIED and the like when nothing can be written there; DATA_LOSS naming the
  // file and the offset when what a process left there is damaged. A record that was not written to its end is dropped:
  // dropped_tail_bytes().
  static absl::StatusOr<std::unique_ptr<Spool>> Open(const SpoolOptions& options);
  ~Spool();
  Spool(const Spool&) = delete;
  Spool& operator=(const Spool&) = delete;

  // RESOURCE_EXHAUSTED when the disk is full; what was there stays readable.
  absl::Status Append(const OutgoingChunk& chunk);
  // A chunk of first_seq() to last_seq(). Fast when it is the one after the last that was read. DATA_LOSS when its
  // bytes have changed since.
  absl::StatusOr<OutgoingChunk> Read(uint64_t seq);
  // The place after a chunk of first_seq() to last_seq(); fast when they are asked for in order.
  absl::StatusOr<FeedPoint> PointAfter(uint64_t seq);
  // Deletes the files in which no chunk is above `seq`; one that outlives the process keeps its last file.
  void Forget(uint64_t seq);

  // Deletes all files: nothing of it is needed any more.
  void Clear();

  bool empty() const { return last_.seq == 0 || last_.seq < first_seq(); }
  uint64_t first_seq() const { return segments_.empty() ? last_.seq + 1 : segments_.front().first_seq; }
  const FeedPoint& last() const { return last_; }  // after the last chunk; zeros when there never was one
  bool HasRoomFor(const OutgoingChunk& chunk) const;
  uint64_t dropped_tail_bytes() const { return dropped_tail_bytes_; }

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
    uint64_t offset = 0;  // of the chunk `seq` in its segment
  };

  explicit Spool(const SpoolOptions& options) : options_(options) {}
  absl::Status Recover();
  absl::Status RecoverSegment(const std::string& path, bool is_last);
  absl::Status AddSegment(uint64_t first_seq);
  absl::Status CheckWritable();
  absl::StatusOr<Record> ReadHeader(const Segment& segment, uint64_t offset) const;
  absl::StatusOr<OutgoingChunk> ReadChunk(const Segment& segment, uint64_t offset) const;
  absl::Status Error(const std::string& path, const std::string& what) const;
  // Moves the cursor to the chunk; its segment.
  absl::StatusOr<const Segment*> Seek(uint64_t seq, Cursor& cursor) const;
  void RemoveFront();

  const SpoolOptions options_;
  std::deque<Segment> segments_;
  FeedPoint last_;
  uint64_t total_bytes_ = 0;
  uint64_t dropped_tail_bytes_ = 0;
  Cursor read_cursor_;
  Cursor point_cursor_;
};

}  // namespace evpose::client
