// SPDX-License-Identifier: Apache-2.0
#include "client/bench/load_place.h"

#include <algorithm>
#include <random>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/conversion.h"
#include "client/lib/messages/status_details.h"

namespace evpose::client {
namespace {

constexpr std::chrono::seconds kCallTimeout{60};
constexpr std::chrono::seconds kAttachTimeout{10};
constexpr size_t kMaxTokens = 10;  // as ReconnectingStream: more attaches than a store with a stale replica loses
// Poses farther apart do not belong to adjacent windows, which last for 20 ms at most.
constexpr int64_t kMaxWindow_us = 40'000;

std::string ReasonName(const absl::Status& status) {
  const std::string reason = GetDetails(status).reason;
  return reason.empty() ? absl::StatusCodeToString(status.code()) : reason;
}

int64_t MicrosecondsOf(LoadPlace::Time::duration duration) {
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
struct LoadPlace::Call {
  grpc::ClientContext context;
  v1::CreateSessionRequest create;
  v1::CreateSessionResponse created;
  v1::DeleteSessionRequest remove;
  google::protobuf::Empty removed;
};

class LoadPlace::Stream : public grpc::ClientBidiReactor<v1::TrackRequest, v1::TrackResponse> {
 public:
  Stream(LoadPlace& place, v1::SessionService::Stub& stub) : place_(place) { stub.async()->Track(&context_, this); }
  // Sends the first message. Called once.
  void Begin(const v1::TrackRequest& attach) {
    StartRead(&response_);
    StartWrite(&attach);
    StartCall();
  }
  void Cancel() { context_.TryCancel(); }

  void OnReadDone(bool ok) override {
    if (!ok) return;
    place_.OnResponse(response_);
    StartRead(&response_);
  }
  void OnWriteDone(bool ok) override { place_.OnWritten(ok); }
  void OnDone(const grpc::Status& status) override { place_.OnStreamEnd(status); }

 private:
  LoadPlace& place_;
  grpc::ClientContext context_;
  v1::TrackResponse response_;
};

LoadPlace::LoadPlace(LoadTarget& target, size_t index, size_t num_watchers)
    : target_(target), index_(index), server_(index % target.stubs.size()), backoff_(RetryOptions()) {
  for (size_t i = 0; i < num_watchers; ++i) watchers_.push_back(std::make_unique<LoadWatcher>(target.watch_hz));
}

LoadPlace::~LoadPlace() = default;

v1::SessionService::Stub& LoadPlace::stub() const {
  const auto& connections = target_.stubs[server_];
  return *connections[index_ % connections.size()];
}

void LoadPlace::Act(Time now) {
  const std::lock_guard lock(mutex_);
  now_ = now;
  if (state_ == State::kWaiting && is_finishing_) state_ = State::kOver;
  if (state_ == State::kWaiting && now >= act_at_ && target_.free_creations > 0) Create(now);
  if (state_ == State::kBroken && now >= act_at_) Attach(now);
  if (state_ == State::kAttaching && now >= act_at_) stream_->Cancel();
  if (state_ == State::kStreaming) {
    if (!session_.began_at) session_.began_at = now;
    Send();
  }
  if (!session_.was_attached || state_ == State::kOver || is_cancelled_) return;
  for (const auto& watcher : watchers_) watcher->Watch(stub(), session_.name, now);
}

void LoadPlace::Create(Time now) {
  --target_.free_creations;
  state_ = State::kCreating;
  if (request_id_.empty()) request_id_ = absl::StrCat(RunName(), "-", index_, "-", num_requests_++);
  call_ = std::make_unique<Call>();
  call_->context.set_deadline(std::chrono::system_clock::now() + kCallTimeout);
  *call_->create.mutable_config() = target_.config;
  call_->create.set_request_id(request_id_);
  act_at_ = now;
  stub().async()->CreateSession(&call_->context, &call_->create, &call_->created,
                                [this](const grpc::Status& status) { OnCreated(status); });
}

void LoadPlace::OnCreated(const grpc::Status& grpc_status) {
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
    session_.is_ending = is_finishing_;
    if (is_cancelled_) {
      ++counts_.unfinished;
      return Delete();
    }
    state_ = State::kBroken;
    return;
  }
  ++counts_.refusals[ReasonName(status)];
  const absl::Duration retry_in = GetDetails(status).retry_in;
  const bool is_away = absl::IsUnavailable(status) || absl::IsDeadlineExceeded(status);
  has_response_ |= !is_away;
  if ((retry_in == absl::ZeroDuration() && !is_away) || is_cancelled_) {
    state_ = State::kOver;
    return;
  }
  if (!is_away) request_id_.clear();
  // A server that is full may not be the only one.
  server_ = (server_ + 1) % target_.stubs.size();
  act_at_ = now_ + absl::ToChronoMicroseconds(std::max(retry_in, backoff_.Next()));
  state_ = State::kWaiting;
}

void LoadPlace::Attach(Time now) {
  stream_ = std::make_unique<Stream>(*this, stub());
  state_ = State::kAttaching;
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

void LoadPlace::Send() {
  if (is_writing_ || is_complete_ || state_ != State::kStreaming) return;
  if (is_shutting_down_ && !session_.has_summary) {
    is_complete_ = true;
    stream_->StartWritesDone();
    return;
  }
  if (!session_.is_ending) {
    SendChunk();
    return;
  }
  request_.mutable_end();
  is_writing_ = is_complete_ = true;
  stream_->StartWrite(&request_);
}

bool LoadPlace::SendChunk() {
  const LoadRecording& recording = target_.recording;
  if (!session_.began_at) return false;
  const uint64_t seq = session_.next_seq;
  if (now_ < *session_.began_at + std::chrono::microseconds(static_cast<int64_t>(seq) * recording.chunk_us())) {
    return false;
  }
  std::string payload = recording.Payload(seq - 1);
  if (sent_bytes_ + payload.size() > limit_bytes_) return false;
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
  return true;
}

void LoadPlace::OnWritten(bool ok) {
  const std::lock_guard lock(mutex_);
  is_writing_ = false;
  if (ok) Send();
}

void LoadPlace::OnResponse(const v1::TrackResponse& response) {
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

void LoadPlace::HandleAttached(const v1::TrackResponse::Attached& attached) {
  state_ = State::kStreaming;
  if (session_.was_attached) ++counts_.reconnections;
  session_.was_attached = true;
  session_.away_since.reset();
  session_.servers_without = 0;
  session_.attaches_from_first_pose = false;
  session_.token = 0;
  session_.tokens.insert(session_.tokens.begin(), attached.resume_token());
  if (session_.tokens.size() > kMaxTokens) session_.tokens.pop_back();
  session_.next_seq = attached.next_seq();
  sent_bytes_ = 0;
  limit_bytes_ = attached.send_limit_bytes();
  if (attached.first_pose_seq() > session_.last_pose_seq + 1) {
    counts_.lost_poses += attached.first_pose_seq() - 1 - session_.last_pose_seq;
    session_.last_pose_seq = attached.first_pose_seq() - 1;
  }
  backoff_.Reset();
}

void LoadPlace::HandlePose(const v1::Pose& pose) {
  if (pose.pose_seq() <= session_.last_pose_seq) return;  // delivered on an earlier stream
  counts_.lost_poses += pose.pose_seq() - session_.last_pose_seq - 1;
  session_.last_pose_seq = pose.pose_seq();
  ++counts_.poses;
  const Time arrival = std::chrono::steady_clock::now();
  const int64_t last_t_us = std::exchange(session_.last_t_us, pose.t_us());
  const Time last_arrival = std::exchange(session_.last_arrival, arrival);
  if (last_t_us < 0) return;
  counts_.longest_pause_us = std::max(counts_.longest_pause_us, MicrosecondsOf(arrival - last_arrival));
  if (pose.t_us() - last_t_us > kMaxWindow_us) return;
  const int64_t due_us = WindowDue_us(last_t_us, pose.t_us(), target_.recording.chunk_us());
  const int64_t latency_us = MicrosecondsOf(last_arrival - *session_.began_at) - due_us;
  counts_.AddLatency(std::max<int64_t>(latency_us, 0));
}

void LoadPlace::OnStreamEnd(const grpc::Status& grpc_status) {
  const std::lock_guard lock(mutex_);
  const Time now = std::chrono::steady_clock::now();
  is_writing_ = false;
  if (session_.has_summary) {
    ++counts_.completed;
    return Delete();
  }
  if (is_cancelled_) {
    ++counts_.unfinished;
    return Delete();
  }
  const absl::Status status =
      grpc_status.ok() ? absl::UnavailableError("the stream ended without a summary") : FromGrpc(grpc_status, "Track");
  if (PlanRetry(status, now)) {
    state_ = State::kBroken;
    return;
  }
  ++counts_.failures[ReasonName(status)];
  Delete();
}

bool LoadPlace::PlanRetry(const absl::Status& status, Time now) {
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

void LoadPlace::Delete() {
  state_ = State::kDeleting;
  call_ = std::make_unique<Call>();
  call_->context.set_deadline(std::chrono::system_clock::now() + kCallTimeout);
  call_->remove.set_name(session_.name);
  call_->remove.set_allow_missing(true);
  stub().async()->DeleteSession(&call_->context, &call_->remove, &call_->removed,
                                [this](const grpc::Status&) { OnDeleted(); });
}

void LoadPlace::OnDeleted() {
  const std::lock_guard lock(mutex_);
  state_ = is_finishing_ ? State::kOver : State::kWaiting;
  act_at_ = now_;
  session_.was_attached = false;
}

void LoadPlace::BeginMeasuring() {
  const std::lock_guard lock(mutex_);
  counts_.latency = server::LatencyHistogram();
  counts_.max_latency_us = counts_.longest_pause_us = 0;
}

void LoadPlace::Replace() {
  const std::lock_guard lock(mutex_);
  session_.is_ending = true;
}

void LoadPlace::Finish() {
  const std::lock_guard lock(mutex_);
  is_finishing_ = true;
  session_.is_ending = true;
}

void LoadPlace::Cancel() {
  for (const auto& watcher : watchers_) watcher->Cancel();
  const std::lock_guard lock(mutex_);
  is_cancelled_ = is_finishing_ = true;
  switch (state_) {
    case State::kWaiting:
      state_ = State::kOver;
      break;
    case State::kBroken:
      ++counts_.unfinished;
      Delete();
      break;
    case State::kAttaching:
    case State::kStreaming:
      stream_->Cancel();
      break;
    case State::kCreating:
    case State::kDeleting:
      call_->context.TryCancel();
      break;
    case State::kOver:
      break;
  }
}

bool LoadPlace::IsIdle() const {
  for (const auto& watcher : watchers_) {
    if (!watcher->IsIdle()) return false;
  }
  const std::lock_guard lock(mutex_);
  return state_ == State::kOver;
}

bool LoadPlace::HasResponse() const {
  const std::lock_guard lock(mutex_);
  return has_response_;
}

LoadCounts LoadPlace::counts() const {
  const std::lock_guard lock(mutex_);
  LoadCounts counts = counts_;
  for (const auto& watcher : watchers_) {
    counts.watched_poses += watcher->poses();
    counts.unwatched_poses += watcher->skipped();
  }
  return counts;
}

}  // namespace evpose::client
