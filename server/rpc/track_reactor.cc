// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/track_reactor.h"

#include <chrono>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/rpc/common/authentication.h"
#include "server/rpc/common/call_alarm.h"
#include "server/rpc/common/conversion.h"
#include "server/rpc/common/status_mapping.h"
#include "server/rpc/common/stream_registry.h"
#include "server/rpc/track_reactor_phase.h"
#include "server/runtime/client_text.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"
#include "server/sessions/session.h"
#include "server/sessions/stream/chunk_check.h"
#include "server/sessions/stream/stream_silence.h"

namespace evpose::server {
namespace {

constexpr size_t kPosesPerPage = 64;  // read at a time, about 40 KB, which bounds the memory of a slow client

// Every event (a message read or written, a change of the session, a cancellation) ends in Pump, which examines the
// whole state and starts the reads and writes that are possible now. No wake-up is lost: an ack that could not be
// written because a write was in flight is written when that write is done.
class TrackReactor : public grpc::ServerBidiReactor<v1::TrackRequest, v1::TrackResponse>,
                     public SessionListener,
                     public OpenStream,
                     public std::enable_shared_from_this<TrackReactor> {
 public:
  TrackReactor(const ServiceContext& services, grpc::CallbackServerContext* context)
      : services_(services),
        context_(context),
        access_version_(services.authenticator.version()),
        caller_(Authenticate(services.authenticator, *context)) {}

  void Start() {
    self_ = shared_from_this();
    services_.streams.Add(StreamRegistry::Kind::kTrack, self_);
    const std::lock_guard lock(mutex_);
    Fail(caller_.status());
    Fail(services_.sessions.CheckNotDraining());
    if (caller_.ok()) {
      auto reservation = services_.quotas.AddStream(caller_->tenant);
      Fail(reservation.status());
      if (reservation.ok()) reservation_ = *std::move(reservation);
      Fail(SetAlarm(alarm_, services_.attach_timeout, &TrackReactor::OnAlarm));
    }
    Pump();
  }

  void OnReadDone(bool ok) override {
    const bool is_attach = ok && request_.has_attach() && session_ == nullptr;
    // The lock is not held: only the reading side uses the request. This also computes the checksum of its payload.
    const absl::Status handled = OrOutOfMemory([this, ok, is_attach] {
      if (is_attach) return StartAttach(request_.attach()), absl::OkStatus();
      return ok ? HandleRequest() : HandleHalfClose();
    });
    if (is_attach && handled.ok()) return;
    // The session may have accepted a chunk without queueing it.
    const bool must_close = IsOutOfMemory(handled) && !is_attach && session_ != nullptr;
    if (must_close) RunUnlessOutOfMemory([&] { session_->Close(handled); });
    const std::lock_guard lock(mutex_);
    OnReadHandled();
    Fail(handled);
    Pump();
  }

  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    is_writing_ = false;
    silence_.OnWritten();
    if (!ok) Fail(absl::CancelledError("the client has disconnected"));
    Pump();
  }

  void OnCancel() override {
    const std::lock_guard lock(mutex_);
    Fail(absl::CancelledError("the client cancelled"));
    Pump();
  }

  void OnDone() override {
    {
      // The lock is held: an attach that was too late may still be running on another thread.
      const std::lock_guard lock(mutex_);
      if (session_ != nullptr) session_->log().StreamEnded(origin_, stream_, failure_);
    }
    services_.streams.Remove(this);
    const std::shared_ptr<TrackReactor> last = std::move(self_);
  }

  void OnSessionChanged() override {
    const std::lock_guard lock(mutex_);
    Pump();
  }

  void GoAway(absl::Duration deadline) override {
    const std::lock_guard lock(mutex_);
    if (session_ == nullptr) Fail(services_.sessions.CheckNotDraining());  // it has nothing to finish
    go_away_ = deadline;
    Pump();
  }

  void End(const absl::Status& status) override {
    const std::lock_guard lock(mutex_);
    Fail(status);
    Pump();
    // A write in flight to a client that does not read would never be done.
    if (phase_ != StreamPhase::kFinished) context_->TryCancel();
  }

  void CheckAccess(const AccessCheck& check) override {
    const std::lock_guard lock(mutex_);
    if (phase_ == StreamPhase::kFinished) return;
    const absl::Status access = StillAdmitted(services_.authenticator, *context_, caller_, check, access_version_);
    if (access.ok()) return;
    // A write in flight has until the next check to be done, so that the client receives the status.
    if (phase_ == StreamPhase::kFailing) return context_->TryCancel();
    Fail(access);
    Pump();
  }

