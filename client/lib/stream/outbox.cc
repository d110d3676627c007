// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/outbox.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Approximate memory of a chunk in addition to its payload.
constexpr uint64_t kOverheadBytes = 128;

uint64_t SizeInMemory(const OutgoingChunk& chunk) { return chunk.payload.size() + kOverheadBytes; }

}  // namespace

absl::Status OutboxOptions::Validate() const {
  if (memory_bytes == 0) return absl::InvalidArgumentError("memory_bytes must be positive");
  return spool ? spool->Validate() : absl::OkStatus();
}

Outbox::Outbox(const OutboxOptions& options, const FeedPoint& begin)
    : options_(options),
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
  if (options_.spool->outlives_process || !spool_->empty()) return true;
  return memory_bytes_ + SizeInMemory(chunk) > options_.memory_bytes;
}

bool Outbox::HasRoomFor(const OutgoingChunk& chunk) const {
  // A chunk that exceeds the whole capacity is accepted when it is the only one.
  if (GoesToSpool(chunk)) return spool_->HasRoomFor(chunk) || first_seq_ > last_.seq;
  return memory_.empty() || memory_bytes_ + SizeInMemory(chunk) <= options_.memory_bytes;
}

absl::Status Outbox::Append(OutgoingChunk chunk, std::stop_token stop) {
  std::unique_lock lock(mutex_);
  is_waiting_ = !HasRoomFor(chunk);
  const bool has_room = changed_.wait(lock, stop, [&]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return HasRoomFor(chunk); });
  is_waiting_ = false;
  if (!has_room) return absl::CancelledError("stopped");
  const FeedPoint end = chunk.end;
  if (GoesToSpool(chunk)) {
    EVPOSE_RETURN_IF_ERROR(spool_->Append(chunk));
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

void Outbox::Finish(const absl::Status& status) {
  {
    const std::lock_guard lock(mutex_);
    finished_ = status;
  }
  changed_.notify_all();
}

absl::StatusOr<std::shared_ptr<const OutgoingChunk>> Outbox::Find(uint64_t seq) {
  if (seq < first_seq_) {
    return absl::DataLossError(absl::StrCat("the server requests chunk ", seq,
                                            " again, which it had reported as durable (up to ", first_seq_ - 1,
                                            "): its store has lost it"));
  }
  std::shared_ptr<const OutgoingChunk> chunk;
  const uint64_t first_in_memory = memory_.empty() ? 0 : memory_.front()->end.seq;
  if (!memory_.empty() && seq - first_in_memory < memory_.size()) {
    chunk = memory_[seq - first_in_memory];
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
  const bool is_known = changed_.wait(
      lock, stop, [&]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return seq <= last_.seq || finished_.has_value(); });
  wanted_seq_ = 0;
  if (!is_known) return absl::CancelledError("stopped");
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

void Outbox::DropDurable() {
  while (!memory_.empty() && memory_.front()->end.seq <= durable_seq_) {
    durable_ = memory_.front()->end;
    memory_bytes_ -= SizeInMemory(*memory_.front());
    memory_.pop_front();
  }
  const uint64_t durable_in_spool = std::min(durable_seq_, last_.seq);
  if (spool_ != nullptr && !spool_->empty() && durable_in_spool >= spool_->first_seq()) {
    // An unreadable spool is reported when its chunks are sent.
    if (const auto point = spool_->PointAfter(durable_in_spool); point.ok()) durable_ = *point;
    spool_->Forget(durable_in_spool);
  }
  if (!memory_.empty()) {
    first_seq_ = memory_.front()->end.seq;
  } else if (spool_ != nullptr && !spool_->empty()) {
    first_seq_ = spool_->first_seq();
  } else {
    first_seq_ = last_.seq + 1;
  }
}

void Outbox::Forget(uint64_t durable_seq) {
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

OutboxState Outbox::state() const {
  const std::lock_guard lock(mutex_);
  return {.first_seq = first_seq_,
          .last = last_,
          .kept_bytes = last_.bytes - std::min(durable_.bytes, last_.bytes),
          .is_waiting = is_waiting_};
}

}  // namespace evpose::client
