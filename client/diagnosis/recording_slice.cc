// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/recording_slice.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/events/time_scanner.h"
#include "core/recordings/chunker.h"

namespace evpose::client {
namespace {

class SliceReader final : public RecordingReader {
 public:
  SliceReader(RecordingHeader header, std::string_view data) : header_(std::move(header)), data_(data) {}

  const RecordingHeader& header() const override { return header_; }
  int64_t data_size_bytes() const override { return size_; }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    const size_t size = std::min(buffer.size(), data_.size());
    std::memcpy(buffer.data(), data_.data(), size);
    data_.remove_prefix(size);
    return size;
  }

 private:
  const RecordingHeader header_;
  std::string_view data_;  // the data that are not read yet
  const int64_t size_ = static_cast<int64_t>(data_.size());
};

// Measures by how much the times that a decoder reads from the slice are too early, because the slice does not contain
// the earlier wraps of the clock.
class ClockOffset {
 public:
  explicit ClockOffset(Encoding encoding) : word_bytes_(static_cast<size_t>(WordBytes(encoding))), scanner_(encoding) {}

  void Add(const EventChunkBytes& chunk) {
    if (scanner_.now_us() >= 0) return;
    scanner_.Scan(chunk.bytes.data(), chunk.bytes.size() / word_bytes_, int64_t{1} << 60);
    if (scanner_.now_us() >= 0) offset_us_ = chunk.t_last_us - scanner_.now_us();
  }
  int64_t offset_us() const { return offset_us_; }

 private:
  const size_t word_bytes_;
  TimeScanner scanner_;
  int64_t offset_us_ = 0;
};

}  // namespace

absl::StatusOr<RecordingSlice> ReadSlice(RecordingReader& reader, const SliceOptions& options) {
  RecordingSlice slice;
  const RecordingHeader& header = reader.header();
  const double duration_s = std::min(options.duration_s.value_or(HUGE_VAL), options.max_duration_s);
  const auto duration_us = static_cast<int64_t>(std::llround(duration_s * 1e6));
  Chunker chunker(reader, {});
  ClockOffset clock(header.encoding);
  std::optional<int64_t> begin_us;  // of the slice
  std::string data;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const EventChunkBytes chunk, chunker.Next());
    if (chunk.bytes.empty()) break;
    if (!begin_us && chunk.t_last_us >= 0) begin_us = chunk.t_last_us + std::llround(options.start_s * 1e6);
    if (options.start_s > 0.0 && (!begin_us || chunk.t_last_us < *begin_us)) continue;
    const bool is_after = begin_us && chunk.t_last_us >= *begin_us + duration_us;
    const bool is_full = data.size() + chunk.bytes.size() > options.max_bytes;
    if (!data.empty() && (is_after || is_full)) {
      slice.is_cut = is_full || !options.duration_s || *options.duration_s > options.max_duration_s;
      break;
    }
    if (data.empty()) slice.begin_us = std::max<int64_t>(chunk.t_last_us, 0);
    slice.end_us = std::max(slice.end_us, chunk.t_last_us);
    clock.Add(chunk);
    data.append(reinterpret_cast<const char*>(chunk.bytes.data()), chunk.bytes.size());
  }
  if (data.empty()) {
    return absl::OutOfRangeError(absl::StrFormat("has no events from %.6g s after its first on", options.start_s));
  }
  slice.data_bytes = data.size();
  slice.file = MakeRawHeader(header.encoding, header.geometry, header.time_offset_us + clock.offset_us()) + data;
  return slice;
}

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenSlice(std::string_view file) {
  EVPOSE_ASSIGN_OR_RETURN(std::optional<RecordingHeader> header, ParseRecordingHeader(file, /*is_whole_file=*/true));
  if (!header) return absl::InvalidArgumentError("the header of the recording is not complete");
  const std::string_view data = file.substr(std::min(header->size_bytes, file.size()));
  return std::make_unique<SliceReader>(*std::move(header), data);
}

}  // namespace evpose::client
