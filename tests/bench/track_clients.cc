// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/track_clients.h"

#include <algorithm>
#include <utility>

namespace evpose::bench {
namespace {

int64_t MicrosecondsSince(Clock::time_point begin) {
  return std::chrono::duration_cast<std::chrono::microseconds>(Clock::now() - begin).count();
}

}  // namespace

Streamer::Streamer(v1::SessionService::Stub& stub, const server::CreatedSession& session, const Scene& scene,
                   Clock::time_point begin)
    : scene_(scene), begin_(begin), stream_(stub.Track(&context_)), sent_at_us_(scene.chunks.size()) {
  reader_ = std::thread([this] { Read(); });
  sender_ = std::thread([this, session] { Send(session); });
}

void Streamer::Join() {
  sender_.join();
  reader_.join();
}

void Streamer::Send(const server::CreatedSession& session) {
  v1::TrackRequest request;
  request.mutable_attach()->set_session(session.name());
  request.mutable_attach()->set_resume_token(session.resume_token());
  if (!stream_->Write(request)) return;
  uint64_t sent_bytes = 0;
  for (size_t k = 0; k < scene_.chunks.size(); ++k) {
    std::this_thread::sleep_until(begin_ + std::chrono::milliseconds(k + 1));
    const std::string& payload = scene_.chunks[k];
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock,
                    [&] { return is_over_ || (is_attached_ && sent_bytes + payload.size() <= send_limit_bytes_); });
      if (is_over_) return;
    }
    request.mutable_events()->set_seq(k + 1);
    request.mutable_events()->set_payload(payload);
    sent_at_us_[k] = MicrosecondsSince(begin_);
    if (!stream_->Write(request)) return;
    sent_bytes += payload.size();
  }
  request.mutable_end();
  stream_->Write(request);
}

void Streamer::Read() {
  v1::TrackResponse response;
  while (stream_->Read(&response)) {
    if (response.has_pose()) {
      const v1::Pose& pose = response.pose();
      seen_.lost += pose.pose_seq() - seen_.poses - seen_.lost - 1;
      ++seen_.poses;
      const auto chunk = std::min(static_cast<size_t>(pose.t_us() / 1000), sent_at_us_.size() - 1);
      seen_.latencies_ms.push_back(1e-3f * static_cast<float>(MicrosecondsSince(begin_) - sent_at_us_[chunk]));
    } else if (response.has_summary()) {
      has_summary_ = true;
      health_ = response.summary().health();
    } else if (response.has_attached() || response.has_ack()) {
      const std::lock_guard lock(mutex_);
      is_attached_ = true;
      send_limit_bytes_ =
          response.has_ack() ? response.ack().send_limit_bytes() : response.attached().send_limit_bytes();
      changed_.notify_all();
    }
  }
  status_ = stream_->Finish();
  const std::lock_guard lock(mutex_);
  is_over_ = true;
  changed_.notify_all();
}

Watcher::Watcher(v1::SessionService::Stub& stub, const std::string& session, double max_rate_hz, bool is_stalled) {
  request_.set_session(session);
  // A stalled reader requests all poses, which is the worst case.
  if (!is_stalled) request_.set_max_rate_hz(max_rate_hz);
  stub.async()->WatchPoses(&context_, &request_, this);
  if (!is_stalled) StartRead(&response_);
  StartCall();
}

void Watcher::OnReadDone(bool ok) {
  if (!ok) return;
  poses_ += static_cast<uint64_t>(response_.poses_size());
  skipped_ += response_.num_skipped();
  StartRead(&response_);
}

void Watcher::OnDone(const grpc::Status& status) {
  const std::lock_guard lock(mutex_);
  status_ = status;
  is_done_ = true;
  done_.notify_all();
}

void Watcher::Join() {
  std::unique_lock lock(mutex_);
  done_.wait(lock, [this] { return is_done_; });
}

}  // namespace evpose::bench
