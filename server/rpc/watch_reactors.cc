// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/watch_reactors.h"

#include <grpcpp/alarm.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/rpc/authentication.h"
#include "server/rpc/conversion.h"
#include "server/rpc/status_mapping.h"
#include "server/rpc/stream_registry.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"
#include "server/sessions/session.h"

namespace evpose::server {
namespace {

// Maximum number of poses in a response: about 40 KB, which bounds the memory of a stalled reader.
constexpr size_t kPosesPerResponse = 64;
constexpr absl::Duration kDefaultPeriod = absl::Seconds(1);
constexpr absl::Duration kMinPeriod = absl::Milliseconds(10);
constexpr absl::Duration kLongestPeriod = absl::Hours(24 * 365);  // so that the sum with the present time is in range

// The common part of both readers. As in the Track reactor, every callback changes the state and then calls Pump(),
// which starts the next operation.
template <typename Response>
class WatchReactor : public grpc::ServerWriteReactor<Response>,
                     public SessionListener,
                     public OpenStream,
                     public std::enable_shared_from_this<WatchReactor<Response>> {
 public:
  WatchReactor(const ServiceContext& services, grpc::CallbackServerContext* context)
      : services_(services),
        context_(context),
        access_version_(services.authenticator.version()),
        caller_(Authenticate(services.authenticator, *context)) {}

  const absl::StatusOr<Caller>& caller() const { return caller_; }

  // `begun` is the result of checking the request.
  void Start(const absl::Status& begun) {
    self_ = this->shared_from_this();
    services_.streams.Add(StreamRegistry::Kind::kWatch, self_);
    if (missing_.has_value()) {
      return services_.pool.slow().Post(
          missing_->tenant,
          [self = this->shared_from_this()](const absl::Status& admitted) { self->LookInStore(admitted); });
    }
    Watch(begun);
  }

  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    is_writing_ = false;
    response_ = Response();  // releases the memory of the poses, which Clear() would keep
    if (!ok) Fail(absl::CancelledError("the client has disconnected"));
    Pump();
  }

  void OnCancel() override {
    const std::lock_guard lock(mutex_);
    Fail(absl::CancelledError("the client cancelled"));
    Pump();
  }

  void OnDone() override {
    services_.streams.Remove(this);
    const std::shared_ptr<WatchReactor> last = std::move(self_);
  }

  void OnSessionChanged() override {
    const std::lock_guard lock(mutex_);
    Pump();
  }

  void GoAway(absl::Duration) override {}

  void End(const absl::Status& status) override {
    const std::lock_guard lock(mutex_);
    Fail(status);
    Pump();
    if (!is_finished_) context_->TryCancel();
  }

  void CheckAccess(const AccessCheck& check) override {
    const std::lock_guard lock(mutex_);
    if (is_finished_) return;
    const absl::Status access = StillAdmitted(services_.authenticator, *context_, caller_, check, access_version_);
    if (access.ok()) return;
    // As in TrackReactor: a write in flight has until the next check to be done.
    if (!failure_.ok()) return context_->TryCancel();
    Fail(access);
    Pump();
  }

 protected:
  absl::Status FindSession(const Caller& caller, const std::string& name) {
    EVPOSE_RETURN_IF_ERROR(services_.sessions.CheckNotDraining());
    EVPOSE_ASSIGN_OR_RETURN(stream_place_, services_.quotas.AddStream(caller.tenant));
    EVPOSE_ASSIGN_OR_RETURN(place_, services_.quotas.AddWatcher(caller.tenant));
    auto session = services_.sessions.Get(caller.tenant, name);
    if (!session.ok()) {
      missing_ = {caller.tenant, name};
      return session.status();
    }
    session_ = *std::move(session);
    return absl::OkStatus();
  }

  const WatchedSession& session() const { return *session_; }
  TenantQuotas& quotas() const { return services_.quotas; }
  // Called when the session has been found, before the first PickResponse().
  virtual void OnFound() {}
  void Fail(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { failure_.Update(status); }

  // Fills `response` and returns true if there is something to send. Sets `is_last` if nothing will follow.
  virtual bool PickResponse(const WatchView& view, Response& response, bool& is_last)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) = 0;
  virtual void OnFinish() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {}

