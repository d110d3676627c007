// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/outbox.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/status_details.h"
#include "core/base/status_macros.h"
#include "evpose/v1/error_reason.pb.h"

namespace evpose::client {
namespace {

// Approximate memory of a chunk in addition to its payload.
constexpr uint64_t kOverheadBytes = 128;

uint64_t SizeInMemory(const OutgoingChunk& chunk) { return chunk.payload.size() + kOverheadBytes; }

// Size of the chunks after the first position, up to the second one.
uint64_t SizeBetween(uint64_t from_seq, uint64_t from_bytes, const FeedPoint& to) {
  const uint64_t num_chunks = to.seq - std::min(from_seq, to.seq);
  return to.bytes - std::min(from_bytes, to.bytes) + num_chunks * kOverheadBytes;
}

}  // namespace

absl::Status RetainOptions::Validate() const {
  if (duration >= absl::ZeroDuration()) return absl::OkStatus();
  return absl::InvalidArgumentError("retain.duration must not be negative");
}

absl::Status OutboxOptions::Validate() const {
  if (memory_bytes == 0) return absl::InvalidArgumentError("memory_bytes must be positive");
  EVPOSE_RETURN_IF_ERROR(retain.Validate());
  return spool ? spool->Validate() : absl::OkStatus();
}

Outbox::Outbox(const OutboxOptions& options, const FeedPoint& begin)
    : options_(options),
      begin_(begin),
      has_reached_begin_(begin.seq == 0),
      first_seq_(begin.seq + 1),
      last_(begin),
      durable_(begin),
      durable_seq_(begin.seq),
      asked_bytes_(begin.bytes) {}

absl::StatusOr<std::unique_ptr<Outbox>> Outbox::Open(const OutboxOptions& options, const FeedPoint& begin) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  std::unique_ptr<Outbox> outbox(new Outbox(options, begin));
  if (!options.spool) return outbox;
  const std::lock_guard lock(outbox->mutex_);
  EVPOSE_ASSIGN_OR_RETURN(outbox->spool_, Spool::Open(*options.spool));
  const Spool& spool = *outbox->spool_;
  if (spool.empty()) return outbox;
  outbox->first_seq_ = spool.first_seq();
  outbox->last_ = spool.last();
  // An unreadable spool is reported when its chunks are sent.
  if (const auto point = outbox->spool_->PointAfter(spool.first_seq()); point.ok()) {
    outbox->released_ = {.seq = spool.first_seq() - 1, .bytes = point->bytes};
  }
  return outbox;
}

bool Outbox::WaitForDemand(uint64_t bytes, std::stop_token stop) {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, stop, [&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    const uint64_t unasked_bytes = last_.bytes - std::min(asked_bytes_, last_.bytes);
    return wanted_seq_ > last_.seq || unasked_bytes < bytes;
  });
  return !stop.stop_requested();
}

bool Outbox::GoesToSpool(const OutgoingChunk& chunk) const {
  if (spool_ == nullptr) return false;
  if (options_.spool->outlives_process) return true;
  if (!spool_->empty() && spool_->last().seq > durable_.seq) return true;
  return memory_bytes_ + SizeInMemory(chunk) > options_.memory_bytes;
}

bool Outbox::HasRoomFor(const OutgoingChunk& chunk) const {
  // A chunk that exceeds the whole capacity is accepted when it is the only one.
  if (GoesToSpool(chunk)) return spool_->HasRoomFor(chunk) || first_seq_ > last_.seq;
  return !HasUndurableInMemory() || memory_bytes_ + SizeInMemory(chunk) <= options_.memory_bytes;
}

absl::Status Outbox::Append(OutgoingChunk chunk, std::stop_token stop) {
  std::unique_lock lock(mutex_);
  is_waiting_ = !HasRoomFor(chunk);
  if (is_waiting_) DropDurable();  // retained chunks in the spool give way
  const bool has_room = changed_.wait(lock, stop, [&]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return HasRoomFor(chunk); });
  is_waiting_ = false;
  if (!has_room) return absl::CancelledError("stopped");
  const FeedPoint end = chunk.end;
  if (GoesToSpool(chunk)) {
    EVPOSE_RETURN_IF_ERROR(AppendToSpool(chunk));
  } else {
    memory_bytes_ += SizeInMemory(chunk);
    memory_.push_back(std::make_shared<const OutgoingChunk>(std::move(chunk)));
  }
  last_ = end;
  DropDurable();
  lock.unlock();
  changed_.notify_all();
  return absl::OkStatus();
}

absl::Status Outbox::AppendToSpool(const OutgoingChunk& chunk) {
  // The spool holds consecutive chunks. Those of an earlier outage are durable, and chunks in memory follow them.
  if (!spool_->empty() && spool_->last().seq != last_.seq) {
    spool_->Clear();
    DropRetained(/*all=*/true);
  }
  return spool_->Append(chunk);
}

void Outbox::AddDurable(OutgoingChunk chunk) {
  {
    const std::lock_guard lock(mutex_);
    const FeedPoint end = chunk.end;
    const uint64_t begin_bytes = end.bytes - (chunk.is_reset ? 0 : chunk.payload.size());
    const bool is_close = SizeBetween(end.seq - 1, begin_bytes, begin_) <= options_.retain.max_bytes;
    if (is_close && options_.retain.duration > absl::ZeroDuration()) {
      memory_.push_back(std::make_shared<const OutgoingChunk>(std::move(chunk)));
      ++num_durable_in_memory_;
    } else {
      released_ = {.seq = end.seq, .bytes = end.bytes};
    }
    has_reached_begin_ = end.seq >= begin_.seq;
    if (has_reached_begin_) marks_.push_back({.seq = end.seq, .bytes = end.bytes, .durable_at = Now()});
    DropDurable();
  }
  changed_.notify_all();
}

