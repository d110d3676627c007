#include "client/lib/track_call.h"

#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/conversion.h"
#include "core/base/status_macros.h"

namespace evpose::client {

absl::Status TrackOptions::Validate() const {
  if (!(rate >= 0.0) || rate > 1e6) return absl::InvalidArgumentError("rate must lie in [0, 1e6]");
  if (attach_timeout <= absl::ZeroDuration()) return absl::InvalidArgumentError("attach_timeout must be positive");
  return absl::OkStatus();
}

TrackCall::TrackCall(v1::SessionService::StubInterface& stub, const std::string& server_name, const Session& session,
                     const ChunkSource& source, const TrackCallbacks& callbacks, const TrackOptions& options)
    : server_name_(server_name),
      session_(session),
      callbacks_(callbacks),
      options_(options),
      stream_(stub.Track(&context_)),
      uplink_(*stream_, source, options, [this] { Cancel(); }) {}

absl::StatusOr<TrackSummary> TrackCall::Run() {
  EVPOSE_RETURN_IF_ERROR(options_.Validate());
  std::stop_source stop = options_.stop;
  std::optional<std::stop_callback<std::function<void()>>> cancel_on_stop;
  cancel_on_stop.emplace(stop.get_token(), [this] { Cancel(); });
  if (Attach()) {
    v1::TrackResponse response;
    while (stream_->Read(&response) && Handle(response)) continue;
  }
  const bool was_cancelled = stop.stop_requested();
  cancel_on_stop.reset();  // the stop that follows is for the source, not for the call
  if (!status_.ok()) Cancel();
  stop.request_stop();
  uplink_.Stop();
  return Result(stream_->Finish(), was_cancelled);
}

bool TrackCall::Attach() {
  v1::TrackRequest request;
  request.mutable_attach()->set_session(session_.name);
  request.mutable_attach()->set_resume_token(session_.resume_token);
  if (!stream_->Write(request)) return false;
  v1::TrackResponse response;
  if (!ReadBeforeTimeout(response)) return false;
  if (!response.has_attached()) return Malformed("its first message is not `attached`");
  const v1::Attached& attached = response.attached();
  if (attached.next_seq() == 0) return Malformed("it expects chunk 0");
  next_pose_seq_ = attached.first_pose_seq();
  uplink_.Start(attached.next_seq(), attached.send_limit_bytes(), attached.max_chunk_bytes());
  return true;
}

bool TrackCall::ReadBeforeTimeout(v1::TrackResponse& response) {
  std::mutex mutex;
  std::condition_variable_any never_notified;
  bool timed_out = false;
  std::jthread watchdog([&](std::stop_token answered) {
    std::unique_lock lock(mutex);
    never_notified.wait_for(lock, answered, absl::ToChronoNanoseconds(options_.attach_timeout), [] { return false; });
    timed_out = !answered.stop_requested();
    if (timed_out) Cancel();
  });
  const bool is_read = stream_->Read(&response);
  watchdog.request_stop();
  watchdog.join();
  if (timed_out) {
    status_ = absl::DeadlineExceededError(
        absl::StrCat("no answer to `attach` within ", absl::FormatDuration(options_.attach_timeout)));
  }
  return is_read && !timed_out;
}

bool TrackCall::Handle(const v1::TrackResponse& response) {
  if (summary_) return Malformed("a message follows the summary");
  switch (response.message_case()) {
    case v1::TrackResponse::kPose:
      return HandlePose(response.pose());
    case v1::TrackResponse::kAck:
      uplink_.GrantCredit(response.ack().send_limit_bytes());
      if (callbacks_.on_progress) {
        callbacks_.on_progress({uplink_.sent_bytes(), response.ack().processed_seq(), poses_});
      }
      return true;
    case v1::TrackResponse::kNotice: {
      const std::optional<Notice> notice = FromProto(response.notice());
      if (notice && callbacks_.on_notice) callbacks_.on_notice(*notice);
      return true;
    }
    case v1::TrackResponse::kSummary:
      summary_ = FromProto(response.summary().health());
      return true;
    case v1::TrackResponse::kAttached:
      return Malformed("it answers `attached` twice");
    case v1::TrackResponse::MESSAGE_NOT_SET:
      return true;  // of a later server: nothing that this one must know
  }
  return true;
}

bool TrackCall::HandlePose(const v1::Pose& message) {
  const absl::StatusOr<Pose> pose = FromProto(message);
  if (!pose.ok()) return Malformed(std::string(pose.status().message()));
  if (pose->seq != next_pose_seq_) {
    return Malformed(absl::StrCat("pose ", pose->seq, " came where ", next_pose_seq_, " was due"));
  }
  ++next_pose_seq_;
  ++poses_;
  if (callbacks_.on_pose) callbacks_.on_pose(*pose);
  return true;
}

bool TrackCall::Malformed(const std::string& what) {
  status_ = absl::InternalError(absl::StrCat("the server breaks the protocol: ", what));
  return false;
}

absl::StatusOr<TrackSummary> TrackCall::Result(const grpc::Status& stream_status, bool was_cancelled) {
  if (!status_.ok()) return WithProgress(status_);
  if (!uplink_.status().ok()) return WithProgress(uplink_.status());
  // The summary is the last word: who has it lost nothing, whatever ended the connection after it.
  if (!summary_) {
    if (was_cancelled) return WithProgress(absl::CancelledError("cancelled"));
    if (!stream_status.ok()) return WithProgress(FromGrpc(stream_status, "the stream broke"));
    return WithProgress(absl::InternalError("the server breaks the protocol: the stream ended without a summary"));
  }
  if (summary_->poses + 1 != next_pose_seq_) {
    return WithProgress(absl::InternalError(
        absl::StrCat("the server breaks the protocol: the summary counts ", summary_->poses, " poses")));
  }
  return TrackSummary{*summary_, uplink_.sent_bytes(), uplink_.sent_chunks(), poses_};
}

absl::Status TrackCall::WithProgress(const absl::Status& status) const {
  return absl::Status(status.code(), absl::StrCat(server_name_, ": ", status.message(), " (after ",
                                                  uplink_.sent_bytes(), " bytes sent, ", poses_, " poses received)"));
}

}  // namespace evpose::client
