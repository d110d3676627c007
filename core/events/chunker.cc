// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/events/recording_reader.h"
#include "core/events/time_scanner.h"

namespace evpose {
namespace {

constexpr size_t kReadBytes = 64 * 1024;  // the capacity of a pipe

}  // namespace

absl::Status ChunkerOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckPositive("max_duration_us", static_cast<double>(max_duration_us)));
  if (max_bytes < 8 || max_bytes % 8 != 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_bytes is ", max_bytes, "; it must be a multiple of 8, at least 8"));
  }
  return absl::OkStatus();
}

struct Chunker::State {
  State(RecordingReader& reader_in, const ChunkerOptions& options_in)
      : reader(reader_in),
        options(options_in),
        word_bytes(static_cast<size_t>(WordBytes(reader_in.header().encoding))),
        scanner(reader_in.header().encoding),
        buffer(kReadBytes) {}

  // Moves whole words from the buffer to the chunk; true if they complete it.
  bool TakeWords(EventChunkBytes& chunk) {
    const size_t room = options.max_bytes - chunk.bytes.size();
    const size_t num_words = std::min(room, end - begin) / word_bytes;
    const uint8_t* const words = buffer.data() + begin;
    const TimeScanner::Result scan = scanner.Scan(words, num_words, options.max_duration_us);
    chunk.bytes.insert(chunk.bytes.end(), words, words + scan.num_words * word_bytes);
    begin += scan.num_words * word_bytes;
    return scan.duration_passed || chunk.bytes.size() + word_bytes > options.max_bytes;
  }

  // Reads more bytes into the buffer; false at the end.
  absl::StatusOr<bool> Refill() {
    std::memmove(buffer.data(), buffer.data() + begin, end - begin);
    end -= std::exchange(begin, 0);
    EVPOSE_ASSIGN_OR_RETURN(const size_t size, reader.Read(absl::MakeSpan(buffer).subspan(end)));
    end += size;
    return size > 0;
  }

  RecordingReader& reader;
  const ChunkerOptions options;
  const size_t word_bytes;
  TimeScanner scanner;
  std::vector<uint8_t> buffer;
  size_t begin = 0;  // of the bytes that belong to no chunk yet
  size_t end = 0;
  bool at_end = false;
};

Chunker::Chunker(RecordingReader& reader, const ChunkerOptions& options)
    : state_(std::make_unique<State>(reader, options)) {}
Chunker::~Chunker() = default;

absl::StatusOr<EventChunkBytes> Chunker::Next() {
  EVPOSE_RETURN_IF_ERROR(state_->options.Validate());
  EventChunkBytes chunk;
  while (!state_->TakeWords(chunk) && !state_->at_end) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_more, state_->Refill());
    state_->at_end = !has_more;
  }
  state_->scanner.BeginChunk();
  chunk.t_last_us = state_->scanner.now_us();
  return chunk;
}

size_t Chunker::truncated_bytes() const { return state_->at_end ? state_->end - state_->begin : 0; }

}  // namespace evpose