 private:
  enum class ReadState { kIdle, kReading, kHalfClosed };  // kReading until the message has been handled
  struct Joined {
    std::shared_ptr<Session> session;
    Attachment attachment;
  };

  absl::Status HandleRequest() {
    const v1::TrackRequest::MessageCase message = request_.message_case();
    if (message == v1::TrackRequest::kAttach) {
      return InvalidField("attach", "was sent already: a stream attaches once");
    }
    if (message == v1::TrackRequest::MESSAGE_NOT_SET) {
      return InvalidField("message", "is empty: attach, events, reset_pose or end is expected");
    }
    if (session_ == nullptr) return InvalidField("attach", "must be the first message of the stream");
    if (message == v1::TrackRequest::kEvents) return HandleEvents(*request_.mutable_events());
    if (message == v1::TrackRequest::kResetPose) return HandleResetPose(request_.reset_pose());
    return HandleEnd();
  }

  absl::Status HandleHalfClose() {
    const std::lock_guard lock(mutex_);
    read_ = ReadState::kHalfClosed;
    ChangePhase(StreamInput::kHalfClosed);
    if (session_ != nullptr) session_->HalfClose(stream_);
    return absl::OkStatus();
  }

  // The only function that changes the phase.
  void ChangePhase(StreamInput input) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    const StreamPhase from = std::exchange(phase_, NextPhase(phase_, input));
    if (session_ == nullptr || phase_ == from) return;
    session_->log().StreamPhaseChanged(origin_, stream_, StreamPhaseName(from), StreamPhaseName(phase_));
  }

