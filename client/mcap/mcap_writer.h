// SPDX-License-Identifier: Apache-2.0

// Writes MCAP files (https://mcap.dev/spec) with the profile ros2: messages in CDR, in compressed chunks with indexes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/mcap/byte_writer.h"
#include "client/mcap/mcap_index.h"
#include "core/base/output_file.h"

struct ZSTD_CCtx_s;

namespace evpose::client {

struct McapWriterOptions {
  bool compresses = true;                // chunks, with zstd
  size_t chunk_bytes = size_t{1} << 20;  // size from which a chunk is written; a longer message is a chunk of its own
  uint64_t chunk_ns = 1'000'000'000;     // span of log time from which a chunk is written: a kill loses no more
  std::string library = "evpose";        // name of the writer, in the header
};

struct McapTopic {
  std::string name;
  std::string type;         // "geometry_msgs/msg/PoseStamped"
  std::string definition;   // definition of the type, with those that it contains (ros2msg)
  bool is_latched = false;  // late subscribers receive the last message (QoS transient local)
};

// Keeps a chunk in memory, and less than 1 kB for each chunk that was written. A file that was not committed
// has all complete chunks, which a reader without the index at the end finds.
class McapWriter {
 public:
  // Errors: those of OutputFile.
  static absl::StatusOr<McapWriter> Create(const std::string& path, const McapWriterOptions& options = {});
  // Continues a file of an earlier process (OutputFile::Continue). Additional errors: those of ReadMcapIndex().
  static absl::StatusOr<McapWriter> Continue(const std::string& path, uint64_t kept_bytes,
                                             const McapWriterOptions& options = {});
  McapWriter(McapWriter&&) = default;
  McapWriter& operator=(McapWriter&&) = default;

  // The first error of these is kept, and returned by Sync() and Commit().
  void AddMetadata(const std::string& name, const std::map<std::string, std::string>& values);
  // Returns the channel of a topic, which is created in the first call with its name.
  uint16_t AddTopic(const McapTopic& topic);
  // The channel of a topic; nullopt before AddTopic().
  std::optional<uint16_t> FindTopic(std::string_view name) const;
  void Write(uint16_t channel, uint64_t log_time_ns, std::string_view message);

  // Writes all data to the disk, and returns the size of the file.
  absl::StatusOr<uint64_t> Sync();
  // Completes the file. The last call.
  absl::Status Commit();
  void Remove() { file_.Remove(); }  // instead of Commit()

  // The index of the file, without the messages of the present chunk.
  const McapIndex& index() const { return index_; }

 private:
  McapWriter(OutputFile file, const McapWriterOptions& options);
  void Append(std::string_view bytes);
  void AppendRecord(uint8_t op, std::string_view content);
  void WriteHeader();
  uint16_t AddSchema(const McapTopic& topic);
  void ReadTopics();  // those of a continued file
  void EndChunk();
  std::string_view Compressed(std::string_view records);

  OutputFile file_;
  McapWriterOptions options_;
  uint64_t size_ = 0;  // size of the file
  McapIndex index_;
  std::map<std::string, uint16_t, std::less<>> schemas_;   // by type
  std::map<std::string, uint16_t, std::less<>> channels_;  // by topic
  std::map<uint16_t, uint32_t> sequence_;                  // number of the next message of each channel
  // The present chunk.
  ByteWriter records_;
  std::map<uint16_t, std::vector<std::pair<uint64_t, uint64_t>>> positions_;  // log time and position of each message
  uint64_t start_ns_ = 0;
  uint64_t end_ns_ = 0;
  std::unique_ptr<ZSTD_CCtx_s, size_t (*)(ZSTD_CCtx_s*)> zstd_;
  std::string compressed_;
};

}  // namespace evpose::client
