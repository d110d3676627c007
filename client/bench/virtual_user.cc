// SPDX-License-Identifier: Apache-2.0
#include "client/bench/virtual_user.h"

#include <algorithm>
#include <random>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/conversion.h"
#include "client/lib/messages/status_details.h"

namespace evpose::client {
namespace {

constexpr std::chrono::seconds kCallTimeout{60};    // as long as the client library waits for a call
constexpr std::chrono::seconds kAttachTimeout{10};  // a slower attach counts as a failure
// Poses farther apart do not belong to adjacent windows, which last for 20 ms at most.
constexpr int64_t kMaxWindowUs = 40'000;

std::string ReasonName(const absl::Status& status) {
  const std::string reason = GetDetails(status).reason;
  return reason.empty() ? absl::StatusCodeToString(status.code()) : reason;
}

int64_t MicrosecondsOf(VirtualUser::Time::duration duration) {
  return std::chrono::duration_cast<std::chrono::microseconds>(duration).count();
}

// The random part of the request IDs of this process.
const std::string& RunName() {
  static const std::string* const name = [] {
    std::random_device random;
    return new std::string(absl::StrCat("load-", random(), "-", random()));
  }();
  return *name;
}

}  // namespace

// A unary call on a session.
struct VirtualUser::Call {
  grpc::ClientContext context;
  v1::CreateSessionRequest create;
  v1::CreateSessionResponse created;
  v1::DeleteSessionRequest remove;
  google::protobuf::Empty removed;
};

class VirtualUser::Stream : public grpc::ClientBidiReactor<v1::TrackRequest, v1::TrackResponse> {
 public:
  Stream(VirtualUser& user, v1::SessionService::Stub& stub) : user_(user) { stub.async()->Track(&context_, this); }
  // Sends the first message. Called once.
  void Begin(const v1::TrackRequest& attach) {
    StartRead(&response_);
    StartWrite(&attach);
    StartCall();
  }
  void Cancel() { context_.TryCancel(); }

  void OnReadDone(bool ok) override {
    if (!ok) return;
    user_.OnResponse(response_);
    StartRead(&response_);
  }
  void OnWriteDone(bool ok) override { user_.OnWritten(ok); }
  void OnDone(const grpc::Status& status) override { user_.OnStreamEnd(status); }