  void Pump() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (is_finished_ || is_writing_) return;
    const WatchView view = failure_.ok() ? session_->Watch() : WatchView();
    Fail(view.status);
    if (!failure_.ok()) return Finish(failure_);
    response_.Clear();
    bool is_last = false, has_response = false;
    // Poses that were taken for a response may be lost with it, so the stream ends.
    Fail(OrOutOfMemory([&] {
      has_response = PickResponse(view, response_, is_last);
      return absl::OkStatus();
    }));
    if (has_response) {
      is_writing_ = true;
      this->StartWrite(&response_);
    } else if (!failure_.ok() || is_last) {
      Finish(failure_);
    }
  }

  mutable std::mutex mutex_;

 private:
  struct Missing {
    std::string tenant;
    std::string name;
  };

  // Runs on the pool's threads for slow work, because reading the store takes too long for gRPC's threads.
  void LookInStore(absl::Status admitted) {
    {
      const std::lock_guard lock(mutex_);
      admitted.Update(failure_);  // the call may have been cancelled meanwhile
    }
    if (!admitted.ok()) return Watch(admitted);
    auto mirror = OrOutOfMemory([this] { return services_.sessions.Mirror(missing_->tenant, missing_->name); });
    const absl::Status found = mirror.status();
    if (mirror.ok()) session_ = *std::move(mirror);
    Watch(found);
  }

  void Watch(const absl::Status& found) {
    if (found.ok()) {
      OnFound();
      session_->AddWatcher(this->weak_from_this());
    }
    const std::lock_guard lock(mutex_);
    Fail(found);
    Pump();
  }

  void Finish(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    is_finished_ = true;
    services_.metrics.stream_ends[StreamKind::kWatch][status.code()].Add();
    OnFinish();
    grpc::ServerWriteReactor<Response>::Finish(ToGrpcStatus(status));
  }

  const ServiceContext services_;
  grpc::CallbackServerContext* const context_;
  uint64_t access_version_;  // used by CheckAccess() only, with the lock
  const absl::StatusOr<Caller> caller_;
  std::shared_ptr<WatchReactor> self_;        // until OnDone
  std::shared_ptr<WatchedSession> session_;   // null until it is found
  std::optional<Missing> missing_;            // the requested session, if it is not loaded at this server
  std::shared_ptr<const void> stream_place_;  // in the quota of streams
  std::shared_ptr<const void> place_;         // in the quota of watchers
  Response response_ ABSL_GUARDED_BY(mutex_);
  bool is_writing_ ABSL_GUARDED_BY(mutex_) = false;
  bool is_finished_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status failure_ ABSL_GUARDED_BY(mutex_);
};

// Reads the session's log at the pace of the client, so that a slow reader needs the memory of one response and no
// queue.
class WatchPosesReactor : public WatchReactor<v1::WatchPosesResponse> {
 public:
  using WatchReactor::WatchReactor;

  absl::Status Begin(const Caller& caller, const v1::WatchPosesRequest& request) {
    if (request.has_max_rate_hz()) {
      const double rate_hz = request.max_rate_hz();
      if (!(rate_hz > 0.0) || !std::isfinite(rate_hz)) {
        return InvalidField("max_rate_hz", absl::StrCat("is ", rate_hz, "; it must be positive"));
      }
      min_interval_us_ = 1e6 / rate_hz;
    }
    cursor_ = request.after_pose_seq();
    return FindSession(caller, request.session());
  }

 private:
  void OnFound() override {
    live_from_ = session().Watch().last_pose_seq;
    last_t_us_.assign(session().config().objects.size(), std::numeric_limits<int64_t>::min());
  }

