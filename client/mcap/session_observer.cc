// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/session_observer.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "client/lib/stream/retry.h"
#include "client/mcap/event_png.h"

namespace evpose::client {
namespace {

constexpr absl::Duration kHealthPeriod = absl::Seconds(1);  // a recording needs no finer health

}  // namespace

SessionObserver::SessionObserver(Client& client, const std::string& session, std::vector<PoseRecorder*> recorders,
                                 SessionObserverOptions options)
    : client_(client), session_(session), recorders_(std::move(recorders)), options_(std::move(options)) {
  if (recorders_.empty()) return;
  for (PoseRecorder* const recorder : recorders_) recorder->SetCamera(options_.camera);
  const auto start = [this](auto watch) {
    ++num_running_;
    return std::jthread([this, watch](std::stop_token stop) {
      watch(stop);
      const std::lock_guard lock(mutex_);
      --num_running_;
      ended_.notify_all();
    });
  };
  const std::lock_guard lock(mutex_);
  health_ = start([this](const std::stop_token& stop) {
    RecordModels(stop);  // takes seconds for a large model: the poses do not wait for it
    {
      const std::lock_guard models_lock(mutex_);
      has_models_ = true;
      ended_.notify_all();
    }
    const auto record = [this](const SessionHealth& health) { RecordHealth(health); };
    Repeat("the health", stop, [&] { return client_.WatchHealth(session_, kHealthPeriod, record, stop); });
  });
  if (options_.event_cell_px == 0) return;
  images_ = start([this](const std::stop_token& stop) {
    const auto record = [this](EventImage image) { RecordImage(std::move(image)); };
    const WatchEventsOptions watch = {.cell_px = options_.event_cell_px};
    Repeat("the images of the events", stop, [&] { return client_.WatchEvents(session_, watch, record, stop); });
  });
}

void SessionObserver::Repeat(const std::string& what, const std::stop_token& stop,
                             const std::function<absl::Status()>& watch) {
  const absl::Status status = RepeatCall(stop, watch, [](const absl::Status&) {});
  if (!status.ok() && !stop.stop_requested()) Report(what, status);
}

void SessionObserver::Report(const std::string& what, const absl::Status& status) {
  options_.print(absl::StrCat("the .mcap file does not have ", what, ": ", status.message()));
}

void SessionObserver::RecordModels(const std::stop_token& stop) {
  const std::stop_callback stop_delays(stop, [this] { models_stop_.request_stop(); });
  absl::StatusOr<Session> session;
  const absl::Status found = RepeatForModels(stop, [&] {
    session = client_.GetSession(session_, stop);
    return session.status();
  });
  if (!found.ok()) return Report("the models", found);
  for (const TrackedObject& object : session->config.objects) {
    absl::StatusOr<ModelGeometry> geometry;
    const absl::Status got = RepeatForModels(stop, [&] {
      geometry = client_.GetModelGeometry(object.model, /*max_faces=*/0, stop);
      return geometry.status();
    });
    if (!got.ok()) {
      Report(absl::StrCat("the model of ", object.object_id), got);
      continue;
    }
    for (PoseRecorder* const recorder : recorders_) recorder->SetModel(object.object_id, *geometry);
  }
}

absl::Status SessionObserver::RepeatForModels(const std::stop_token& stop, const std::function<absl::Status()>& call) {
  const std::stop_token delays = models_stop_.get_token();
  absl::Status status = RepeatCall(delays, call, [](const absl::Status&) {});
  const bool is_interrupted = !status.ok() && delays.stop_requested() && !stop.stop_requested();
  return is_interrupted ? call() : status;
}

void SessionObserver::RecordHealth(SessionHealth health) {
  health.t_us -= options_.time_zero_us();
  for (PoseRecorder* const recorder : recorders_) recorder->Add(health, session_);
  const bool is_first = options_.records_first_states && states_.empty();
  if (!(options_.records_states || is_first) || health.decoded_events == 0) return;
  for (const ObjectHealth& object : health.objects) {
    const auto [known, is_new] = states_.try_emplace(object.object_id, object.state);
    if (!is_new && known->second == object.state) continue;
    known->second = object.state;
    for (PoseRecorder* const recorder : recorders_) recorder->AddState(object.object_id, health.t_us, object.state);
  }
}

void SessionObserver::RecordImage(EventImage image) {
  const int64_t zero_us = options_.time_zero_us();
  image.from_t_us -= zero_us;
  image.to_t_us -= zero_us;
  const std::string png = EventImagePng(image, std::min(image.width * image.cell_px, options_.camera.width_px),
                                        std::min(image.height * image.cell_px, options_.camera.height_px));
  for (PoseRecorder* const recorder : recorders_) recorder->Add(image, png);
}

void SessionObserver::Finish() {
  models_stop_.request_stop();  // a server that is unreachable at the end of the session may remain so
  {
    std::unique_lock lock(mutex_);
    ended_.wait(lock, [this] { return has_models_ || num_running_ == 0; });
    ended_.wait_for(lock, std::chrono::seconds(1), [this] { return num_running_ == 0; });
  }
  Stop();
}

void SessionObserver::Stop() {
  for (std::jthread* const thread : {&health_, &images_}) {
    thread->request_stop();
    if (thread->joinable()) thread->join();
  }
}

}  // namespace evpose::client
