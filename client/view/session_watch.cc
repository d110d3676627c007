// SPDX-License-Identifier: Apache-2.0
#include "client/view/session_watch.h"

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "evpose/clock.h"

namespace evpose::client {
namespace {

constexpr double kPoseRateHz = 60.0;
constexpr absl::Duration kHealthPeriod = absl::Milliseconds(250);
// Between two attempts to open a stream; doubled after each.
constexpr absl::Duration kFirstDelay = absl::Milliseconds(100);
constexpr absl::Duration kMaxDelay = absl::Seconds(2);

// Whether another attempt cannot succeed.
bool IsFinal(const absl::Status& status) {
  return status.ok() || absl::IsNotFound(status) || absl::IsPermissionDenied(status) || absl::IsUnimplemented(status) ||
         absl::IsInvalidArgument(status);
}

// "better pose" for BETTER_POSE.
std::string InWords(std::string_view name) {
  return absl::StrReplaceAll(absl::AsciiStrToLower(std::string(name)), {{"_", " "}});
}

}  // namespace

SessionWatch::SessionWatch(Client& client, const std::string& server, const std::string& session,
                           std::shared_ptr<PageOutbox> outbox, const ImageSettings& settings)
    : client_(client), server_(server), session_(session), outbox_(std::move(outbox)) {
  SetImages(settings);
  poses_ = std::jthread([this](const std::stop_token& stop) { WatchPoses(stop); });
  health_ = std::jthread([this](const std::stop_token& stop) { WatchHealth(stop); });
}

void SessionWatch::SetImages(const ImageSettings& settings) {
  events_ = {};  // waits for the former one
  events_ = std::jthread([this, settings](const std::stop_token& stop) { WatchEvents(stop, settings); });
}

void SessionWatch::Repeat(const std::stop_token& stop, const std::function<absl::Status()>& call,
                          const std::function<void(const absl::Status&)>& on_error,
                          const std::function<void(const absl::Status&)>& on_end) {
  absl::Duration delay = kFirstDelay;
  while (true) {
    const absl::Time started = SystemClock().Now();
    const absl::Status status = call();
    if (stop.stop_requested()) return;
    if (IsFinal(status)) return on_end(status);
    on_error(status);
    const absl::Time now = SystemClock().Now();
    if (now - started > kMaxDelay) delay = kFirstDelay;  // it had worked
    if (!SystemClock().SleepUntil(now + delay, stop)) return;
    delay = std::min(2 * delay, kMaxDelay);
    // Finds the server that has the session, if there are several.
    if (absl::IsNotFound(client_.GetSession(session_).status())) delay = kMaxDelay;
  }
}

void SessionWatch::WatchPoses(const std::stop_token& stop) {
  WatchPosesOptions options;
  options.max_rate_hz = kPoseRateHz;
  const auto on_poses = [&](const std::vector<Pose>& poses, uint64_t) {
    if (!poses.empty()) options.after_pose_seq = poses.back().seq;
    outbox_->AddPoses(poses);
  };
  // WatchHealth() reports the errors.
  Repeat(
      stop, [&] { return client_.WatchPoses(session_, options, on_poses, stop); }, [](const absl::Status&) {},
      [](const absl::Status&) {});
}

void SessionWatch::WatchHealth(const std::stop_token& stop) {
  bool is_lost = false;
  const auto on_health = [&](const SessionHealth& health) {
    if (is_lost) {
      outbox_->AddNote(NoticeText(NoticeLevel::kInfo, absl::StrCat("connected to ", server_, " again")));
    }
    is_lost = false;
    SendStates(health);
    outbox_->SetHealth(health);
  };
  const auto on_error = [&](const absl::Status& status) {
    if (is_lost) return;
    is_lost = true;
    outbox_->AddNote(NoticeText(NoticeLevel::kError, absl::StrCat("the connection to ", server_,
                                                                  " is lost, and is tried again: ", status.message())));
  };
  const auto on_end = [&](const absl::Status& status) {
    outbox_->Set(PageOutbox::Latest::kEnd,
                 EndText(status.ok() ? absl::StrCat(session_, " has ended") : std::string(status.message())));
  };
  Repeat(
      stop, [&] { return client_.WatchHealth(session_, kHealthPeriod, on_health, stop); }, on_error, on_end);
}

void SessionWatch::WatchEvents(const std::stop_token& stop, const ImageSettings& settings) {
  WatchEventsOptions options;
  options.cell_px = settings.cell_px;
  options.max_rate_hz = settings.rate_hz;
  std::string noted;
  const auto on_image = [&](EventImage image) {
    PageImage page_image{std::move(image)};
    page_image.t_us = page_image.image.to_t_us;
    page_image.is_continuation = true;
    outbox_->SetImage(std::move(page_image));
  };
  // WatchHealth() reports lost connections. A server that is stopped ends its calls with CANCELLED.
  const auto on_error = [&](const absl::Status& status) {
    if (absl::IsUnavailable(status) || absl::IsCancelled(status) || noted == status.message()) return;
    noted = std::string(status.message());
    outbox_->AddNote(NoticeText(NoticeLevel::kError, absl::StrCat("no events are shown: ", noted)));
  };
  const auto on_end = [&](const absl::Status& status) {
    if (!status.ok() && !absl::IsNotFound(status)) on_error(status);
  };
  Repeat(
      stop, [&] { return client_.WatchEvents(session_, options, on_image, stop); }, on_error, on_end);
}

void SessionWatch::SendStates(const SessionHealth& health) {
  for (const ObjectHealth& object : health.objects) {
    const bool is_new = !shown_.contains(object.object_id);
    Shown& shown = shown_[object.object_id];
    if (object.latest_loss && shown.lost_at_us != object.latest_loss->t_us) {
      shown.lost_at_us = object.latest_loss->t_us;
      outbox_->AddNote(StateText(object.object_id, object.latest_loss->t_us, TrackState::kLost,
                                 InWords(LossCauseName(object.latest_loss->cause))));
      shown.state = TrackState::kLost;
    }
    if (!is_new && shown.state == object.state && shown.detail == object.detail) continue;
    shown.state = object.state;
    shown.detail = object.detail;
    outbox_->AddNote(StateText(object.object_id, health.t_us, object.state, object.detail));
  }
}

}  // namespace evpose::client
