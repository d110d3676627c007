// SPDX-License-Identifier: Apache-2.0
#include "client/bench/load_watcher.h"

namespace evpose::client {
namespace {

// Time before a broken call is made again: the session has moved or its server restarts.
constexpr std::chrono::milliseconds kWatchAgain{500};

}  // namespace

class LoadWatcher::Call : public grpc::ClientReadReactor<v1::WatchPosesResponse> {
 public:
  Call(LoadWatcher& watcher, v1::SessionService::Stub& stub, const std::string& session, uint64_t after,
       double max_rate_hz)
      : watcher_(watcher) {
    request_.set_session(session);
    request_.set_after_pose_seq(after);
    request_.set_max_rate_hz(max_rate_hz);
    stub.async()->WatchPoses(&context_, &request_, this);
    StartRead(&response_);
    StartCall();
  }
  void OnReadDone(bool ok) override {
    if (!ok) return;
    watcher_.OnResponse(response_);
    StartRead(&response_);
  }
  void OnDone(const grpc::Status& status) override { watcher_.OnDone(status); }
  void Cancel() { context_.TryCancel(); }

 private:
  LoadWatcher& watcher_;
  grpc::ClientContext context_;
  v1::WatchPosesRequest request_;
  v1::WatchPosesResponse response_;
};

LoadWatcher::LoadWatcher(double max_rate_hz) : max_rate_hz_(max_rate_hz) {}
LoadWatcher::~LoadWatcher() = default;

void LoadWatcher::Watch(v1::SessionService::Stub& stub, const std::string& session, Time now) {
  const std::lock_guard lock(mutex_);
  if (is_calling_) return;
  if (session != session_) {
    session_ = session;
    has_ended_ = false;
    again_at_ = now;
    last_seq_ = 0;
  }
  if (has_ended_ || now < again_at_) return;
  is_calling_ = true;
  call_ = std::make_unique<Call>(*this, stub, session_, last_seq_, max_rate_hz_);
}

void LoadWatcher::Cancel() {
  const std::lock_guard lock(mutex_);
  if (is_calling_) call_->Cancel();
}

bool LoadWatcher::IsIdle() const {
  const std::lock_guard lock(mutex_);
  return !is_calling_;
}

uint64_t LoadWatcher::poses() const {
  const std::lock_guard lock(mutex_);
  return poses_;
}

uint64_t LoadWatcher::skipped() const {
  const std::lock_guard lock(mutex_);
  return skipped_;
}

void LoadWatcher::OnResponse(const v1::WatchPosesResponse& response) {
  const std::lock_guard lock(mutex_);
  poses_ += static_cast<uint64_t>(response.poses_size());
  skipped_ += response.num_skipped();
  if (response.poses_size() > 0) last_seq_ = response.poses().rbegin()->pose_seq();
}

void LoadWatcher::OnDone(const grpc::Status& status) {
  const std::lock_guard lock(mutex_);
  is_calling_ = false;
  has_ended_ = status.ok();
  again_at_ = std::chrono::steady_clock::now() + kWatchAgain;
}

}  // namespace evpose::client
