// SPDX-License-Identifier: Apache-2.0

// Records in .mcap files what a session has beside its poses: camera, models, health and images of the events.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "client/mcap/pose_recorder.h"
#include "evpose/client.h"

namespace evpose::client {

struct SessionObserverOptions {
  Camera camera;          // camera of the session
  int event_cell_px = 0;  // size of the cells of the images; 0: no images
  // Records the states of the objects in the first health, and each change in a later one. Without it, the caller
  // records the changes that notices report.
  bool records_states = false;
  // Records only the states in the first health: a caller that continues a session has missed earlier notices.
  bool records_first_states = false;
  // Sensor time at which the clock of the recorded times is 0, microseconds.
  std::function<int64_t()> time_zero_us = [] { return int64_t{0}; };
  // Reports that something cannot be recorded; the poses are. Called from several threads.
  std::function<void(const std::string&)> print = [](const std::string&) {};
};

// Threads that follow the session until it ends or Stop() is called. Does nothing without recorders.
class SessionObserver {
 public:
  // `client` and `recorders` must outlive it.
  SessionObserver(Client& client, const std::string& session, std::vector<PoseRecorder*> recorders,
                  SessionObserverOptions options);
  ~SessionObserver() { Stop(); }

  // To be called when the session has ended. Waits until the models are recorded or the last attempt to get them has
  // failed, and then for at most a second until the last messages are recorded. Then calls Stop().
  void Finish();
  // Cancels the calls to the server.
  void Stop();
  // Records a health that the caller has; only after Stop().
  void RecordHealth(SessionHealth health);

 private:
  void RecordModels(const std::stop_token& stop);
  // Makes `call` until it returns OK, repeatedly after errors that may pass. After a request of models_stop_ it makes
  // one last attempt.
  absl::Status RepeatForModels(const std::stop_token& stop, const std::function<absl::Status()>& call);
  void RecordImage(EventImage image);
  // Calls `watch` until it returns OK, repeatedly after errors that may pass; reports another one.
  void Repeat(const std::string& what, const std::stop_token& stop, const std::function<absl::Status()>& watch);
  void Report(const std::string& what, const absl::Status& status);

  Client& client_;
  const std::string session_;
  const std::vector<PoseRecorder*> recorders_;
  const SessionObserverOptions options_;
  std::map<std::string, TrackState> states_;  // by object; used by the thread of the health only
  std::mutex mutex_;
  int num_running_ = 0;      // guarded by mutex_
  bool has_models_ = false;  // they are recorded, or reported; guarded by mutex_
  std::condition_variable_any ended_;
  std::stop_source models_stop_;  // of the delays between the attempts to get the models
  std::jthread health_;
  std::jthread images_;
};

}  // namespace evpose::client
