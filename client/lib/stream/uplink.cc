// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/uplink.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "evpose/clock.h"

namespace evpose::client {
namespace {

// Limits of times that the server or the caller may choose. A longer wait overflows the clock of the standard library.
constexpr absl::Duration kLongestWait = absl::Hours(24 * 365);
// Least period of the empty chunks that keep a stream alive, however short the idle timeout that the server states.
constexpr absl::Duration kShortestKeepAlive = absl::Milliseconds(5);

}  // namespace

Uplink::Uplink(Stream& stream, Outbox& outbox, bool has_checksum, absl::Duration credit_timeout,
               std::function<void()> cancel)
    : stream_(stream),
      outbox_(outbox),
      has_checksum_(has_checksum),
      credit_timeout_(std::min(credit_timeout, kLongestWait)),
      cancel_(std::move(cancel)) {}

Uplink::~Uplink() { Stop(); }

void Uplink::Start(uint64_t next_seq, uint64_t send_limit_bytes, absl::Duration idle_timeout) {
  sent_seq_ = next_seq - 1;
  GrantCredit(send_limit_bytes);
  thread_ = std::jthread([this, next_seq, idle_timeout] { Run(next_seq, idle_timeout); });
}

void Uplink::GrantCredit(uint64_t send_limit_bytes) {
  {
    std::lock_guard lock(mutex_);
    send_limit_bytes_ = std::max(send_limit_bytes_, send_limit_bytes);
  }
  credit_changed_.notify_all();
}

void Uplink::Leave() {
  is_leaving_ = true;
  stop_.request_stop();
}

void Uplink::Stop() {
  stop_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void Uplink::Run(uint64_t next_seq, absl::Duration idle_timeout) {
  std::jthread keep_alive;
  if (idle_timeout > absl::ZeroDuration()) {
    // The time without a message is less than two periods, which are a third of the server's limit.
    const absl::Duration period = std::max(idle_timeout / 6, kShortestKeepAlive);
    keep_alive = std::jthread([this, period](const std::stop_token& stop) { KeepAlive(period, stop); });
  }
  const bool is_complete = SendChunks(next_seq);
  keep_alive = {};
  v1::TrackRequest request;
  request.mutable_end();
  if (is_complete ? stream_.Write(request) : is_leaving_.load()) stream_.WritesDone();
}

bool Uplink::SendChunks(uint64_t next_seq) {
  for (uint64_t seq = next_seq; !stop_.stop_requested(); ++seq) {
    const absl::StatusOr<std::shared_ptr<const OutgoingChunk>> chunk = outbox_.Get(seq, stop_.get_token());
    if (stop_.stop_requested()) return false;
    if (!chunk.ok()) Fail(chunk.status());
    if (!chunk.ok() || *chunk == nullptr) return chunk.ok();
    if (!Send(**chunk)) return false;
  }
  return false;
}

bool Uplink::Write(const v1::TrackRequest& request) {
  const std::lock_guard lock(write_mutex_);
  has_written_ = true;
  return stream_.Write(request);
}

void Uplink::KeepAlive(absl::Duration period, const std::stop_token& stop) {
  v1::TrackRequest empty;
  empty.mutable_events();
  while (SystemClock().SleepUntil(SystemClock().Now() + period, stop)) {
    const std::lock_guard lock(write_mutex_);
    if (!std::exchange(has_written_, false) && !stream_.Write(empty)) return;
  }
}

bool Uplink::Send(const OutgoingChunk& chunk) {
  v1::TrackRequest request;
  if (chunk.is_reset) {  // uses no credit
    if (!request.mutable_reset_pose()->ParseFromString(chunk.payload)) {
      Fail(absl::DataLossError("a stored reset of a pose cannot be read"));
      return false;
    }
    request.mutable_reset_pose()->set_seq(chunk.end.seq);
    sent_seq_ = chunk.end.seq;
    return Write(request);
  }
  if (!WaitForCredit(chunk.payload.size())) return false;
  v1::TrackRequest::EventChunk& events = *request.mutable_events();
  events.set_seq(chunk.end.seq);
  events.set_discontinuity(chunk.discontinuity);
  events.set_payload(chunk.payload);
  if (has_checksum_) events.set_crc32c(chunk.crc32c);
  sent_seq_ = chunk.end.seq;          // before an ack for it can arrive
  if (!Write(request)) return false;  // the stream has ended; Finish() returns its status
  sent_bytes_ += chunk.payload.size();
  fed_bytes_ = chunk.end.bytes;
  return true;
}

bool Uplink::WaitForCredit(size_t size) {
  std::unique_lock lock(mutex_);
  while (sent_bytes_ + size > send_limit_bytes_) {
    const auto is_raised = [this, before = send_limit_bytes_] { return send_limit_bytes_ > before; };
    const auto timeout = absl::ToChronoNanoseconds(credit_timeout_);
    if (credit_changed_.wait_for(lock, stop_.get_token(), timeout, is_raised)) continue;
    if (stop_.stop_requested()) return false;
    Fail(absl::DeadlineExceededError(
        absl::StrCat("the server has granted no credit for ", absl::FormatDuration(credit_timeout_))));
    return false;
  }
  return true;
}

void Uplink::Fail(const absl::Status& status) {
  status_ = status;
  cancel_();
}

}  // namespace evpose::client
