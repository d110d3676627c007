// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/chunker.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

constexpr size_t kReadBytes = size_t{64} * 1024;  // the capacity of a pipe

}  // namespace

absl::Status ChunkerOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckPositive("max_duration_us", static_cast<double>(max_duration_us)));
  if (max_bytes < 8 || max_bytes % 8 != 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_bytes is ", max_bytes, "; it must be a multiple of 8, at least 8"));
  }
  return absl::OkStatus();
}

Chunker::Chunker(RecordingReader& reader, const ChunkerOptions& options)
    : reader_(reader),
      options_(options),
      word_bytes_(static_cast<size_t>(WordBytes(reader.header().encoding))),
      scanner_(reader.header().encoding),
      buffer_(kReadBytes) {}

absl::StatusOr<EventChunkBytes> Chunker::Next() {
  EVPOSE_RETURN_IF_ERROR(options_.Validate());
  EventChunkBytes chunk;
  chunk.follows_loss = std::exchange(loss_is_due_, false);
  while (!TakeWords(chunk) && !is_at_end_) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_more, Refill());
    is_at_end_ = !has_more;
    if (!loss_is_due_) continue;
    if (!chunk.bytes.empty()) break;
    chunk.follows_loss = true;
    loss_is_due_ = false;
  }
  scanner_.BeginChunk();
  chunk.t_last_us = scanner_.now_us();
  return chunk;
}

bool Chunker::TakeWords(EventChunkBytes& chunk) {
  const size_t room = options_.max_bytes - chunk.bytes.size();
  const size_t num_words = std::min(room, end_ - begin_) / word_bytes_;
  const uint8_t* const words = buffer_.data() + begin_;
  const TimeScanner::Result scan = scanner_.Scan(words, num_words, options_.max_duration_us);
  chunk.bytes.insert(chunk.bytes.end(), words, words + scan.num_words * word_bytes_);
  begin_ += scan.num_words * word_bytes_;
  return scan.duration_passed || chunk.bytes.size() + word_bytes_ > options_.max_bytes;
}

absl::StatusOr<bool> Chunker::Refill() {
  std::memmove(buffer_.data(), buffer_.data() + begin_, end_ - begin_);
  end_ -= std::exchange(begin_, 0);
  EVPOSE_ASSIGN_OR_RETURN(const size_t size, reader_.Read(absl::MakeSpan(buffer_).subspan(end_)));
  if (size > 0 && reader_.follows_loss()) {
    begin_ = end_;
    scanner_.ResetAfterLoss();
    loss_is_due_ = true;
  }
  end_ += size;
  return size > 0;
}

}  // namespace evpose
