// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/event_feed.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/conversion.h"
#include "core/base/status_macros.h"
#include "core/events/event.h"

namespace evpose::client {
namespace {

// Limit of the resets of the caller that wait for the source to return; bounds memory.
constexpr size_t kMaxPendingResets = 1000;

}  // namespace

absl::StatusOr<std::unique_ptr<EventFeed>> EventFeed::Open(ChunkSource source, const FeedOptions& options) {
  OutboxOptions outbox_options = options.outbox;
  outbox_options.clock = options.clock;
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<Outbox> outbox, Outbox::Open(outbox_options, options.skip));
  return std::unique_ptr<EventFeed>(new EventFeed(std::move(source), options, std::move(outbox)));
}

EventFeed::EventFeed(ChunkSource source, const FeedOptions& options, std::unique_ptr<Outbox> outbox)
    : source_(std::move(source)),
      options_(options),
      outbox_(std::move(outbox)),
      clock_(options.clock == nullptr ? SystemClock() : *options.clock),
      pacer_(clock_, options.rate),
      sensor_pace_(clock_, 1.0),
      is_after_gap_(options.begins_after_gap) {
  if (options_.skip.seq > 0) return;
  // Chunks in the spool of an earlier process are not read again; the events between the two processes are lost.
  point_ = outbox_->state().last;
  is_after_gap_ = is_after_gap_ || point_.seq > 0;
  if (is_after_gap_) latest_us_ = kMaxStateTimeUs;
}

EventFeed::~EventFeed() { Stop(); }

void EventFeed::Start(uint64_t max_piece_bytes) {
  if (thread_.joinable()) return;
  max_piece_bytes_ = std::max(max_piece_bytes / kWordBytes * kWordBytes, kWordBytes);
  thread_ = std::jthread([this] { Run(); });
}

int64_t EventFeed::LatestTime(uint64_t seq) const { return read_seq_ < seq ? kMaxStateTimeUs : latest_us_.load(); }

void EventFeed::Stop() {
  stop_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void EventFeed::Run() {
  while (outbox_->WaitForDemand(options_.read_ahead_bytes, stop_.get_token())) {
    absl::StatusOr<EventChunk> chunk = source_();
    if (stop_.stop_requested()) return;
    absl::Status status = chunk.status();
    const bool is_end = chunk.ok() && chunk->bytes.empty() && chunk->resets.empty();
    if (is_end && point_.seq < options_.skip.seq) {
      status = absl::FailedPreconditionError(
          absl::StrCat("the events end after ", point_.bytes, " bytes, but the session was fed with at least ",
                       options_.skip.bytes, ": these are not the events it was fed with"));
    }
    // While chunks are skipped, a reset of the caller has no place in their numbering.
    if (status.ok() && point_.seq >= options_.skip.seq) status = AddPendingResets(is_end);
    if (status.ok() && !is_end) status = Add(*chunk);
    if (stop_.stop_requested()) return;
    if (status.ok() && !is_end) continue;
    outbox_->Finish(status);
    return;
  }
}

absl::Status EventFeed::Add(const EventChunk& chunk) {
  for (const PoseReset& reset : chunk.resets) EVPOSE_RETURN_IF_ERROR(AddReset(reset));
  if (chunk.bytes.empty()) return absl::OkStatus();
  latest_us_ = std::max(latest_us_.load(), chunk.t_last_us < 0 ? kMaxStateTimeUs : chunk.t_last_us);
  const bool is_skipped = point_.seq < options_.skip.seq;
  if (!is_skipped && !pacer_.Wait(chunk.t_last_us, stop_.get_token())) return absl::CancelledError("stopped");
  const std::optional<absl::Time> due = is_skipped ? std::nullopt : DueTime(chunk.t_last_us);
  const auto* const bytes = reinterpret_cast<const char*>(chunk.bytes.data());
  is_after_gap_ = is_after_gap_ || chunk.follows_loss;
  for (size_t begin = 0; begin < chunk.bytes.size(); begin += max_piece_bytes_) {
    const size_t size = std::min<size_t>(max_piece_bytes_, chunk.bytes.size() - begin);
    OutgoingChunk piece = MakeOutgoingChunk(point_, std::string(bytes + begin, size), is_after_gap_);
    is_after_gap_ = false;
    if (due) due_times_.Add(piece.end.seq, *due);
    EVPOSE_RETURN_IF_ERROR(AddPiece(std::move(piece)));
  }
  return absl::OkStatus();
}

std::optional<absl::Time> EventFeed::DueTime(int64_t t_us) {
  if (t_us < 0 || (options_.rate <= 0.0 && !options_.is_live)) return std::nullopt;
  const absl::Time due =
      options_.rate > 0.0 ? pacer_.DueTime(t_us) : std::max(clock_.Now(), sensor_pace_.DueTime(t_us));
  // After a step back of the sensor's clock, the events are due with those before the step.
  last_due_ = std::max(last_due_, due);
  return last_due_;
}

absl::Status EventFeed::AddReset(const PoseReset& reset) {
  EVPOSE_RETURN_IF_ERROR(reset.Validate());
  return AddPiece(MakeOutgoingReset(point_, ToProto(reset).SerializeAsString()));
}

absl::Status EventFeed::AddPiece(OutgoingChunk piece) {
  point_ = piece.end;
  read_seq_ = point_.seq;
  if (point_.seq == options_.skip.seq) EVPOSE_RETURN_IF_ERROR(CheckSkipped());
  if (point_.seq <= options_.skip.seq) {
    outbox_->AddDurable(std::move(piece));
    return absl::OkStatus();
  }
  return outbox_->Append(std::move(piece), stop_.get_token());
}

absl::Status EventFeed::AddPendingResets(bool is_end) {
  std::vector<PoseReset> resets;
  {
    const std::lock_guard lock(mutex_);
    resets.swap(pending_resets_);
    has_ended_ = is_end;
  }
  for (const PoseReset& reset : resets) EVPOSE_RETURN_IF_ERROR(AddReset(reset));
  return absl::OkStatus();
}

absl::Status EventFeed::ResetPose(const PoseReset& reset) {
  EVPOSE_RETURN_IF_ERROR(reset.Validate());
  const std::lock_guard lock(mutex_);
  if (has_ended_) return absl::FailedPreconditionError("the events of the session have ended");
  if (pending_resets_.size() >= kMaxPendingResets) {
    return absl::FailedPreconditionError(
        absl::StrCat(kMaxPendingResets, " resets wait for the source of events: call ResetPose() less often"));
  }
  pending_resets_.push_back(reset);
  return absl::OkStatus();
}

absl::Status EventFeed::CheckSkipped() const {
  if (point_ == options_.skip) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(
      "the first ", point_.bytes, " bytes differ from those that the session was fed with: these are not its events"));
}

}  // namespace evpose::client