void Outbox::Finish(const absl::Status& status) {
  {
    const std::lock_guard lock(mutex_);
    finished_ = status;
  }
  changed_.notify_all();
}

absl::StatusOr<std::shared_ptr<const OutgoingChunk>> Outbox::Find(uint64_t seq) {
  if (seq < first_seq_) {
    absl::Status lost = absl::DataLossError(absl::StrCat(
        "the server requests chunk ", seq, " again, which it had reported as durable (up to ", first_seq_ - 1,
        ") and which is no longer kept: its store has lost it, and the session cannot go on"));
    SetDetails(lost, {.reason = v1::ErrorReason_Name(v1::ROLLED_BACK)});
    return lost;
  }
  std::shared_ptr<const OutgoingChunk> chunk;
  const auto found = std::lower_bound(memory_.begin(), memory_.end(), seq,
                                      [](const auto& each, uint64_t value) { return each->end.seq < value; });
  if (found != memory_.end() && (*found)->end.seq == seq) {
    chunk = *found;
  } else {
    EVPOSE_ASSIGN_OR_RETURN(OutgoingChunk read, spool_->Read(seq));
    chunk = std::make_shared<const OutgoingChunk>(std::move(read));
  }
  asked_bytes_ = std::max(asked_bytes_, chunk->end.bytes);
  return chunk;
}

absl::StatusOr<std::shared_ptr<const OutgoingChunk>> Outbox::Get(uint64_t seq, std::stop_token stop) {
  std::unique_lock lock(mutex_);
  wanted_seq_ = seq;
  if (seq > last_.seq) changed_.notify_all();
  const bool is_known = changed_.wait(lock, stop, [&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    return (seq <= last_.seq && IsAdded(seq)) || finished_.has_value();
  });
  wanted_seq_ = 0;
  if (!is_known) return absl::CancelledError("stopped");
  if (!IsAdded(seq) && !finished_->ok()) return *finished_;
  if (seq > last_.seq) {
    EVPOSE_RETURN_IF_ERROR(*finished_);
    if (seq == last_.seq + 1) return nullptr;
    return absl::FailedPreconditionError(absl::StrCat("the server has ", seq - 1,
                                                      " chunks of this session, but there are ", last_.seq,
                                                      " only: these are not the events it was fed with"));
  }
  auto chunk = Find(seq);
  lock.unlock();
  changed_.notify_all();
  return chunk;
}

void Outbox::AdvanceDurable() {
  const uint64_t durable_before = durable_.seq;
  for (; HasUndurableInMemory() && memory_[num_durable_in_memory_]->end.seq <= durable_seq_; ++num_durable_in_memory_) {
    const OutgoingChunk& chunk = *memory_[num_durable_in_memory_];
    if (chunk.end.seq > durable_.seq) durable_ = chunk.end;
    memory_bytes_ -= SizeInMemory(chunk);
  }
  const uint64_t durable_in_spool = spool_ == nullptr ? 0 : std::min(durable_seq_, spool_->last().seq);
  if (durable_in_spool > durable_.seq && !spool_->empty() && durable_in_spool >= spool_->first_seq()) {
    // An unreadable spool is reported when its chunks are sent.
    if (const auto point = spool_->PointAfter(durable_in_spool); point.ok()) durable_ = *point;
  }
  if (durable_.seq > durable_before) {
    marks_.push_back({.seq = durable_.seq, .bytes = durable_.bytes, .durable_at = Now()});
  }
}

void Outbox::DropRetained(bool all) {
  const absl::Time now = marks_.empty() ? absl::InfinitePast() : Now();
  const auto is_dropped = [&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    return all || marks_.front().durable_at + options_.retain.duration <= now ||
           SizeBetween(released_.seq, released_.bytes, durable_) > options_.retain.max_bytes;
  };
  while (!marks_.empty() && is_dropped()) {
    released_ = marks_.front();
    marks_.pop_front();
  }
  while (num_durable_in_memory_ > 0 && memory_.front()->end.seq <= released_.seq) {
    memory_.pop_front();
    --num_durable_in_memory_;
  }
  if (spool_ != nullptr && !spool_->empty() && released_.seq >= spool_->first_seq()) {
    spool_->Release(std::min(released_.seq, spool_->last().seq));
  }
}

void Outbox::DropDurable() {
  AdvanceDurable();
  // While the source waits for room in the spool, nothing is retained.
  DropRetained(/*all=*/is_waiting_ && spool_ != nullptr);
  first_seq_ = last_.seq + 1;
  if (spool_ != nullptr && !spool_->empty()) first_seq_ = std::min(first_seq_, spool_->first_seq());
  if (!memory_.empty()) first_seq_ = std::min(first_seq_, memory_.front()->end.seq);
}

void Outbox::Release(uint64_t durable_seq) {
  {
    const std::lock_guard lock(mutex_);
    if (durable_seq <= durable_seq_) return;
    durable_seq_ = durable_seq;
    DropDurable();
  }
  changed_.notify_all();
}

void Outbox::Clear() {
  const std::lock_guard lock(mutex_);
  if (spool_ != nullptr) spool_->Clear();
}

FeedPoint Outbox::durable() const {
  const std::lock_guard lock(mutex_);
  return durable_;
}

std::optional<uint64_t> Outbox::FirstSeq() const {
  const std::lock_guard lock(mutex_);
  if (!has_reached_begin_) return std::nullopt;
  return first_seq_;
}

OutboxState Outbox::state() const {
  const std::lock_guard lock(mutex_);
  return {.first_seq = first_seq_,
          .last = last_,
          .kept_bytes = last_.bytes - std::min(durable_.bytes, last_.bytes),
          .is_waiting = is_waiting_};
}

}  // namespace evpose::client
