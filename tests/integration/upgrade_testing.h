// SPDX-License-Identifier: Apache-2.0

// What the tests of upgrades share: servers that are replaced at their addresses, and clients that stream through them.
#pragma once

#include <algorithm>
#include <atomic>
#include <bit>
#include <condition_variable>
#include <csignal>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "evpose/client.h"
#include "evpose/recording.h"
#include "server/program/program_testing.h"
#include "tests/integration/cutting_proxy.h"

namespace evpose {

// An address at which one server runs after another.
class ServerPlace {
 public:
  explicit ServerPlace(std::vector<std::string> arguments) : arguments_(std::move(arguments)) {}

  const std::string& address() const { return address_; }
  // Starts a program. No other may run here.
  void Start(const char* program) {
    server_ = std::make_unique<server::Program>(arguments_, program);
    proxy_.SetTarget(server::PortOf(server_->Announced("listening on ")));
  }
  // Ends the program with a signal.
  void End(int signal) {
    server_->Signal(signal);
    EXPECT_EQ(server_->Wait(), signal == SIGTERM ? 0 : -signal);
    proxy_.SetTarget(0);
    log_ += server_->Stderr();
    server_.reset();
  }
  // What the servers that have ended have logged.
  const std::string& log() const { return log_; }

 private:
  const std::vector<std::string> arguments_;
  CuttingProxy proxy_;
  const std::string address_ = proxy_.address();
  std::unique_ptr<server::Program> server_;
  std::string log_;
};

// Text that is the same only for poses that are equal to the bit, apart from their latency.
inline std::string PoseText(const client::Pose& pose) {
  std::string text = absl::StrCat(pose.seq, " ", pose.object_id, " ", pose.t_us, " ", static_cast<int>(pose.state), " ",
                                  pose.num_events, " ", absl::Hex(std::bit_cast<uint32_t>(pose.explained_ratio)));
  const auto append = [&text](const auto& matrix) {
    for (const double number : matrix.reshaped())
      absl::StrAppend(&text, " ", absl::Hex(std::bit_cast<uint64_t>(number)));
  };
  append(pose.camera_from_object.rotation);
  append(pose.camera_from_object.translation_m);
  append(pose.covariance);
  append(pose.twist);
  return text;
}

// A client that streams a recording, up to a chunk that the test moves, and a reader of the same session.
class StreamingClient {
 public:
  // `addresses`: the first is preferred.
  StreamingClient(const std::string& addresses, const std::string& model_file, const client::Camera& camera,
                  const std::vector<client::EventChunk>& chunks)
      : chunks_(chunks), client_(client::Client::Connect(addresses).value()) {
    client::SessionConfig config = {.camera = camera};
    config.objects = {{.object_id = "cube", .model = client_->UploadModelFile(model_file).value().name}};
    session_ = client_->CreateSession(config).value();
    writer_ = std::jthread([this] { Write(); });
    reader_ = std::jthread([this](const std::stop_token& stop) { Read(stop); });
  }
  ~StreamingClient() { Open(chunks_.size()); }

  // Lets the client send this number of chunks.
  void Open(size_t num_chunks) {
    const std::lock_guard lock(mutex_);
    num_open_ = std::max(num_open_, num_chunks);
    changed_.notify_all();
  }
  // Waits until more than this number of chunks are processed, or the stream has ended.
  void AwaitProcessed(size_t num_chunks) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return num_processed_ > num_chunks || has_ended_; });
  }
  // Calls `action` in the thread of the stream when this pose has arrived. The poses of several actions ascend. To be
  // called before Open().
  void AtPose(uint64_t pose_seq, std::function<void()> action) { actions_.emplace_back(pose_seq, std::move(action)); }
  // Lets the client send all, and waits for the ends of the stream and of the reader.
  const absl::StatusOr<client::TrackSummary>& Finish() {
    Open(chunks_.size());
    writer_.join();
    reader_.join();
    return summary_;
  }

  const client::Session& session() const { return session_; }
  // The following are valid after Finish().
  const std::vector<std::string>& poses() const { return poses_; }
  // The poses that arrived before the notice, for each of the notices.
  const std::vector<std::pair<size_t, client::TrackingRestarted>>& restarts() const { return restarts_; }
  const std::vector<std::string>& read_poses() const { return read_poses_; }
  uint64_t read_skipped() const { return read_skipped_; }
  const absl::Status& read_status() const { return read_status_; }
  int num_outages() const { return num_outages_; }

 private:
  absl::StatusOr<client::EventChunk> Next() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return next_ < num_open_ || next_ == chunks_.size() || has_ended_; });
    return next_ == chunks_.size() ? client::EventChunk() : chunks_[next_++];
  }

  void Write() {
    client::TrackCallbacks callbacks;
    callbacks.on_pose = [this](const client::Pose& pose) {
      poses_.push_back(PoseText(pose));
      if (actions_.empty() || pose.seq < actions_.front().first) return;
      actions_.front().second();
      actions_.pop_front();
    };
    callbacks.on_notice = [this](const client::Notice& notice) {
      if (const auto* restarted = std::get_if<client::TrackingRestarted>(&notice)) {
        restarts_.emplace_back(poses_.size(), *restarted);
      }
    };
    callbacks.on_progress = [this](const client::TrackProgress& progress) {
      const std::lock_guard lock(mutex_);
      num_processed_ = progress.processed_chunks;
      changed_.notify_all();
    };
    callbacks.on_connection = [this](const client::ConnectionChange& change) {
      num_outages_ += change.is_unreachable ? 1 : 0;
    };
    summary_ = client_->Track(
        session_, [this] { return Next(); }, callbacks);
    const std::lock_guard lock(mutex_);
    has_ended_ = true;
    changed_.notify_all();
    if (!summary_.ok()) reader_.request_stop();
  }

  void Read(const std::stop_token& stop) {
    read_status_ = client_->WatchPoses(
        session_.name, {},
        [this](const std::vector<client::Pose>& poses, uint64_t num_skipped) {
          for (const client::Pose& pose : poses) read_poses_.push_back(PoseText(pose));
          read_skipped_ += num_skipped;
        },
        stop);
  }

  const std::vector<client::EventChunk> chunks_;
  const std::unique_ptr<client::Client> client_;
  client::Session session_;
  std::mutex mutex_;
  std::condition_variable changed_;
  size_t next_ = 0;
  size_t num_open_ = 0;
  size_t num_processed_ = 0;
  bool has_ended_ = false;
  std::deque<std::pair<uint64_t, std::function<void()>>> actions_;
  std::vector<std::string> poses_;
  std::vector<std::pair<size_t, client::TrackingRestarted>> restarts_;
  std::atomic<int> num_outages_ = 0;
  absl::StatusOr<client::TrackSummary> summary_;
  std::vector<std::string> read_poses_;
  uint64_t read_skipped_ = 0;
  absl::Status read_status_;
  std::jthread writer_;
  std::jthread reader_;  // the threads are the last members, because they use the others
};

}  // namespace evpose
