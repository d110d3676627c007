// SPDX-License-Identifier: Apache-2.0

// The common part of the reactors of the Watch methods.
#pragma once

#include <grpcpp/server_context.h>

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/status_macros.h"
#include "server/rpc/common/authentication.h"
#include "server/rpc/common/service_context.h"
#include "server/rpc/common/status_mapping.h"
#include "server/rpc/common/stream_registry.h"
#include "server/runtime/out_of_memory.h"
#include "server/sessions/session.h"

namespace evpose::server {

// As in the Track reactor, every callback changes the state and then calls Pump(), which starts the next operation.
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
    if (!missing_.has_value()) return Watch(begun);
    const absl::Status posted = services_.pool.slow().TryPost(
        missing_->tenant,
        [self = this->shared_from_this()](const absl::Status& admitted) { self->LookInStore(admitted); },
        cancellation_);
    if (!posted.ok()) Watch(posted);
  }

  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    is_writing_ = false;
    response_ = Response();  // releases the memory of the poses, which Clear() would keep
    if (!ok) Fail(absl::CancelledError("the client has disconnected"));
    Continue();
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
    // As in TrackReactor, a write in flight may take until the next check; then the call is cancelled.
    if (!failure_.ok()) return context_->TryCancel();
    Fail(access);
    Pump();
  }

 protected:
  absl::Status FindSession(const Caller& caller, const std::string& name) {
    EVPOSE_RETURN_IF_ERROR(services_.sessions.CheckNotDraining());
    EVPOSE_ASSIGN_OR_RETURN(stream_reservation_, services_.quotas.AddStream(caller.tenant));
    EVPOSE_ASSIGN_OR_RETURN(watcher_reservation_, services_.quotas.AddWatcher(caller.tenant));
    auto session = services_.sessions.Get(caller.tenant, name);
    if (!session.ok()) {
      missing_ = {caller.tenant, name};
      return session.status();
    }
    session_ = *std::move(session);
    return absl::OkStatus();
  }

  const WatchedSession& session() const { return *session_; }
  const ServiceContext& services() const { return services_; }
  TenantQuotas& quotas() const { return services_.quotas; }
  // Called when the session has been found, before the first PickResponse(). An error ends the call. By default the
  // session notifies this watcher of every change.
  virtual absl::Status OnFound() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    session_->AddWatcher(this->weak_from_this());
    return absl::OkStatus();
  }
  void Fail(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    failure_.Update(status);
    if (!failure_.ok()) cancellation_->Cancel();
  }

  // Fills `response` and returns true if there is something to send. Sets `is_last` if nothing will follow.
  virtual bool PickResponse(const WatchView& view, Response& response, bool& is_last)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) = 0;
  virtual void OnFinish() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {}
  // Called after a write, on a thread of gRPC. Calls Pump() at once, or later on another thread.
  virtual void Continue() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { Pump(); }

  void Pump() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (is_finished_ || is_writing_) return;
    const WatchView view = failure_.ok() ? session_->Watch() : WatchView();
    // What was made before data were lost stays readable.
    if (!absl::IsDataLoss(view.status)) Fail(view.status);
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
    } else if (!failure_.ok() || !view.status.ok() || is_last) {
      Fail(view.status);
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
  void LookInStore(const absl::Status& admitted) {
    if (!admitted.ok()) return Watch(admitted);
    auto mirror = OrOutOfMemory([this] { return services_.sessions.Mirror(missing_->tenant, missing_->name); });
    const absl::Status found = mirror.status();
    if (mirror.ok()) session_ = *std::move(mirror);
    Watch(found);
  }

  void Watch(const absl::Status& found) {
    const std::lock_guard lock(mutex_);
    Fail(found);
    if (failure_.ok()) Fail(OrOutOfMemory([this] { return OnFound(); }));
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
  std::shared_ptr<WatchReactor> self_;       // until OnDone
  std::shared_ptr<WatchedSession> session_;  // null until it is found
  std::optional<Missing> missing_;           // the requested session, if it is not loaded at this server
  const std::shared_ptr<Cancellation> cancellation_ = std::make_shared<Cancellation>();  // of the search for it
  std::shared_ptr<const void> stream_reservation_;                                       // in the quota of streams
  std::shared_ptr<const void> watcher_reservation_;                                      // in the quota of watchers
  Response response_ ABSL_GUARDED_BY(mutex_);
  bool is_writing_ ABSL_GUARDED_BY(mutex_) = false;
  bool is_finished_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status failure_ ABSL_GUARDED_BY(mutex_);
};

// Starts the reactor of a call. It deletes itself when the call has ended.
template <typename Reactor, typename Request>
Reactor* StartWatch(const ServiceContext& services, grpc::CallbackServerContext* context, const Request& request) {
  const auto reactor = std::make_shared<Reactor>(services, context);
  const absl::StatusOr<Caller>& caller = reactor->caller();
  reactor->Start(caller.ok() ? reactor->Begin(*caller, request) : caller.status());
  return reactor.get();
}

}  // namespace evpose::server
