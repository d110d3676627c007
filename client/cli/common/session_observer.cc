// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/session_observer.h"

#include <chrono>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "client/cli/common/pose_format.h"
#include "client/lib/status_details.h"
#include "client/lib/stream/retry.h"

namespace evpose::client {
namespace {

constexpr absl::Duration kHealthPeriod = absl::Seconds(1);
constexpr absl::Duration kRetryPeriod = absl::Seconds(1);
constexpr char kEventsElsewhere[] = "EVENTS_ELSEWHERE";  // reason of an error of WatchEvents
constexpr char kHostEpoch[] = "host";

// "SECONDS", at most nine decimals, before 2038, which is the range of stamps in ROS; nullopt for other texts.
std::optional<int64_t> ParseEpoch(const std::string& text) {
  absl::Duration epoch;
  const bool is_number = text.find_first_not_of("0123456789.") == std::string::npos;
  if (!is_number || !absl::ParseDuration(text + "s", &epoch) || epoch >= absl::Seconds(int64_t{1} << 31)) {
    return std::nullopt;
  }
  return absl::ToInt64Nanoseconds(epoch);
}

std::string CheckEpoch(const std::string& text) {
  if (text == kHostEpoch || ParseEpoch(text)) return "";
  return absl::StrCat("\"", text, "\" is neither host nor a number of seconds from 0 to 2147483647");
}

}  // namespace

void RecordingArguments::AddTo(CLI::App& app, const std::string& epoch_default) {
  app.add_option("--epoch", epoch,
                 absl::StrCat("With a .mcap file: seconds since 1970 at the sensor time 0, which are added to sensor "
                              "times; host: by the host's time at which the first message arrives. Default: ",
                              epoch_default))
      ->type_name("SECONDS|host")
      ->check(CheckEpoch);
  app.add_option("--event-images", event_cell_px,
                 "With a .mcap file: also write images of the events with the outlines of the objects, 30 per second, "
                 "with cells of 1, 2 or 4 pixels")
      ->type_name("PIXELS")
      ->check(CLI::IsMember({1, 2, 4}));
}

absl::Status RecordingArguments::Check(const std::string& out) const {
  if (absl::EndsWith(out, ".mcap")) return absl::OkStatus();
  if (!epoch.empty()) return UsageError("--epoch: is for an --out whose name ends in .mcap");
  if (event_cell_px != 0) return UsageError("--event-images: is for an --out whose name ends in .mcap");
  return absl::OkStatus();
}

std::optional<int64_t> RecordingArguments::EpochNs(std::optional<int64_t> without_option) const {
  return epoch.empty() ? without_option : ParseEpoch(epoch);
}

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
    RecordModels();  // takes seconds for a large model: the poses do not wait for it
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
  while (true) {
    const absl::Status status = watch();
    if (status.ok() || stop.stop_requested()) return;
    // Also while no server tracks the events, as after the restart of one until the stream is attached again.
    const bool may_pass = AdviseOn(status) == RetryAdvice::kTryAgain || GetDetails(status).reason == kEventsElsewhere;
    if (!may_pass) return Report(what, status);
    if (!SystemClock().SleepUntil(SystemClock().Now() + kRetryPeriod, stop)) return;
  }
}

void SessionObserver::Report(const std::string& what, const absl::Status& status) {
  options_.print(absl::StrCat("the .mcap file does not have ", what, ": ", status.message()));
}

void SessionObserver::RecordModels() {
  const absl::StatusOr<Session> session = client_.GetSession(session_);
  if (!session.ok()) return Report("the models", session.status());
  for (const TrackedObject& object : session->config.objects) {
    const absl::StatusOr<ModelGeometry> geometry = client_.GetModelGeometry(object.model);
    if (!geometry.ok()) {
      Report(absl::StrCat("the model of ", object.object_id), geometry.status());
      continue;
    }
    for (PoseRecorder* const recorder : recorders_) recorder->SetModel(object.object_id, *geometry);
  }
}

void SessionObserver::RecordHealth(SessionHealth health) {
  health.t_us -= options_.time_zero_us();
  for (PoseRecorder* const recorder : recorders_) recorder->Add(health, session_);
  if (!options_.records_states || health.decoded_events == 0) return;
  for (const ObjectHealth& object : health.objects) {
    const auto [known, is_new] = states_.try_emplace(object.object_id, object.state);
    if (!is_new && known->second == object.state) continue;
    known->second = object.state;
    const std::string text = StateJson(object.object_id, health.t_us, object.state);
    for (PoseRecorder* const recorder : recorders_) recorder->AddState(object.object_id, health.t_us, text);
  }
}

void SessionObserver::RecordImage(EventImage image) {
  const int64_t zero_us = options_.time_zero_us();
  image.from_t_us -= zero_us;
  image.to_t_us -= zero_us;
  for (PoseRecorder* const recorder : recorders_) recorder->Add(image);
}

void SessionObserver::Finish() {
  {
    std::unique_lock lock(mutex_);
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