  void OnReadHandled() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (read_ == ReadState::kReading) read_ = ReadState::kIdle;
    silence_.OnMessage();
  }

  // A session that this server does not have is resumed on another thread, because that waits for the store.
  void StartAttach(const v1::TrackRequest::Attach& attach) {
    {
      const std::lock_guard lock(mutex_);
      ChangePhase(StreamInput::kAttachReceived);
      origin_ = OriginOf(*context_, caller_->peer, attach.session());
    }
    auto session = services_.sessions.FindForAttach(caller_->tenant, attach.session(), attach.resume_token());
    if (session != nullptr) return OnAttached(attach, Join(attach, std::move(session)));
    PostResume(attach);
  }

  // Many attach when a server is lost. Throws if memory is exhausted: both callers have a guard, and end the stream.
  void PostResume(const v1::TrackRequest::Attach& attach) {
    const auto resume = [self = shared_from_this(), attach](const absl::Status& admitted) {
      self->ResumeAndAttach(attach, admitted);
    };
    services_.pool.slow().Post(caller_->tenant, resume, cancellation_, Overlap::kAny);
  }

  void ResumeAndAttach(const v1::TrackRequest::Attach& attach, const absl::Status& admitted) {
    if (!admitted.ok()) return OnAttached(attach, admitted);
    OnAttached(attach, OrOutOfMemory([&]() -> absl::StatusOr<Joined> {
                 EVPOSE_ASSIGN_OR_RETURN(auto session, services_.sessions.ResumeForAttach(
                                                           caller_->tenant, attach.session(), attach.resume_token()));
                 return Join(attach, std::move(session));
               }));
  }

  // All is done under one lock: events in between find a stream that has not attached yet.
  void OnAttached(const v1::TrackRequest::Attach& attach, absl::StatusOr<Joined> joined) {
    const std::lock_guard lock(mutex_);
    attach_ = attach;
    OnReadHandled();
    const absl::Status status = joined.status();
    if (joined.ok()) {
      SetSession(*std::move(joined));
    } else {
      SessionLog(attach.session().substr(0, kMaxNameBytes), caller_->tenant)
          .NotAttached(origin_, status, services_.log_limiter);
    }
    Fail(status);
    Pump();
  }

  void SetSession(Joined joined) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    alarm_.Cancel();
    session_ = std::move(joined.session);
    stream_ = joined.attachment.stream;
    ChangePhase(StreamInput::kAttached);
    if (phase_ == StreamPhase::kFinished) session_->Detach(stream_);  // cancelled meanwhile
    sent_pose_seq_ = joined.attachment.first_pose_seq - 1;
    sent_ack_.send_limit_bytes = joined.attachment.send_limit_bytes;
    attachment_ = std::move(joined.attachment);
  }

  absl::StatusOr<Joined> Join(const v1::TrackRequest::Attach& attach, std::shared_ptr<Session> session) {
    EVPOSE_RETURN_IF_ERROR(services_.sessions.CheckNotDraining());
    // The lock is not held: Attach notifies the stream that this one fences, and that stream takes its own lock.
    EVPOSE_ASSIGN_OR_RETURN(Attachment attachment, session->Attach(attach.resume_token(), attach.last_pose_seq(),
                                                                   weak_from_this(), origin_, attach.first_seq()));
    return Joined{std::move(session), std::move(attachment)};
  }

  absl::Status HandleEvents(v1::TrackRequest::EventChunk& events) {
    EventChunk chunk;
    chunk.seq = events.seq();
    chunk.discontinuity = events.discontinuity();
    if (events.has_crc32c()) chunk.crc32c = events.crc32c();
    chunk.payload = std::move(*events.mutable_payload());
    if (IsKeepalive(chunk)) return absl::OkStatus();
    EVPOSE_RETURN_IF_ERROR(Hold(services_.quotas.ChargeBytes(caller_->tenant, chunk.payload.size())));
    return session_->PushEvents(stream_, std::move(chunk));
  }

  absl::Status HandleResetPose(const v1::TrackRequest::ResetPose& reset) {
    EVPOSE_ASSIGN_OR_RETURN(const RigidTransform camera_from_object,
                            FromProto(reset.camera_from_object(), "reset_pose.camera_from_object"));
    return session_->PushResetPose(stream_, reset.seq(), reset.object_id(), camera_from_object);
  }

  absl::Status HandleEnd() {
    EVPOSE_RETURN_IF_ERROR(session_->PushEnd(stream_));
    const std::lock_guard lock(mutex_);
    ChangePhase(StreamInput::kEndReceived);
    return absl::OkStatus();
  }

  // Stops reading for this time: the tenant has exceeded its byte rate.
  absl::Status Hold(absl::Duration duration) {
    if (duration == absl::ZeroDuration()) return absl::OkStatus();
    const std::lock_guard lock(mutex_);
    is_held_ = true;
    return SetAlarm(alarm_, duration, &TrackReactor::OnAlarm);
  }

  absl::Status SetAlarm(CallAlarm& alarm, absl::Duration duration, void (TrackReactor::*on_alarm)())
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (phase_ == StreamPhase::kFinished) return absl::OkStatus();
    return alarm.Set(duration, [weak = weak_from_this(), on_alarm] {
      if (const auto self = weak.lock()) (self.get()->*on_alarm)();
    });
  }

  absl::Duration MeasureSilence(const StreamView& view) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    return silence_.Update({read_ == ReadState::kReading, view.is_idle, is_writing_}, std::chrono::steady_clock::now());
  }

  void OnIdleAlarm() {
    const std::lock_guard lock(mutex_);
    if (phase_ == StreamPhase::kOpen) FailAndPump([this] { return CheckSilence(); });
  }

  // Sets the alarm again unless the client has been silent for too long.
  absl::Status CheckSilence() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    const absl::Duration left = services_.stream_idle_timeout - MeasureSilence(session_->View(stream_));
    if (left <= absl::ZeroDuration()) return StreamIdleError(services_.stream_idle_timeout);
    return SetAlarm(idle_alarm_, left, &TrackReactor::OnIdleAlarm);
  }

  void OnAlarm() {
    const std::lock_guard lock(mutex_);
    is_held_ = false;
    FailAndPump([&] { return session_ != nullptr ? absl::OkStatus() : AttachTimeoutError(services_.attach_timeout); });
  }

  // Fails with the status of `check`, or OUT_OF_MEMORY: after an alarm, nothing else would end the stream.
  template <typename Check>
  void FailAndPump(const Check& check) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    RunUnlessOutOfMemory([this, status = OrOutOfMemory(check)]() ABSL_NO_THREAD_SAFETY_ANALYSIS { Fail(status); });
    Pump();
  }

  // The first failure counts. OK changes nothing.
  void Fail(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    failure_.Update(status);
    if (failure_.ok()) return;
    cancellation_->Cancel();
    ChangePhase(StreamInput::kFailure);
  }

  void PrepareFinish(absl::StatusCode code) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    RunUnlessOutOfMemory([this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { ChangePhase(StreamInput::kFinish); });
    services_.metrics.stream_ends[StreamKind::kTrack][code].Add();
    alarm_.Cancel();
    idle_alarm_.Cancel();
    if (session_ != nullptr) RunUnlessOutOfMemory([this] { session_->Detach(stream_); });
  }

  void Finish(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    PrepareFinish(status.code());
    grpc::ServerBidiReactor<v1::TrackRequest, v1::TrackResponse>::Finish(ToGrpcStatus(status));
  }

  // Another server on the same store had fenced the session before this stream attached here: it is reclaimed once.
  bool MustReclaim(const StreamView& view) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    const bool may_reclaim = phase_ == StreamPhase::kConfirming && !was_reclaimed_;
    if (!may_reclaim || !services_.sessions.options().shares_store) return false;
    return !view.status.ok() && absl::IsAborted(session_->Watch().status);
  }

  void Reclaim() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    was_reclaimed_ = true;
    ChangePhase(StreamInput::kOwnershipLost);
    attachment_.reset();
    session_.reset();
    PostResume(attach_);
  }

  // If memory is exhausted, the stream ends. An exception would end the process: the callers are threads of gRPC.
  void Pump() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    const auto proceed = [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return Proceed(), absl::OkStatus(); };
    const absl::Status status = OrOutOfMemory(proceed);
    if (status.ok() || phase_ == StreamPhase::kFinished) return;
    RunUnlessOutOfMemory([this, status]() ABSL_NO_THREAD_SAFETY_ANALYSIS { Fail(status); });
    if (!is_writing_) Finish(failure_);
  }

  void Proceed() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (phase_ == StreamPhase::kFinished) return;
    StreamView view;
    view.has_room = true;
    if (session_ != nullptr) {
      if (!is_writing_) session_->ReportSent(stream_, sent_pose_seq_);
      view = session_->View(stream_);
      if (MustReclaim(view)) return Reclaim();
      Fail(view.status);
    }
    if (phase_ == StreamPhase::kFailing) {
      if (!is_writing_) Finish(failure_);
      return;
    }
    // Reading starts only after `attached` has been written, because the client waits for it.
    if (MayRead(phase_) && read_ == ReadState::kIdle && !is_held_ && view.has_room) {
      read_ = ReadState::kReading;
      StartRead(&request_);
    }
    if (!is_writing_) Write(view);
    MeasureSilence(view);
  }

  void Write(const StreamView& view) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (phase_ == StreamPhase::kAttaching) return;
    if (phase_ == StreamPhase::kAwaitingAttach) {
      if (read_ == ReadState::kHalfClosed) Finish(InvalidField("attach", "must be the first message of the stream"));
      return;
    }
    response_.Clear();
    if (PickResponse(view)) {
      is_writing_ = true;
      StartWrite(&response_);
      return;
    }
    if (phase_ == StreamPhase::kFailing) return Finish(failure_);
    if (phase_ == StreamPhase::kEnding && view.has_ended) return WriteSummary();
    if (phase_ == StreamPhase::kDraining && view.is_idle && view.is_persisted) Finish(absl::OkStatus());
  }

  // Fills response_ with the next response, if there is one. Poses precede the ack of their chunk, and notices have
  // their place among the poses.
  bool PickResponse(const StreamView& view) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (phase_ == StreamPhase::kConfirming) return view.is_attached && PickAttached();
    if (go_away_.has_value()) {
      *response_.mutable_notice()->mutable_go_away()->mutable_deadline() = ToProto(*std::exchange(go_away_, {}));
      return true;
    }
    if (notices_.empty()) {
      for (SessionNotice& notice : session_->TakeNotices(stream_)) notices_.push_back(std::move(notice));
    }
    if (!notices_.empty() && notices_.front().after_pose_seq <= sent_pose_seq_) {
      *response_.mutable_notice() = ToProto(notices_.front(), session_->config());
      notices_.pop_front();
      return true;
    }
    // An ack is kept until the poses that precede it have been sent; a later ack does not replace it.
    if (!ack_.has_value() && view.ack != sent_ack_) ack_ = view.ack;
    if (ack_.has_value() && ack_->last_pose_seq <= sent_pose_seq_) return PickAck();
    return view.last_pose_seq > sent_pose_seq_ && PickPose();
  }

  bool PickAttached() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    auto& attached = (*response_.mutable_attached() = ToProto(*attachment_, session_->limits()));
    attachment_.reset();
    ChangePhase(StreamInput::kConfirmed);
    if (services_.stream_idle_timeout > absl::ZeroDuration()) {
      *attached.mutable_idle_timeout() = ToProto(services_.stream_idle_timeout);
      Fail(SetAlarm(idle_alarm_, services_.stream_idle_timeout, &TrackReactor::OnIdleAlarm));
    }
    return phase_ != StreamPhase::kFailing;
  }

  bool PickAck() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    sent_ack_ = *std::exchange(ack_, std::nullopt);
    *response_.mutable_ack() = ToProto(sent_ack_);
    return true;
  }

  bool PickPose() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (page_.empty()) {
      for (StoredPose& pose : session_->pose_log().Read(sent_pose_seq_, kPosesPerPage))
        page_.push_back(std::move(pose));
    }
    if (page_.empty() || page_.front().pose_seq != sent_pose_seq_ + 1) {
      Fail(WithReason(absl::AbortedError(absl::StrCat("pose ", sent_pose_seq_ + 1,
                                                      " is no longer stored; attach again to go on after the gap")),
                      v1::POSES_EXPIRED));
      return false;
    }
    *response_.mutable_pose() = ToProto(page_.front(), session_->config());
    page_.pop_front();
    ++sent_pose_seq_;
    return true;
  }

  void WriteSummary() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    *response_.mutable_summary()->mutable_health() = ToProto(session_->Snapshot().health, session_->config());
    PrepareFinish(absl::StatusCode::kOk);
    StartWriteAndFinish(&response_, grpc::WriteOptions(), grpc::Status::OK);
  }

  const ServiceContext services_;
  grpc::CallbackServerContext* const context_;
  uint64_t access_version_;  // used by CheckAccess() only, with the lock
  const absl::StatusOr<Caller> caller_;
  std::shared_ptr<TrackReactor> self_;                                                   // until OnDone
  std::shared_ptr<const void> reservation_;                                              // in the quota of streams
  const std::shared_ptr<Cancellation> cancellation_ = std::make_shared<Cancellation>();  // of resuming the session
  // Used by the reading side without the lock. The session and the stream change only while nothing is read.
  v1::TrackRequest request_;
  std::shared_ptr<Session> session_;
  uint64_t stream_ = 0;
  StreamOrigin origin_;  // set once, when `attach` has been read

  std::mutex mutex_;
  StreamPhase phase_ ABSL_GUARDED_BY(mutex_) = StreamPhase::kAwaitingAttach;
  ReadState read_ ABSL_GUARDED_BY(mutex_) = ReadState::kIdle;
  bool is_writing_ ABSL_GUARDED_BY(mutex_) = false;  // a write is in flight
  bool is_held_ ABSL_GUARDED_BY(mutex_) = false;     // the tenant has exceeded its byte rate
  bool was_reclaimed_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status failure_ ABSL_GUARDED_BY(mutex_);
  v1::TrackRequest::Attach attach_ ABSL_GUARDED_BY(mutex_);
  CallAlarm alarm_ ABSL_GUARDED_BY(mutex_);  // until the stream attaches, then while it is held
  CallAlarm idle_alarm_ ABSL_GUARDED_BY(mutex_);
  StreamSilence silence_ ABSL_GUARDED_BY(mutex_);
  // Messages that wait to be sent:
  v1::TrackResponse response_ ABSL_GUARDED_BY(mutex_);
  std::optional<Attachment> attachment_ ABSL_GUARDED_BY(mutex_);
  std::optional<absl::Duration> go_away_ ABSL_GUARDED_BY(mutex_);
  std::deque<SessionNotice> notices_ ABSL_GUARDED_BY(mutex_);
  std::deque<StoredPose> page_ ABSL_GUARDED_BY(mutex_);
  std::optional<SessionAck> ack_ ABSL_GUARDED_BY(mutex_);
  // Sent:
  uint64_t sent_pose_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  SessionAck sent_ack_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace

grpc::ServerBidiReactor<v1::TrackRequest, v1::TrackResponse>* StartTrack(const ServiceContext& services,
                                                                         grpc::CallbackServerContext* context) {
  const auto reactor = std::make_shared<TrackReactor>(services, context);
  reactor->Start();
  return reactor.get();
}

}  // namespace evpose::server
