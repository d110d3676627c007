// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session.h"

#include <algorithm>
#include <utility>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "server/runtime/client_text.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"
#include "server/runtime/random_name.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/session_beginning.h"
#include "server/sessions/stream/chunk_check.h"

namespace evpose::server {
namespace {

// Longest time for which a client keeps the data of its camera while it searches for the server that has restored its
// session: the default of its retries.
constexpr std::chrono::seconds kLongestSearch{120};

StreamGate::Options GateOptions(const SessionConfig& config, const SessionLimits& limits,
                                const std::shared_ptr<SessionLog>& log) {
  const auto describe = [](const GateState& state) {
    return std::string(WriterStateName(state.writer)) + " " + std::string(InputStateName(state.input));
  };
  return {.session = log->session(),
          .credit_bytes = limits.credit_bytes,
          .overload_policy = config.overload_policy,
          .on_transition = [log, describe](const GateTransition& transition) {
            log->StateChanged(std::string(GateEventName(transition.event)), describe(transition.from),
                              describe(transition.to));
          }};
}

}  // namespace

Session::Session(SessionParts parts, WorkerPool& pool)
    : memory_charge_(std::move(parts.memory_charge)),
      log_(std::make_shared<SessionLog>(std::move(parts.name), parts.tenant, parts.limits.log_limiter)),
      config_(std::move(parts.config)),
      limits_(parts.limits),
      create_time_(parts.create_time),
      clocks_(std::move(parts.clocks)),
      metrics_(std::move(parts.metrics)),
      committer_(std::make_shared<SessionCommitter>(log_, std::move(parts.lease), PersistedAt(parts.beginning), pool,
                                                    limits_.backoff, metrics_)),
      watchers_(std::make_shared<Watchers>(pool)),
      images_(std::make_shared<EventImages>(config_, parts.tenant, clocks_.steady, pool, metrics_)),
      pose_log_(limits_.pose_log_capacity, FirstPoseSeq(parts.beginning)),
      turns_(pool.AddSession(parts.tenant, log_->trace_id())),
      worker_(config_, {clocks_.steady, metrics_, log_, images_}, std::move(parts.pipeline),
              parts.beginning.checkpoint.health),
      stored_segments_(limits_.pose_log_bytes, parts.stored_poses),
      gate_(GateOptions(config_, limits_, log_),
            GateStart(parts.beginning, std::move(parts.resume_token), clocks_.wall())),
      report_(parts.beginning, worker_.Objects(), log_->trace_id()),
      arrivals_(gate_.resume_token().empty() ? kLongestSearch : std::chrono::seconds(0)),  // empty: restored
      checkpoints_(limits_.writes_checkpoints, LastCheckpoint(parts.beginning), LastPoseSeq(parts.beginning)),
      model_uses_(std::move(parts.model_uses)) {
  // Makes the initialization visible, for race detectors, to the threads that take the lock later.
  const std::lock_guard lock(mutex_);
  pose_log_.Append(parts.beginning.poses);
}

// The last reference may be released by a thread of gRPC. Race detectors do not see its reference counting: the lock
// orders the destruction after the calls of the other threads.
Session::~Session() { const std::lock_guard lock(mutex_); }

std::shared_ptr<Session> Session::Start(SessionParts parts, WorkerPool& pool) {
  const std::shared_ptr<Session> session(new Session(std::move(parts), pool));
  session->committer_->SetListener([weak = session->weak_from_this()] {
    const auto self = weak.lock();
    if (self == nullptr) return;
    const absl::Status status = OrOutOfMemory([&self] { return self->OnCommitProgress(), absl::OkStatus(); });
    // The session may have missed its next turn.
    if (!status.ok()) RunUnlessOutOfMemory([&] { self->Close(status); });
  });
  return session;
}

std::string Session::resume_token() const {
  const std::lock_guard lock(mutex_);
  return gate_.resume_token();
}

bool Session::IsTokenValid(absl::string_view resume_token) const {
  const std::string digest = TokenDigest(resume_token);
  const std::lock_guard lock(mutex_);
  return IsDigestValid(digest, gate_.lifecycle());
}

std::optional<absl::Time> Session::expire_time() const {
  const std::lock_guard lock(mutex_);
  const std::optional<absl::Time> detached_at = gate_.detached_at();
  if (!detached_at.has_value()) return std::nullopt;
  return *detached_at + limits_.expiry;
}

WatchView Session::Watch() const {
  const std::lock_guard lock(mutex_);
  return {gate_.closed(), gate_.has_ended(), report_.poses()};
}

SessionSnapshot Session::Snapshot() const {
  const std::lock_guard lock(mutex_);
  SessionSnapshot snapshot;
  snapshot.closed = gate_.closed();
  snapshot.state = gate_.has_ended()     ? SessionState::kEnded
                   : gate_.is_attached() ? SessionState::kAttached
                                         : SessionState::kDetached;
  if (!gate_.is_attached()) snapshot.expire_time = *gate_.detached_at() + limits_.expiry;
  snapshot.health = report_.HealthWithLatencies();
  snapshot.health.queue_age_us = QueueAgeUs();
  const SessionTurns::Use use = turns_->use();
  snapshot.health.processing = {use.cpu_per_s, use.limit, pace_.is_behind(), use.tenant_cpu_per_s, use.tenant_limit};
  return snapshot;
}

SessionSums Session::Sums() const {
  SessionSnapshot snapshot = Snapshot();
  return {.health = std::move(snapshot.health),
          .lifetime = clocks_.wall() - create_time_,
          .was_reported = snapshot.state == SessionState::kEnded || absl::IsDataLoss(snapshot.closed)};
}

void Session::AddTo(SessionTotals& totals) const {
  totals.image_watchers += images_->num_readers();
  const std::lock_guard lock(mutex_);
  if (!gate_.closed().ok()) {
    ++totals.closed;
    return;
  }
  totals.queued_bytes += queue_.bytes();
  totals.oldest_queue_age_us = std::max(totals.oldest_queue_age_us, QueueAgeUs());
  if (gate_.has_ended()) {
    ++totals.ended;
    return;
  }
  ++(gate_.is_attached() ? totals.attached : totals.detached);
  for (const ObjectHealth& object : report_.health().objects) ++totals.objects[static_cast<size_t>(object.state)];
}

int64_t Session::MicrosecondsSince(SteadyTime begin) const {
  return std::chrono::duration_cast<std::chrono::microseconds>(clocks_.steady() - begin).count();
}

int64_t Session::QueueAgeUs() const {
  const std::optional<SteadyTime> oldest = queue_.oldest_received_at();
  return oldest.has_value() ? MicrosecondsSince(*oldest) : 0;
}

std::optional<LagChange> Session::UpdatePace(int64_t sensor_time_us) {
  const std::optional<bool> change = pace_.Update(clocks_.steady(), queue_.oldest_received_at(), sensor_time_us);
  if (!change.has_value()) return std::nullopt;
  const LagChange lag{*change, QueueAgeUs()};
  if (gate_.is_attached() && !gate_.has_ended()) report_.AddLagChange(lag);
  if (lag.is_behind) metrics_->falls_behind.Add();
  return lag;
}

void Session::NotifyListeners(const std::shared_ptr<SessionListener>& stream_listener) {
  // Listeners hold their own locks, for which threads of gRPC wait: a turn must not be paused there.
  const ScopedWithoutYielder without_pauses;
  if (stream_listener != nullptr) stream_listener->OnSessionChanged();
  watchers_->Notify();
}

absl::StatusOr<Attachment> Session::Attach(absl::string_view resume_token, uint64_t last_pose_seq,
                                           std::weak_ptr<SessionListener> listener, const StreamOrigin& origin,
                                           uint64_t first_seq) {
  EVPOSE_ASSIGN_OR_RETURN(std::string new_token, RandomHex128());
  std::string digest = TokenDigest(resume_token);
  std::shared_ptr<SessionListener> fenced;
  Attachment attachment;
  bool is_taken_over = false;
  absl::Status rolled_back;
  {
    const std::lock_guard lock(mutex_);
    rolled_back = gate_.CheckFirstSeq(digest, first_seq);
    if (!rolled_back.ok()) gate_.RecordLoss();
  }
  if (!rolled_back.ok()) {
    log_->RolledBack(origin, rolled_back, Sums());
    CommitLifecycle();  // for the readers at other servers
    committer_->Finish();
    Close(rolled_back);
    return rolled_back;
  }
  {
    const std::lock_guard lock(mutex_);
    EVPOSE_RETURN_IF_ERROR(gate_.CheckAttach(digest, last_pose_seq, report_.poses()));
    if (gate_.stream() > 0) {
      report_.AddReattach();
      metrics_->reattaches.Add();
    }
    is_taken_over = gate_.is_attached();
    const uint64_t sent_pose_seq = std::max(report_.LastValidPose(last_pose_seq), pose_log_.first_pose_seq() - 1);
    const uint64_t stream = gate_.Attach(std::move(new_token), std::move(digest), queue_.bytes(), sent_pose_seq);
    report_.StartNotices(sent_pose_seq);
    fenced = stream_listener_.lock();
    stream_listener_ = std::move(listener);
    attachment = {stream, gate_.next_seq(), gate_.resume_token(), gate_.SendLimit(), sent_pose_seq + 1};
    Schedule();
  }
  log_->Attached(origin, attachment.stream, attachment.next_seq, is_taken_over);
  if (fenced != nullptr) fenced->OnSessionChanged();
  CommitLifecycle();
  return attachment;
}

void Session::Detach(uint64_t stream) {
  {
    const std::lock_guard lock(mutex_);
    if (!gate_.Detach(stream, clocks_.wall())) return;
    stream_listener_.reset();
    report_.ClearNotices();
    Schedule();  // the session no longer waits for a reader
  }
  CommitLifecycle();
}

void Session::HalfClose(uint64_t stream) {
  const std::lock_guard lock(mutex_);
  gate_.HalfClose(stream);
  Schedule();
}

absl::Status Session::PushEvents(uint64_t stream, EventChunk chunk) {
  {
    const std::lock_guard lock(mutex_);
    EVPOSE_RETURN_IF_ERROR(gate_.CheckStream(stream));
  }
  // The check runs without the lock, because it reads every byte.
  EVPOSE_RETURN_IF_ERROR(CheckChunk(chunk, config_.encoding, limits_.max_chunk_bytes));
  const absl::Cleanup commit = [this] { CommitLifecycle(); };
  const std::lock_guard lock(mutex_);
  EVPOSE_RETURN_IF_ERROR(gate_.CheckPush(stream));
  EVPOSE_ASSIGN_OR_RETURN(const bool is_new, gate_.AcceptChunk(chunk.seq, chunk.payload.size()));
  if (!is_new) return absl::OkStatus();
  report_.AddReceived(chunk.payload.size());
  metrics_->received_bytes.Add(chunk.payload.size());
  Enqueue(stream, std::move(chunk));
  return absl::OkStatus();
}

absl::Status Session::PushResetPose(uint64_t stream, uint64_t seq, absl::string_view object_id,
                                    const RigidTransform& camera_from_object) {
  if (seq == 0) return InvalidField("reset_pose.seq", "is 0 or missing; resets are numbered along with the chunks");
  const absl::Cleanup commit = [this] { CommitLifecycle(); };
  const std::lock_guard lock(mutex_);
  EVPOSE_RETURN_IF_ERROR(gate_.CheckPush(stream));
  EVPOSE_ASSIGN_OR_RETURN(const bool is_new, gate_.IsNext(seq));
  if (!is_new) return absl::OkStatus();
  for (size_t i = 0; i < config_.objects.size(); ++i) {
    if (config_.objects[i].object_id != object_id) continue;
    gate_.Accept();
    Enqueue(stream, PoseReset{seq, static_cast<uint32_t>(i), camera_from_object});
    return absl::OkStatus();
  }
  return InvalidField("reset_pose.object_id", absl::StrCat("the session has no object \"", Shortened(object_id), "\""));
}

absl::Status Session::PushEnd(uint64_t stream) {
  const absl::Cleanup commit = [this] { CommitLifecycle(); };
  const std::lock_guard lock(mutex_);
  EVPOSE_RETURN_IF_ERROR(gate_.CheckPush(stream));
  if (gate_.AcceptEnd()) Enqueue(stream, EndOfInput{});
  return absl::OkStatus();
}

void Session::Enqueue(uint64_t stream, std::variant<EventChunk, PoseReset, EndOfInput> what) {
  queue_.Push({stream, clocks_.steady(), std::move(what)});
  Schedule();
}

SessionAck Session::MakeAck() const {
  return {report_.processed_seq(), checkpoints_.PersistedSeq(report_.processed_seq(), committer_->progress()),
          gate_.SendLimit(), report_.acked_pose_seq()};
}

StreamView Session::View(uint64_t stream) const {
  const std::lock_guard lock(mutex_);
  StreamView view;
  view.status = gate_.CheckStream(stream);
  // With kLatest the queue may hold twice the credit, because an overloaded session then drops events, which is fast.
  const uint64_t factor = config_.overload_policy == OverloadPolicy::kLatest ? 2 : 1;
  view.has_room = queue_.bytes() < factor * limits_.credit_bytes && queue_.num_items() < factor * kMaxQueuedItems;
  view.is_attached = gate_.state().writer == WriterState::kAttached;
  // Read before the poses that may be sent: when the end has been persisted, all of them may be.
  view.has_ended = checkpoints_.IsEndPersisted(gate_.has_ended(), committer_->progress());
  view.last_pose_seq = checkpoints_.LastPoseSeqToSend(report_.poses(), committer_->progress());
  view.is_idle = !queue_.has_items() && !queue_.is_working() && view.last_pose_seq == report_.poses();
  view.is_persisted = checkpoints_.IsFlushed(MakeCounters(), committer_->progress());
  view.ack = MakeAck();
  return view;
}

std::vector<SessionNotice> Session::TakeNotices(uint64_t stream) {
  const std::lock_guard lock(mutex_);
  if (stream != gate_.stream()) return {};
  std::vector<SessionNotice> notices = report_.TakeNotices();
  if (notices.size() >= kMaxUntakenNotices) Schedule();
  return notices;
}

void Session::ReportSent(uint64_t stream, uint64_t pose_seq) {
  const std::lock_guard lock(mutex_);
  if (stream != gate_.stream()) return;
  gate_.ReportSent(pose_seq);
  Schedule();
}

void Session::Close(const absl::Status& status) {
  std::shared_ptr<SessionListener> stream_listener;
  {
    const std::lock_guard lock(mutex_);
    if (!gate_.Close(status)) return;
    queue_.Clear();
    model_uses_.clear();
    stream_listener = stream_listener_.lock();
  }
  committer_->Close();
  AnswerTokenRequests();
  NotifyListeners(stream_listener);
  images_->Notify();
}

bool Session::IsRunnable() const {
  return gate_.closed().ok() && (checkpoints_.IsDue(MakeCounters(), committer_->progress()) || HasWork());
}

bool Session::HasWork() const {
  if (!queue_.is_working() && (!queue_.has_items() || checkpoints_.is_flushing())) return false;
  if (checkpoints_.MustWait(report_.poses(), committer_->progress())) return false;
  if (!gate_.is_attached()) return true;
  const bool may_make_poses =
      config_.overload_policy == OverloadPolicy::kLatest || report_.poses() <= gate_.sent_pose_seq() + kMaxUnsentPoses;
  return may_make_poses && report_.num_notices() < kMaxUntakenNotices;
}

Backlog Session::MakeBacklog() const {
  Backlog backlog;
  if (config_.overload_policy == OverloadPolicy::kBlock) return backlog;
  const auto ratio = [](uint64_t used, uint64_t allowed) {
    return static_cast<double>(used) / static_cast<double>(allowed);
  };
  backlog.age_ratio =
      static_cast<double>(QueueAgeUs()) / static_cast<double>(absl::ToInt64Microseconds(*config_.max_lag));
  backlog.bytes_ratio =
      std::max(ratio(queue_.bytes(), limits_.credit_bytes), ratio(queue_.num_items(), kMaxQueuedItems));
  if (gate_.is_attached() && report_.poses() > gate_.sent_pose_seq()) {
    backlog.reader_ratio = ratio(report_.poses() - gate_.sent_pose_seq(), kMaxUnsentPoses);
  }
  return backlog;
}

CheckpointPolicy::Counters Session::MakeCounters() const {
  return {.processed_seq = report_.processed_seq(),
          .has_ended = gate_.has_ended(),
          .poses = report_.poses(),
          .processing_us = report_.health().processing_us,
          .is_working = queue_.is_working(),
          .has_waiting = queue_.has_items(),
          .may_receive = gate_.may_receive()};
}

void Session::Schedule() {
  if (is_scheduled_ || !IsRunnable()) return;
  turns_->Post([self = shared_from_this()] { self->Run(); }, queue_.oldest_received_at().value_or(clocks_.steady()),
               arrivals_.arrival());
  is_scheduled_ = true;
}

void Session::Run() {
  const absl::Status status = OrOutOfMemory([this] {
    if (WriteDueCheckpoint()) return absl::OkStatus();
    if (const std::optional<Backlog> backlog = StartWork()) Publish(worker_.Work(*backlog));
    return absl::OkStatus();
  });
  if (!status.ok()) EndOutOfMemory(status);
}

// The session cannot go on, because its tracker may have processed a part of a window. It stays as scheduled, so that
// it does not run again.
void Session::EndOutOfMemory(const absl::Status& status) {
  worker_.ReleasePipeline();  // first: the rest needs memory
  Close(status);
  log_->OutOfMemory();
}

std::optional<Backlog> Session::StartWork() {
  const std::lock_guard lock(mutex_);
  if (!IsRunnable()) {
    is_scheduled_ = false;
    return std::nullopt;
  }
  if (!queue_.is_working()) worker_.Start(queue_.StartNext());
  return worker_.is_events() ? MakeBacklog() : Backlog();
}

// Poses that wait for the store stay in memory, and with kBlock those that wait for their reader: one slice may produce
// more poses than the log holds.
uint64_t Session::FirstPoseSeqToKeep() const {
  const uint64_t first = checkpoints_.FirstPoseSeqToKeep();
  if (!gate_.is_attached() || config_.overload_policy != OverloadPolicy::kBlock) return first;
  return std::min(first, gate_.sent_pose_seq() + 1);
}

void Session::Publish(const WorkResult& result) {
  std::shared_ptr<SessionListener> stream_listener;
  std::unique_ptr<SessionPipeline> ended_pipeline;  // destroyed without the lock: that frees much memory
  std::optional<LagChange> lag;
  const bool has_ended = result.finished.has_value() && result.finished->is_end;
  {
    const std::lock_guard lock(mutex_);
    pose_log_.Append(result.poses, FirstPoseSeqToKeep());  // under the lock: a stream that attaches now reads them
    report_.Add(result, gate_.is_attached(), *metrics_);
    if (has_ended) ended_pipeline = worker_.ReleasePipeline();
    if (result.finished.has_value()) {
      const SteadyTime received_at = *queue_.oldest_received_at();
      queue_.FinishCurrent();
      arrivals_.Update(received_at, result.sensor_time_us, !queue_.has_items());
      gate_.OnProcessed(result.finished->stream, result.finished->bytes);
      if (has_ended) gate_.OnEndProcessed();
    }
    lag = UpdatePace(result.sensor_time_us);
    is_scheduled_ = false;
    Schedule();
    stream_listener = stream_listener_.lock();
  }
  if (lag.has_value()) log_->PaceChanged(lag->is_behind, lag->lag_us);
  if (has_ended) log_->Ended(Sums());
  NotifyListeners(stream_listener);
  if (has_ended) images_->Notify();
}

}  // namespace evpose::server
