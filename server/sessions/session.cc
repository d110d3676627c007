// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session.h"

#include <algorithm>
#include <mutex>
#include <utility>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/str_cat.h"
#include "absl/types/span.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"
#include "server/runtime/errors.h"
#include "server/runtime/random_name.h"

namespace evpose::server {
namespace {

// What the strand does at a time, before other sessions have their turn and readers their poses: at most about 6 MB
// of decoded events, whatever the encoding.
constexpr size_t kSliceBytes = 16 * 1024;
// Empty chunks and resets cost no credit; they are bounded by number.
constexpr size_t kMaxQueuedItems = 4096;
constexpr size_t kMaxUntakenNotices = 1024;

absl::Span<const uint8_t> AsBytes(const std::string& text) {
  return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
}

}  // namespace

uint64_t Session::Item::bytes() const {
  const auto* chunk = std::get_if<EventChunk>(&what);
  return chunk == nullptr ? 0 : chunk->payload.size();
}

uint64_t Session::Item::seq() const {
  if (const auto* chunk = std::get_if<EventChunk>(&what)) return chunk->seq;
  if (const auto* reset = std::get_if<PoseReset>(&what)) return reset->seq;
  return 0;
}

Session::Session(Parts parts, WorkerPool& pool)
    : name_(std::move(parts.name)),
      log_(std::make_shared<SessionLog>(name_, std::move(parts.tenant))),
      config_(std::move(parts.config)),
      limits_(parts.limits),
      committer_(std::make_shared<SessionCommitter>(log_, std::move(parts.lease), DurableAtBeginning(parts.beginning),
                                                    pool, limits_.backoff, parts.metrics)),
      pose_log_(limits_.pose_log_capacity, FirstPoseSeq(parts.beginning)),
      now_(std::move(parts.now)),
      steady_now_(std::move(parts.steady_now)),
      metrics_(std::move(parts.metrics)),
      watchers_(std::make_shared<Watchers>(pool)),
      create_time_(parts.create_time),
      strand_(pool.MakeStrand()),
      pipeline_(std::move(parts.pipeline)),
      overload_(config_),
      explained_ratios_(config_.objects.size(), 0.0f),
      model_uses_(std::move(parts.model_uses)),
      resume_token_(std::move(parts.resume_token)) {
  ObservePipeline();
  const std::lock_guard lock(mutex_);
  pose_log_.Append(parts.beginning.poses);
  health_.objects.resize(config_.objects.size());
  for (size_t i = 0; i < health_.objects.size() && pipeline_ != nullptr; ++i) {
    health_.objects[i].state = pipeline_->tracker().state(i);
    health_.objects[i].initialization = pipeline_->tracker().initialization(i);
  }
  TakeUp(std::move(parts.beginning));
}

// The last to let go may be a thread of gRPC, whose counting of references tools cannot see: the lock shows that the
// others are done.
Session::~Session() { const std::lock_guard lock(mutex_); }

std::string Session::resume_token() const {
  const std::lock_guard lock(mutex_);
  return resume_token_;
}

std::optional<absl::Time> Session::expire_time() const {
  const std::lock_guard lock(mutex_);
  if (is_attached_) return std::nullopt;
  return detached_at_ + limits_.expiry;
}

WatchView Session::Watch() const {
  const std::lock_guard lock(mutex_);
  return {closed_, ended_, health_.poses};
}

SessionSnapshot Session::Snapshot() const {
  const std::lock_guard lock(mutex_);
  SessionSnapshot snapshot;
  snapshot.closed = closed_;
  snapshot.state = ended_ ? SessionState::kEnded : is_attached_ ? SessionState::kAttached : SessionState::kDetached;
  if (!is_attached_) snapshot.expire_time = detached_at_ + limits_.expiry;
  snapshot.health = health_;
  snapshot.health.latency_p50_us = latencies_.Percentile(0.5);
  snapshot.health.latency_p99_us = latencies_.Percentile(0.99);
  snapshot.health.queue_age_us = QueueAge_us();
  return snapshot;
}

void Session::NotifyListeners(const std::shared_ptr<SessionListener>& stream_listener) {
  if (stream_listener != nullptr) stream_listener->OnSessionChanged();
  watchers_->Notify();
}

int64_t Session::MicrosecondsSince(SteadyTime begin) const {
  return std::chrono::duration_cast<std::chrono::microseconds>(steady_now_() - begin).count();
}

absl::StatusOr<Attachment> Session::Attach(absl::string_view resume_token, uint64_t last_pose_seq,
                                           std::weak_ptr<SessionListener> listener, const std::string& peer) {
  EVPOSE_ASSIGN_OR_RETURN(std::string new_token, RandomHex128());
  std::string digest = TokenDigest(resume_token);
  std::shared_ptr<SessionListener> fenced;
  Attachment attachment;
  bool is_taken_over = false;
  {
    const std::lock_guard lock(mutex_);
    EVPOSE_RETURN_IF_ERROR(closed_);
    if (!IsDigestGood(digest, MakeLifecycle())) {
      return WithReason(absl::PermissionDeniedError(absl::StrCat("the resume token is not that of ", name_,
                                                                 "; each attach gives a new one: use the latest")),
                        v1::WRONG_TOKEN);
    }
    if (last_pose_seq > std::max(health_.poses, maybe_seen_pose_seq_)) {
      return InvalidField("attach.last_pose_seq",
                          absl::StrCat("is ", last_pose_seq, ", but the session has made ", health_.poses, " poses"));
    }
    if (stream_ > 0) {
      ++health_.reattaches;
      metrics_->reattaches.Add();
    }
    ReplaceToken(std::move(new_token), std::move(digest));
    attach_lifecycle_ = lifecycle_number_;
    ++stream_;
    is_taken_over = std::exchange(is_attached_, true);
    consumed_bytes_ = 0;
    received_bytes_ = 0;
    foreign_bytes_ = queued_bytes_;
    sent_pose_seq_ = std::max(last_pose_seq, pose_log_.first_pose_seq() - 1);
    notices_.clear();
    if (restarted_.has_value()) notices_.push_back({sent_pose_seq_, *restarted_});
    fenced = stream_listener_.lock();
    stream_listener_ = std::move(listener);
    attachment = {stream_, next_seq_, resume_token_, SendLimit(), sent_pose_seq_ + 1};
    Schedule();
  }
  log_->Attached(peer, attachment.stream, attachment.next_seq, is_taken_over);
  if (fenced != nullptr) fenced->OnSessionChanged();
  CommitLifecycle();
  return attachment;
}

void Session::Detach(uint64_t stream) {
  {
    const std::lock_guard lock(mutex_);
    if (stream != stream_ || !is_attached_) return;
    is_attached_ = false;
    detached_at_ = now_();
    ++lifecycle_number_;
    stream_listener_.reset();
    notices_.clear();
    Schedule();  // nobody's reading is waited for any more
  }
  CommitLifecycle();
}

absl::Status Session::CheckStream(uint64_t stream) const {
  EVPOSE_RETURN_IF_ERROR(closed_);
  if (stream == stream_) return absl::OkStatus();
  return WithReason(absl::AbortedError(absl::StrCat("another stream has attached to ", name_)), v1::FENCED);
}

absl::Status Session::CheckPush(uint64_t stream) {
  EVPOSE_RETURN_IF_ERROR(CheckStream(stream));
  if (!previous_token_digest_.empty()) {  // whoever sends this has read the new one
    previous_token_digest_.clear();
    ++lifecycle_number_;
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> Session::IsNext(uint64_t seq) const {
  if (seq < next_seq_) return false;
  if (end_pushed_) {
    return WithReason(absl::FailedPreconditionError(absl::StrCat(name_, " has ended: nothing may follow")),
                      v1::SESSION_ENDED);
  }
  if (seq == next_seq_) return true;
  return WithReason(absl::FailedPreconditionError(absl::StrCat(seq, " came where ", next_seq_, " was expected")),
                    v1::SEQ_GAP, {{"expected_seq", absl::StrCat(next_seq_)}, {"seq", absl::StrCat(seq)}});
}

absl::Status Session::CheckPayload(const EventChunk& chunk) const {
  if (chunk.seq == 0) return InvalidField("events.seq", "is 0 or missing; chunks are numbered from 1");
  if (chunk.payload.size() > limits_.max_chunk_bytes) {
    return InvalidField("events.payload", absl::StrCat("has ", chunk.payload.size(), " bytes; at most ",
                                                       limits_.max_chunk_bytes, " go into one chunk"));
  }
  const int word = WordBytes(config_.encoding);
  if (chunk.payload.size() % static_cast<size_t>(word) != 0) {
    return InvalidField("events.payload",
                        absl::StrCat("has ", chunk.payload.size(), " bytes, which is not whole ",
                                     std::string(EncodingName(config_.encoding)), " words of ", word, " bytes"));
  }
  if (chunk.crc32c.has_value() && *chunk.crc32c != Crc32c(AsBytes(chunk.payload))) {
    return WithReason(absl::DataLossError(absl::StrCat("chunk ", chunk.seq,
                                                       ": the payload does not match its crc32c; attach again and send "
                                                       "it again")),
                      v1::CRC_MISMATCH, {{"seq", absl::StrCat(chunk.seq)}});
  }
  return absl::OkStatus();
}

absl::Status Session::PushEvents(uint64_t stream, EventChunk chunk) {
  {
    const std::lock_guard lock(mutex_);
    EVPOSE_RETURN_IF_ERROR(CheckStream(stream));
  }
  EVPOSE_RETURN_IF_ERROR(CheckPayload(chunk));  // without the lock: it reads every byte
  const absl::Cleanup commit = [this] { CommitLifecycle(); };
  const std::lock_guard lock(mutex_);
  EVPOSE_RETURN_IF_ERROR(CheckPush(stream));
  EVPOSE_ASSIGN_OR_RETURN(const bool is_next, IsNext(chunk.seq));
  received_bytes_ += chunk.payload.size();
  if (!is_next) {
    consumed_bytes_ += chunk.payload.size();
    return absl::OkStatus();
  }
  ++next_seq_;
  health_.received_bytes += chunk.payload.size();
  metrics_->received_bytes.Add(chunk.payload.size());
  Enqueue(stream, std::move(chunk));
  return absl::OkStatus();
}

absl::Status Session::PushResetPose(uint64_t stream, uint64_t seq, absl::string_view object_id,
                                    const RigidTransform& camera_from_object) {
  if (seq == 0) return InvalidField("reset_pose.seq", "is 0 or missing; resets are numbered along with the chunks");
  const absl::Cleanup commit = [this] { CommitLifecycle(); };
  const std::lock_guard lock(mutex_);
  EVPOSE_RETURN_IF_ERROR(CheckPush(stream));
  EVPOSE_ASSIGN_OR_RETURN(const bool is_next, IsNext(seq));
  if (!is_next) return absl::OkStatus();
  for (size_t i = 0; i < config_.objects.size(); ++i) {
    if (config_.objects[i].object_id != object_id) continue;
    ++next_seq_;
    Enqueue(stream, PoseReset{seq, static_cast<uint32_t>(i), camera_from_object});
    return absl::OkStatus();
  }
  return InvalidField("reset_pose.object_id", absl::StrCat("the session has no object \"", object_id, "\""));
}

absl::Status Session::PushEnd(uint64_t stream) {
  const absl::Cleanup commit = [this] { CommitLifecycle(); };
  const std::lock_guard lock(mutex_);
  EVPOSE_RETURN_IF_ERROR(CheckPush(stream));
  if (end_pushed_) return absl::OkStatus();
  end_pushed_ = true;
  Enqueue(stream, End{});
  return absl::OkStatus();
}

void Session::Enqueue(uint64_t stream, std::variant<EventChunk, PoseReset, End> what) {
  queue_.push_back({stream, steady_now_(), std::move(what)});
  queued_bytes_ += queue_.back().bytes();
  Schedule();
}

uint64_t Session::SendLimit() const {
  // A camera does not wait. What has arrived is off the network, and View() bounds it.
  if (config_.overload_policy == OverloadPolicy::kLatest) return received_bytes_ + limits_.credit_bytes;
  return consumed_bytes_ + limits_.credit_bytes - std::min(foreign_bytes_, limits_.credit_bytes);
}

SessionAck Session::MakeAck() const { return {processed_seq_, DurableSeq(), SendLimit(), acked_pose_seq_}; }

StreamView Session::View(uint64_t stream) const {
  const std::lock_guard lock(mutex_);
  StreamView view;
  view.status = CheckStream(stream);
  // With kLatest too much is skipped, which is fast: until that has happened, as much again may come.
  const uint64_t times = config_.overload_policy == OverloadPolicy::kLatest ? 2 : 1;
  view.has_room = queued_bytes_ < times * limits_.credit_bytes && queue_.size() < times * kMaxQueuedItems;
  view.attached = committer_->progress().lifecycle >= attach_lifecycle_;
  view.ended = IsEndDurable();  // before what may be sent: then that is all
  view.last_pose_seq = LastPoseSeqToSend();
  view.is_idle = queue_.empty() && !in_work_since_.has_value() && view.last_pose_seq == health_.poses;
  view.ack = MakeAck();
  return view;
}

std::vector<SessionNotice> Session::TakeNotices(uint64_t stream) {
  const std::lock_guard lock(mutex_);
  if (stream != stream_) return {};
  std::vector<SessionNotice> notices = std::exchange(notices_, {});
  restarted_.reset();
  if (notices.size() >= kMaxUntakenNotices) Schedule();
  return notices;
}

void Session::ReportSent(uint64_t stream, uint64_t pose_seq) {
  const std::lock_guard lock(mutex_);
  if (stream != stream_) return;
  sent_pose_seq_ = pose_seq;
  Schedule();
}

void Session::Close(const absl::Status& status) {
  std::shared_ptr<SessionListener> stream_listener;
  {
    const std::lock_guard lock(mutex_);
    if (!closed_.ok()) return;
    closed_ = status;
    queue_.clear();
    model_uses_.clear();
    is_attached_ = false;
    stream_listener = stream_listener_.lock();
  }
  committer_->Close();
  AnswerTokenRequests();
  NotifyListeners(stream_listener);
}

bool Session::IsRunnable() const { return closed_.ok() && (IsCheckpointDue() || HasWork()); }

bool Session::HasWork() const {
  if (!in_work_since_.has_value() && (queue_.empty() || is_settling_)) return false;
  if (MustWaitForStore()) return false;
  if (!is_attached_) return true;
  const bool may_make_poses =
      config_.overload_policy == OverloadPolicy::kLatest || health_.poses <= sent_pose_seq_ + kMaxUnsentPoses;
  return may_make_poses && notices_.size() < kMaxUntakenNotices;
}

Backlog Session::MakeBacklog() const {
  Backlog backlog;
  if (config_.overload_policy == OverloadPolicy::kBlock) return backlog;
  const auto share = [](uint64_t used, uint64_t allowed) {
    return static_cast<double>(used) / static_cast<double>(allowed);
  };
  backlog.age_ratio = static_cast<double>(MicrosecondsSince(*in_work_since_)) /
                      static_cast<double>(absl::ToInt64Microseconds(*config_.max_lag));
  backlog.bytes_ratio = std::max(share(queued_bytes_, limits_.credit_bytes), share(queue_.size(), kMaxQueuedItems));
  if (is_attached_ && health_.poses > sent_pose_seq_) {
    backlog.reader_ratio = share(health_.poses - sent_pose_seq_, kMaxUnsentPoses);
  }
  return backlog;
}

void Session::Schedule() {
  if (is_scheduled_ || !IsRunnable()) return;
  is_scheduled_ = true;
  boost::asio::post(strand_, [self = shared_from_this()] { self->Run(); });
}

void Session::Run() {
  if (WriteDueCheckpoint() || !TakeItem()) return;
  const SteadyTime begin = steady_now_();
  output_.clear();
  const bool item_is_done = WorkOnItem();
  const auto duration = steady_now_() - begin;
  processing_time_ += duration;
  metrics_->processing_ns.Add(static_cast<uint64_t>(std::chrono::nanoseconds(duration).count()));
  Publish(item_is_done);
}

bool Session::TakeItem() {
  const std::lock_guard lock(mutex_);
  if (!IsRunnable()) {
    is_scheduled_ = false;
    return false;
  }
  if (!in_work_since_.has_value()) {
    item_ = std::move(queue_.front());
    queue_.pop_front();
    in_work_since_ = item_->received_at;
    item_offset_ = 0;
  }
  must_skip_ = std::holds_alternative<EventChunk>(item_->what) && overload_.MustSkip(MakeBacklog());
  return true;
}

bool Session::WorkOnItem() {
  if (const auto* chunk = std::get_if<EventChunk>(&item_->what)) return WorkOnEvents(*chunk);
  if (const auto* reset = std::get_if<PoseReset>(&item_->what)) {
    pipeline_->ResetPose(reset->object_index, reset->camera_from_object);
  } else {
    dropped_ = overload_.EndStretch();
    pipeline_->Finish(output_);
  }
  return true;
}

bool Session::WorkOnEvents(const EventChunk& chunk) {
  if (item_offset_ == 0) {
    counts_before_item_ = pipeline_->counts();
    if (chunk.discontinuity) pipeline_->ResetAfterLoss();
  }
  const absl::Span<const uint8_t> slice = AsBytes(chunk.payload).subspan(item_offset_, kSliceBytes);
  SkipOrTrack(slice);
  item_offset_ += slice.size();
  return item_offset_ == chunk.payload.size();
}

void Session::SkipOrTrack(absl::Span<const uint8_t> slice) {
  if (!must_skip_) {
    dropped_ = overload_.EndStretch();
    pipeline_->Process(slice, output_);
    return;
  }
  skipped_ = pipeline_->Skip(slice, output_);
  overload_.AddSkipped(skipped_);
  metrics_->skipped_events[overload_.reason()].Add(skipped_.num_events);
}

std::vector<StoredPose> Session::NumberPoses() {
  const int64_t latency_us = MicrosecondsSince(item_->received_at);
  std::vector<StoredPose> poses;
  poses.reserve(output_.poses.size());
  for (const PoseEstimate& estimate : output_.poses) {
    explained_ratios_[estimate.object_index] = estimate.explained_ratio;
    poses.push_back({next_pose_seq_++, estimate.object_index, estimate, latency_us});
  }
  return poses;
}

std::optional<DecodeFault> Session::FindDecodeFault() const {
  const auto* chunk = std::get_if<EventChunk>(&item_->what);
  if (chunk == nullptr) return std::nullopt;
  const DecodeCounts& now = pipeline_->counts();
  const uint64_t unknown = now.unknown_words - counts_before_item_.unknown_words;
  const uint64_t broken = now.broken_vectors - counts_before_item_.broken_vectors;
  const uint64_t outside = now.dropped_outside_sensor - counts_before_item_.dropped_outside_sensor;
  if (unknown + broken + outside == 0) return std::nullopt;
  return DecodeFault{chunk->seq, unknown + broken + outside,
                     absl::StrCat("skipped ", unknown, " unknown words, ", broken, " broken vectors, ", outside,
                                  " events outside the sensor")};
}

void Session::Publish(bool item_is_done) {
  const uint64_t first_pose_seq = next_pose_seq_;
  const std::vector<StoredPose> poses = NumberPoses();
  LogWork(item_is_done);
  std::shared_ptr<SessionListener> stream_listener;
  std::unique_ptr<SessionPipeline> ended_pipeline;  // its memory goes after the lock
  {
    const std::lock_guard lock(mutex_);
    pose_log_.Append(poses, FirstPoseSeqKept());  // under the lock: who attaches meanwhile is to have them, too
    CountWork(poses);
    for (const StoredPose& pose : poses) latencies_.Add(pose.latency_us);
    health_.poses = next_pose_seq_ - 1;
    health_.counts = pipeline_->counts();
    health_.t_us = std::max<int64_t>(pipeline_->now_us(), 0);
    health_.sensor_time_us = pipeline_->sensor_time_us();
    health_.processing_us = std::chrono::duration_cast<std::chrono::microseconds>(processing_time_).count();
    for (size_t i = 0; i < health_.objects.size(); ++i) {
      const Tracker& tracker = pipeline_->tracker();
      health_.objects[i] = {tracker.state(i), losses_before_[i] + tracker.losses(i), explained_ratios_[i],
                            tracker.initialization(i)};
    }
    health_.skipped_events += skipped_.num_events;
    health_.skipped_us += std::exchange(skipped_, EventGap()).duration_us();
    const auto dropped = std::exchange(dropped_, std::nullopt);
    if (is_attached_) {
      if (dropped.has_value()) notices_.push_back({first_pose_seq - 1, *dropped});
      for (const ObjectStateChange& change : output_.state_changes) {
        notices_.push_back({first_pose_seq - 1 + change.num_poses_before,
                            StateChange{change.object_index, change.t_us, change.state}});
      }
    }
    if (item_is_done) {
      if (const auto fault = FindDecodeFault(); fault.has_value() && is_attached_) {
        notices_.push_back({health_.poses, *fault});
      }
      const uint64_t bytes = item_->bytes();
      queued_bytes_ -= bytes;
      (item_->stream == stream_ ? consumed_bytes_ += bytes : foreign_bytes_ -= bytes);
      health_.processed_bytes += bytes;
      processed_seq_ = std::max(processed_seq_, item_->seq());
      if (std::holds_alternative<End>(item_->what)) {
        ended_ = true;
        ended_pipeline = std::move(pipeline_);
      }
      acked_pose_seq_ = health_.poses;
      in_work_since_.reset();
    }
    is_scheduled_ = false;
    Schedule();
    stream_listener = stream_listener_.lock();
  }
  NotifyListeners(stream_listener);
}

}  // namespace evpose::server