 private:
  VirtualUser& user_;
  grpc::ClientContext context_;
  v1::TrackResponse response_;
};

VirtualUser::VirtualUser(LoadTarget& target, size_t index, size_t num_watchers)
    : target_(target), index_(index), server_(index % target.stubs.size()), backoff_(RetryOptions()) {
  for (size_t i = 0; i < num_watchers; ++i) watchers_.push_back(std::make_unique<LoadWatcher>(target.watch_hz));
}

VirtualUser::~VirtualUser() = default;

v1::SessionService::Stub& VirtualUser::stub() const {
  const auto& connections = target_.stubs[server_];
  return *connections[index_ % connections.size()];
}

void VirtualUser::Act(Time now) {
  const std::lock_guard lock(mutex_);
  now_ = now;
  if (state_ == UserState::kWaiting && MustEnd()) ChangeState(UserInput::kStop);
  if (state_ == UserState::kWaiting && now >= act_at_ && target_.free_creations > 0) Create(now);
  if (state_ == UserState::kBroken && now >= act_at_) Attach(now);
  if (state_ == UserState::kAttaching && now >= act_at_) stream_->Cancel();
  if (state_ == UserState::kStreaming) {
    if (!session_.began_at) session_.began_at = now;
    Send();
  }
  if (!session_.was_attached || state_ == UserState::kOver || goal_ == Goal::kCancel) return;
  for (const auto& watcher : watchers_) watcher->Watch(stub(), session_.name, now);
}

void VirtualUser::Create(Time now) {
  --target_.free_creations;
  ChangeState(UserInput::kCreate);
  if (request_id_.empty()) request_id_ = absl::StrCat(RunName(), "-", index_, "-", num_requests_++);
  call_ = std::make_unique<Call>();
  call_->context.set_deadline(std::chrono::system_clock::now() + kCallTimeout);
  *call_->create.mutable_config() = target_.config;
  call_->create.set_request_id(request_id_);
  act_at_ = now;
  stub().async()->CreateSession(&call_->context, &call_->create, &call_->created,
                                [this](const grpc::Status& status) { OnCreated(status); });
}

void VirtualUser::OnCreated(const grpc::Status& grpc_status) {
  const std::lock_guard lock(mutex_);
  ++target_.free_creations;
  const absl::Status status = FromGrpc(grpc_status, "CreateSession");
  if (status.ok()) {
    has_response_ = true;
    request_id_.clear();
    backoff_.Reset();
    ++counts_.created;
    session_ = Position();
    session_.name = call_->created.session().name();
    session_.tokens = {call_->created.resume_token()};
    ChangeState(UserInput::kCreated);
    if (goal_ != Goal::kCancel) return;
    ++counts_.unfinished;
    return Delete();
  }
  ++counts_.refusals[ReasonName(status)];
  const absl::Duration retry_in = GetDetails(status).retry_in;
  const bool is_unreachable = absl::IsUnavailable(status) || absl::IsDeadlineExceeded(status);
  has_response_ |= !is_unreachable;
  const bool is_final = retry_in == absl::ZeroDuration() && !is_unreachable;
  if (is_final || goal_ == Goal::kCancel) return ChangeState(UserInput::kStop);
  if (!is_unreachable) request_id_.clear();
  // A server that is full may not be the only one.
  server_ = (server_ + 1) % target_.stubs.size();
  act_at_ = now_ + absl::ToChronoMicroseconds(std::max(retry_in, backoff_.Next()));
  ChangeState(UserInput::kRefused);
}

void VirtualUser::Attach(Time now) {
  stream_ = std::make_unique<Stream>(*this, stub());
  ChangeState(UserInput::kAttach);
  is_writing_ = true;
  is_shutting_down_ = is_complete_ = false;
  request_.Clear();
  v1::TrackRequest::Attach& attach = *request_.mutable_attach();
  attach.set_session(session_.name);
  attach.set_resume_token(session_.tokens[session_.token]);
  attach.set_last_pose_seq(session_.attaches_from_first_pose ? 0 : session_.last_pose_seq);
  attach.set_first_seq(1);  // the recording has all of them
  act_at_ = now + kAttachTimeout;
  stream_->Begin(request_);
}

void VirtualUser::Send() {
  if (is_writing_ || is_complete_ || state_ != UserState::kStreaming) return;
  if (is_shutting_down_ && !session_.has_summary) {
    is_complete_ = true;
    stream_->StartWritesDone();
    return;
  }
  if (goal_ == Goal::kGoOn) return SendChunk();
  request_.mutable_end();
  is_writing_ = is_complete_ = true;
  // Half-closes the stream, as the client library does: HAProxy may drop the last response of a stream that its client
  // has not half-closed.
  stream_->StartWriteLast(&request_, grpc::WriteOptions());
}

void VirtualUser::SendChunk() {
  const LoadRecording& recording = target_.recording;
  if (!session_.began_at) return;
  const uint64_t seq = session_.next_seq;
  if (now_ < *session_.began_at + std::chrono::microseconds(static_cast<int64_t>(seq) * recording.chunk_us())) {
    return;
  }
  std::string payload = recording.Payload(seq - 1);
  if (sent_bytes_ + payload.size() > limit_bytes_) return;
  if (seq > session_.most_seq) {
    session_.most_seq = seq;
    counts_.events += recording.NumEvents(seq - 1);
  }
  sent_bytes_ += payload.size();
  ++session_.next_seq;
  request_.mutable_events()->set_seq(seq);
  request_.mutable_events()->set_payload(std::move(payload));
  is_writing_ = true;
  stream_->StartWrite(&request_);
}

void VirtualUser::OnWritten(bool ok) {
  const std::lock_guard lock(mutex_);
  is_writing_ = false;
  if (ok) Send();
}

void VirtualUser::OnResponse(const v1::TrackResponse& response) {
  const std::lock_guard lock(mutex_);
  switch (response.message_case()) {
    case v1::TrackResponse::kAttached:
      return HandleAttached(response.attached());
    case v1::TrackResponse::kPose:
      return HandlePose(response.pose());
    case v1::TrackResponse::kAck:
      limit_bytes_ = response.ack().send_limit_bytes();
      return Send();
    case v1::TrackResponse::kNotice:
      is_shutting_down_ |= response.notice().has_go_away();
      return;
    case v1::TrackResponse::kSummary:
      session_.has_summary = true;
      if (response.summary().health().poses() > session_.last_pose_seq) {
        counts_.lost_poses += response.summary().health().poses() - session_.last_pose_seq;
      }
      return;
    case v1::TrackResponse::MESSAGE_NOT_SET:
      return;
  }
}

void VirtualUser::HandleAttached(const v1::TrackResponse::Attached& attached) {
  ChangeState(UserInput::kAttached);
  if (session_.was_attached) {
    ++counts_.reconnections;
    session_.pause.has_reconnected = true;
  }
  session_.was_attached = true;
  session_.away_since.reset();
  session_.servers_without = 0;
  session_.attaches_from_first_pose = false;
  session_.token = 0;
  session_.tokens.insert(session_.tokens.begin(), attached.resume_token());
  if (session_.tokens.size() > kMaxTriedTokens) session_.tokens.pop_back();
  session_.next_seq = attached.next_seq();
  sent_bytes_ = 0;
  limit_bytes_ = attached.send_limit_bytes();
  if (attached.first_pose_seq() > session_.last_pose_seq + 1) {
    counts_.lost_poses += attached.first_pose_seq() - 1 - session_.last_pose_seq;
    session_.last_pose_seq = attached.first_pose_seq() - 1;
  }
  backoff_.Reset();
}

void VirtualUser::HandlePose(const v1::Pose& pose) {
  if (pose.pose_seq() <= session_.last_pose_seq) return;  // delivered on an earlier stream
  counts_.lost_poses += pose.pose_seq() - session_.last_pose_seq - 1;
  session_.last_pose_seq = pose.pose_seq();
  ++counts_.poses;
  const Time arrival = std::chrono::steady_clock::now();
  const int64_t last_t_us = std::exchange(session_.last_t_us, pose.t_us());
  const Time last_arrival = std::exchange(session_.last_arrival, arrival);
  if (last_t_us < 0) return;
  session_.pause.longest_us = std::max(session_.pause.longest_us, MicrosecondsOf(arrival - last_arrival));
  if (pose.t_us() - last_t_us > kMaxWindowUs) return;
  const int64_t due_us = WindowDueUs(last_t_us, pose.t_us(), target_.recording.chunk_us());
  const int64_t latency_us = MicrosecondsOf(last_arrival - *session_.began_at) - due_us;
  counts_.AddLatency(std::max<int64_t>(latency_us, 0));
}

void VirtualUser::OnStreamEnd(const grpc::Status& grpc_status) {
  const std::lock_guard lock(mutex_);
  const Time now = std::chrono::steady_clock::now();
  is_writing_ = false;
  if (session_.has_summary) {
    ++counts_.completed;
    return Delete();
  }
  if (goal_ == Goal::kCancel) {
    ++counts_.unfinished;
    return Delete();
  }
  const absl::Status status =
      grpc_status.ok() ? absl::UnavailableError("the stream ended without a summary") : FromGrpc(grpc_status, "Track");
  if (PlanRetry(status, now)) return ChangeState(UserInput::kLost);
  ++counts_.failures[ReasonName(status)];
  Delete();
}

bool VirtualUser::PlanRetry(const absl::Status& status, Time now) {
  bool is_same_server = false;
  switch (AdviseOn(status)) {
    case RetryAdvice::kTryAgain:
      session_.servers_without = 0;
      break;
    case RetryAdvice::kTryOtherServer:
      if (++session_.servers_without >= target_.stubs.size()) return false;
      break;
    case RetryAdvice::kTryOtherToken:
      if (++session_.token >= session_.tokens.size()) return false;
      is_same_server = true;
      break;
    case RetryAdvice::kAttachFromFirstPose:
      if (std::exchange(session_.attaches_from_first_pose, true)) return false;
      is_same_server = true;
      break;
    case RetryAdvice::kTryOtherAuthToken:
    case RetryAdvice::kGiveUp:
      return false;
  }
  const bool is_first = !session_.away_since;
  if (is_first) session_.away_since = now;
  if (now - *session_.away_since > absl::ToChronoMicroseconds(RetryOptions().max_outage)) return false;
  const bool is_at_once = is_same_server || is_first;
  if (!is_same_server) server_ = (server_ + 1) % target_.stubs.size();
  act_at_ = is_at_once ? now : now + absl::ToChronoMicroseconds(std::max(backoff_.Next(), GetDetails(status).retry_in));
  return true;
}

void VirtualUser::RecordPause() {
  if (session_.last_t_us < 0) return;
  // If the session ended with an error, the time since its last pose counts as a pause, too.
  if (!session_.has_summary) {
    const auto since_last_pose = std::chrono::steady_clock::now() - session_.last_arrival;
    session_.pause.longest_us = std::max(session_.pause.longest_us, MicrosecondsOf(since_last_pose));
  }
  counts_.pauses.push_back(session_.pause);
}

void VirtualUser::Delete() {
  RecordPause();
  ChangeState(UserInput::kDelete);
  call_ = std::make_unique<Call>();
  call_->context.set_deadline(std::chrono::system_clock::now() + kCallTimeout);
  call_->remove.set_name(session_.name);
  call_->remove.set_allow_missing(true);
  stub().async()->DeleteSession(&call_->context, &call_->remove, &call_->removed,
                                [this](const grpc::Status&) { OnDeleted(); });
}

void VirtualUser::OnDeleted() {
  const std::lock_guard lock(mutex_);
  ChangeState(UserInput::kDeleted);
  if (MustEnd()) ChangeState(UserInput::kStop);
  if (goal_ == Goal::kReplace) goal_ = Goal::kGoOn;
  act_at_ = now_;
  session_.was_attached = false;
}

void VirtualUser::BeginMeasuring() {
  const std::lock_guard lock(mutex_);
  counts_.latency = server::LatencyHistogram();
  counts_.max_latency_us = 0;
  counts_.pauses.clear();
  session_.pause = SessionPause();
}

void VirtualUser::Replace() {
  const std::lock_guard lock(mutex_);
  const bool has_session =
      state_ == UserState::kBroken || state_ == UserState::kAttaching || state_ == UserState::kStreaming;
  if (has_session && goal_ == Goal::kGoOn) goal_ = Goal::kReplace;
}

void VirtualUser::Finish() {
  const std::lock_guard lock(mutex_);
  if (!MustEnd()) goal_ = Goal::kFinish;
}

void VirtualUser::Cancel() {
  for (const auto& watcher : watchers_) watcher->Cancel();
  const std::lock_guard lock(mutex_);
  goal_ = Goal::kCancel;
  switch (state_) {
    case UserState::kWaiting:
      ChangeState(UserInput::kStop);
      break;
    case UserState::kBroken:
      ++counts_.unfinished;
      Delete();
      break;
    case UserState::kAttaching:
    case UserState::kStreaming:
      stream_->Cancel();
      break;
    case UserState::kCreating:
    case UserState::kDeleting:
      call_->context.TryCancel();
      break;
    case UserState::kOver:
      break;
  }
}

bool VirtualUser::IsIdle() const {
  for (const auto& watcher : watchers_) {
    if (!watcher->IsIdle()) return false;
  }
  const std::lock_guard lock(mutex_);
  return state_ == UserState::kOver;
}

bool VirtualUser::HasResponse() const {
  const std::lock_guard lock(mutex_);
  return has_response_;
}

LoadCounts VirtualUser::counts() const {
  const std::lock_guard lock(mutex_);
  LoadCounts counts = counts_;
  for (const auto& watcher : watchers_) {
    counts.watched_poses += watcher->poses();
    counts.unwatched_poses += watcher->skipped();
  }
  return counts;
}

}  // namespace evpose::client