  bool PickResponse(const WatchView& view, v1::WatchPosesResponse& response, bool& is_last) override
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (std::exchange(is_first_, false) && cursor_ > view.last_pose_seq) {
      response.set_continues_after_pose_seq(view.last_pose_seq);
      return true;
    }
    while (cursor_ < view.last_pose_seq && response.poses().empty()) {
      uint64_t skipped = 0;
      if (cursor_ >= live_from_ && view.last_pose_seq - cursor_ > session().max_poses_behind()) {
        skipped = view.last_pose_seq - session().max_poses_behind() - cursor_;
        cursor_ += skipped;
      }
      const auto page = session().ReadPoses(cursor_, kPosesPerResponse);
      if (page.empty()) return false;
      skipped += page.front().pose_seq - cursor_ - 1;
      response.set_num_skipped(response.num_skipped() + skipped);
      cursor_ = page.back().pose_seq;
      for (const StoredPose& pose : page) {
        if (IsDue(pose)) *response.add_poses() = ToProto(pose, session().config());
      }
    }
    is_last = view.ended && cursor_ >= view.last_pose_seq;
    return !response.poses().empty() || response.num_skipped() > 0;
  }

  bool IsDue(const StoredPose& pose) {
    int64_t& last_t_us = last_t_us_[pose.object_index];
    const int64_t t_us = pose.estimate.t_us;
    if (last_t_us != std::numeric_limits<int64_t>::min() && static_cast<double>(t_us - last_t_us) < min_interval_us_) {
      return false;
    }
    last_t_us = t_us;
    return true;
  }

  double min_interval_us_ = 0.0;
  uint64_t cursor_ = 0;     // number of the last pose that was sent or omitted
  uint64_t live_from_ = 0;  // number of the last pose that existed when the reader started
  bool is_first_ = true;    // no response has been picked
  std::vector<int64_t> last_t_us_;
};

class WatchHealthReactor : public WatchReactor<v1::WatchHealthResponse> {
 public:
  using WatchReactor::WatchReactor;

  absl::Status Begin(const Caller& caller, const v1::WatchHealthRequest& request) {
    if (request.has_period()) {
      period_ = FromProto(request.period());
      if (period_ < kMinPeriod) {
        return InvalidField("period", absl::StrCat("is ", absl::FormatDuration(period_), "; at least ",
                                                   absl::FormatDuration(kMinPeriod), " is required"));
      }
    }
    tenant_ = caller.tenant;
    health_place_ = quotas().AddHealthWatcher(tenant_);
    return FindSession(caller, request.session());
  }

 private:
  bool PickResponse(const WatchView& view, v1::WatchHealthResponse& response, bool& is_last) override
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    is_last = view.ended && final_was_sent_;
    if (is_last || !(is_due_ || view.ended)) return false;
    is_due_ = false;
    final_was_sent_ = view.ended;
    *response.mutable_health() = ToProto(session().health(), session().config());
    if (!view.ended) SetAlarm();
    return true;
  }

  void SetAlarm() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    // A new alarm each time, because the function of the previous one may still be running. A weak reference, because
    // an alarm holds its function until it is destroyed.
    alarm_ = std::make_unique<grpc::Alarm>();
    const absl::Duration period = quotas().HealthPeriod(tenant_, std::min(period_, kLongestPeriod));
    alarm_->Set(std::chrono::system_clock::now() + absl::ToChronoMicroseconds(period), [weak = weak_from_this()](bool) {
      if (const auto self = weak.lock()) static_cast<WatchHealthReactor*>(self.get())->OnAlarm();
    });
  }

  void OnAlarm() {
    const std::lock_guard lock(mutex_);
    is_due_ = true;
    Pump();
  }

  void OnFinish() override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { alarm_.reset(); }

  absl::Duration period_ = kDefaultPeriod;
  std::string tenant_;
  std::shared_ptr<const void> health_place_;  // among the watchers of health
  bool is_due_ ABSL_GUARDED_BY(mutex_) = true;
  bool final_was_sent_ ABSL_GUARDED_BY(mutex_) = false;
  std::unique_ptr<grpc::Alarm> alarm_ ABSL_GUARDED_BY(mutex_);
};

template <typename Reactor, typename Request>
Reactor* StartWatch(const ServiceContext& services, grpc::CallbackServerContext* context, const Request& request) {
  const auto reactor = std::make_shared<Reactor>(services, context);
  const absl::StatusOr<Caller>& caller = reactor->caller();
  reactor->Start(caller.ok() ? reactor->Begin(*caller, request) : caller.status());
  return reactor.get();
}

}  // namespace

grpc::ServerWriteReactor<v1::WatchPosesResponse>* StartWatchPoses(const ServiceContext& services,
                                                                  grpc::CallbackServerContext* context,
                                                                  const v1::WatchPosesRequest& request) {
  return StartWatch<WatchPosesReactor>(services, context, request);
}

grpc::ServerWriteReactor<v1::WatchHealthResponse>* StartWatchHealth(const ServiceContext& services,
                                                                    grpc::CallbackServerContext* context,
                                                                    const v1::WatchHealthRequest& request) {
  return StartWatch<WatchHealthReactor>(services, context, request);
}

}  // namespace evpose::server
