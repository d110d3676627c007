// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/stream_attempt.h"

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "client/lib/messages/conversion.h"
#include "core/base/trace_context.h"

namespace evpose::client {
namespace {

// How far a pose may be beyond the time that the source states for its chunks, which is exact for recordings.
constexpr int64_t kTimeToleranceUs = 1'000'000;

}  // namespace

StreamAttempt::StreamAttempt(v1::SessionService::StubInterface& stub, TrackPosition& position, EventFeed& feed,
                             const TrackCallbacks& callbacks, const TrackOptions& options,
                             const AttemptOptions& attempt_options)
    : position_(position),
      feed_(feed),
      callbacks_(callbacks),
      options_(options),
      attempt_options_(attempt_options),
      stream_(Open(stub)),
      // A server without credit is an outage. Without retries, nothing limits the duration of one.
      uplink_(*stream_, feed.outbox(), options.has_checksum,
              options.retry.max_outage > absl::ZeroDuration() ? options.retry.max_outage : absl::InfiniteDuration(),
              [this] { Cancel(); }) {}

std::unique_ptr<Uplink::Stream> StreamAttempt::Open(v1::SessionService::StubInterface& stub) {
  const auto& [trace_id, span_id] = attempt_options_.trace;
  context_.AddMetadata(kTraceparentKey, Traceparent({trace_id, span_id}));
  return stub.Track(&context_);
}

AttemptOutcome StreamAttempt::Run() {
  std::optional<std::stop_callback<std::function<void()>>> cancel_on_stop;
  cancel_on_stop.emplace(options_.stop.get_token(), [this] { Cancel(); });
  if (Attach()) {
    v1::TrackResponse response;
    while (stream_->Read(&response) && Handle(response)) continue;
  }
  cancel_on_stop.reset();
  if (!outcome_.status.ok()) Cancel();
  uplink_.Stop();
  Conclude(stream_->Finish());
  return outcome_;
}

bool StreamAttempt::Attach() {
  v1::TrackRequest request;
  request.mutable_attach()->set_session(position_.session);
  request.mutable_attach()->set_resume_token(attempt_options_.resume_token);
  request.mutable_attach()->set_last_pose_seq(attempt_options_.attach_after_pose);
  if (const std::optional<uint64_t> first_seq = feed_.outbox().FirstSeq()) {
    request.mutable_attach()->set_first_seq(*first_seq);
    outcome_.stated_first_seq = true;
  }
  if (!stream_->Write(request)) return false;
  v1::TrackResponse response;
  if (!ReadBeforeTimeout(response)) return false;
  if (!response.has_attached()) return Malformed("its first message is not `attached`");
  return HandleAttached(response.attached());
}

bool StreamAttempt::ReadBeforeTimeout(v1::TrackResponse& response) {
  std::mutex mutex;
  std::condition_variable_any never_notified;
  std::jthread watchdog([&](std::stop_token answered) {
    std::unique_lock lock(mutex);
    never_notified.wait_for(lock, answered, absl::ToChronoNanoseconds(options_.attach_timeout), [] { return false; });
    timed_out_ = !answered.stop_requested();
    if (timed_out_) Cancel();
  });
  const bool is_read = stream_->Read(&response);
  watchdog.request_stop();
  watchdog.join();
  return is_read && !timed_out_;
}

bool StreamAttempt::HandleAttached(const v1::TrackResponse::Attached& attached) {
  if (attached.next_seq() == 0) return Malformed("it expects chunk 0");
  if (attached.first_pose_seq() == 0) return Malformed("it begins with pose 0");
  if (attached.max_chunk_bytes() < kWordBytes) return Malformed("its chunks have no room for a single word");
  feed_.Start(attached.max_chunk_bytes());
  if (feed_.max_piece_bytes() > attached.max_chunk_bytes()) {
    return Fail(absl::FailedPreconditionError(absl::StrCat(
        "the server takes chunks of at most ", attached.max_chunk_bytes(), " bytes, but those of this session",
        " have up to ", feed_.max_piece_bytes(), ": begin with smaller ones, or let the server take more")));
  }
  outcome_.was_attached = true;
  first_processed_seq_ = attached.next_seq() - 1;
  next_pose_seq_ = attached.first_pose_seq();
  if (!attached.resume_token().empty()) {
    position_.previous_token = attempt_options_.resume_token;
    position_.resume_token = attached.resume_token();
  }
  if (next_pose_seq_ > position_.last_pose_seq + 1) {
    const PosesLost lost{position_.last_pose_seq + 1, next_pose_seq_ - 1};
    position_.lost_poses += next_pose_seq_ - 1 - position_.last_pose_seq;
    position_.last_pose_seq = next_pose_seq_ - 1;
    if (callbacks_.on_notice) callbacks_.on_notice(lost);
  }
  if (!ReportPosition(true)) return false;
  uplink_.Start(attached.next_seq(), attached.send_limit_bytes(), FromProto(attached.idle_timeout()));
  return true;
}

bool StreamAttempt::Handle(const v1::TrackResponse& response) {
  if (outcome_.summary) return Malformed("a message follows the summary");
  switch (response.message_case()) {
    case v1::TrackResponse::kPose:
      return HandlePose(response.pose());
    case v1::TrackResponse::kAck:
      return HandleAck(response.ack());
    case v1::TrackResponse::kNotice:
      return HandleNotice(response.notice());
    case v1::TrackResponse::kSummary:
      outcome_.summary = FromProto(response.summary().health());
      return true;
    case v1::TrackResponse::kAttached:
      return Malformed("it sends `attached` twice");
    case v1::TrackResponse::MESSAGE_NOT_SET:
      return true;  // a message of a later server is ignored
  }
  return true;
}

bool StreamAttempt::HandlePose(const v1::Pose& message) {
  const absl::StatusOr<Pose> pose = FromProto(message);
  if (!pose.ok()) return Malformed(std::string(pose.status().message()));
  if (pose->seq != next_pose_seq_) {
    return Malformed(absl::StrCat("pose ", pose->seq, " arrived instead of pose ", next_pose_seq_));
  }
  if (const std::string why = ProtocolViolation(*pose); !why.empty()) {
    return Malformed(absl::StrCat("pose ", pose->seq, ": ", why));
  }
  ++next_pose_seq_;
  if (pose->seq <= position_.last_pose_seq) return true;  // delivered on an earlier stream
  position_.last_pose_seq = pose->seq;
  const bool is_confirmed = pose->state != TrackState::kUnknown;
  if (is_confirmed && callbacks_.on_pose) callbacks_.on_pose(*pose);
  return true;
}

std::string StreamAttempt::ProtocolViolation(const Pose& pose) {
  const std::vector<std::string>& ids = options_.object_ids;
  if (!ids.empty() && std::find(ids.begin(), ids.end(), pose.object_id) == ids.end()) {
    return absl::StrCat("the session has no object \"", absl::CHexEscape(pose.object_id.substr(0, 100)), "\"");
  }
  const int64_t latest_us = feed_.LatestTime(first_processed_seq_);
  if (pose.t_us < 0 || pose.t_us > latest_us + kTimeToleranceUs) {
    return absl::StrCat("its time, ", pose.t_us, " us, is not one of the events");
  }
  const auto [last, is_first] = last_t_us_.try_emplace(pose.object_id, pose.t_us);
  if (!is_first && pose.t_us <= last->second) {
    return absl::StrCat("its time, ", pose.t_us, " us, is not after ", last->second, " us, that of the object's last");
  }
  last->second = pose.t_us;
  return "";
}

bool StreamAttempt::HandleAck(const v1::TrackResponse::Ack& ack) {
  uplink_.GrantCredit(ack.send_limit_bytes());
  if (const uint64_t sent_seq = uplink_.sent_seq(); ack.processed_seq() > sent_seq) {
    return Malformed(
        absl::StrCat("it acknowledges chunk ", ack.processed_seq(), ", but the last one sent is ", sent_seq));
  }
  if (ack.durable_seq() > ack.processed_seq()) {
    return Malformed(absl::StrCat("it has stored chunk ", ack.durable_seq(), ", but processed only those up to ",
                                  ack.processed_seq()));
  }
  feed_.outbox().Release(ack.durable_seq());
  outcome_.made_progress = outcome_.made_progress || ack.processed_seq() > first_processed_seq_;
  if (callbacks_.on_progress) {
    callbacks_.on_progress({uplink_.fed_bytes(), ack.processed_seq(), position_.last_pose_seq - position_.lost_poses});
  }
  return ReportPosition(false);
}

bool StreamAttempt::HandleNotice(const v1::TrackResponse::Notice& message) {
  const std::optional<Notice> notice = FromProto(message);
  if (!notice) return true;
  if (std::holds_alternative<GoAway>(*notice) && attempt_options_.leaves_on_go_away) {
    is_left_ = true;
    uplink_.Leave();
  }
  if (const auto* restarted = std::get_if<TrackingRestarted>(&*notice)) {
    // The poses after the restart are not ordered with those before, and have the numbers of those that were not
    // stored.
    last_t_us_.clear();
    position_.last_pose_seq = std::min(position_.last_pose_seq, restarted->after_pose_seq.value_or(UINT64_MAX));
  }
  if (callbacks_.on_notice) callbacks_.on_notice(*notice);
  return true;
}

bool StreamAttempt::ReportPosition(bool has_new_token) {
  position_.durable = feed_.outbox().durable();
  position_.max_piece_bytes = feed_.max_piece_bytes();
  if (!callbacks_.on_position) return true;
  const absl::Status status = callbacks_.on_position(position_, has_new_token);
  return status.ok() || Fail(status);
}

bool StreamAttempt::Fail(const absl::Status& status) {
  outcome_.status = status;
  outcome_.is_final = true;
  return false;
}

bool StreamAttempt::Malformed(const std::string& what) {
  return Fail(absl::InternalError(absl::StrCat("the server violates the protocol: ", what)));
}

void StreamAttempt::Conclude(const grpc::Status& stream_status) {
  if (!outcome_.status.ok()) return;
  if (!uplink_.status().ok()) {
    Fail(uplink_.status());
  } else if (outcome_.summary) {
    // The summary is the last message: nothing was lost, even if the connection then ended with an error.
    if (outcome_.summary->poses + 1 != next_pose_seq_) {
      Malformed(absl::StrCat("the summary counts ", outcome_.summary->poses, " poses"));
    }
  } else if (timed_out_) {
    outcome_.status = absl::DeadlineExceededError(
        absl::StrCat("no response to `attach` within ", absl::FormatDuration(options_.attach_timeout)));
  } else if (!stream_status.ok()) {
    outcome_.status = FromGrpc(stream_status, "the stream broke");
  } else if (!is_left_) {
    Malformed("the stream ended without a summary");
  }
}

}  // namespace evpose::client
