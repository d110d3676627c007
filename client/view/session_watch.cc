// SPDX-License-Identifier: Apache-2.0
#include "client/view/session_watch.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/stream/retry.h"

namespace evpose::client {
namespace {

constexpr double kPoseRateHz = 60.0;                               // of each object: displays show no more
constexpr absl::Duration kHealthPeriod = absl::Milliseconds(250);  // numbers that change faster cannot be read

}  // namespace

std::string ConnectionLostText(const std::string& server, const absl::Status& status) {
  return NoticeText(NoticeLevel::kError,
                    absl::StrCat("the connection to ", server, " is lost, and is tried again: ", status.message()));
}

SessionWatch::SessionWatch(Client& client, const std::string& server, const std::string& session,
                           const PoseFrame& frame, std::shared_ptr<PageOutbox> outbox, const ImageSettings& settings)
    : client_(client), server_(server), session_(session), frame_(frame), outbox_(std::move(outbox)) {
  SetImages(settings);
  poses_ = std::jthread([this](const std::stop_token& stop) { WatchPoses(stop); });
  health_ = std::jthread([this](const std::stop_token& stop) { WatchHealth(stop); });
}

void SessionWatch::SetImages(const ImageSettings& settings) {
  events_ = {};  // waits for the end of the former thread
  events_ = std::jthread([this, settings](const std::stop_token& stop) { WatchEvents(stop, settings); });
}

void SessionWatch::WatchPoses(const std::stop_token& stop) {
  WatchPosesOptions options;
  options.max_rate_hz = kPoseRateHz;
  const auto on_poses = [&](const std::vector<Pose>& poses, uint64_t) {
    if (!poses.empty()) options.after_pose_seq = poses.back().seq;
    outbox_->AddPoses(frame_.Apply(poses));
  };
  // WatchHealth() reports the errors.
  const auto ignore = [](const absl::Status&) {};
  RepeatCall(
      stop, [&] { return client_.WatchPoses(session_, options, on_poses, stop); }, ignore)
      .IgnoreError();
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
    outbox_->AddNote(ConnectionLostText(server_, status));
  };
  const absl::Status status = RepeatCall(
      stop, [&] { return client_.WatchHealth(session_, kHealthPeriod, on_health, stop); }, on_error);
  if (stop.stop_requested()) return;
  outbox_->Set(PageOutbox::Latest::kEnd,
               EndText(status.ok() ? absl::StrCat(session_, " has ended") : std::string(status.message())));
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
  // WatchHealth() reports lost connections. A server that is stopped ends its calls with CANCELLED, and gRPC those of a
  // connection that a proxy has closed with UNKNOWN.
  const auto is_lost = [](const absl::Status& status) {
    return absl::IsUnavailable(status) || absl::IsCancelled(status) || absl::IsUnknown(status);
  };
  const auto on_error = [&](const absl::Status& status) {
    if (is_lost(status) || noted == status.message()) return;
    noted = std::string(status.message());
    outbox_->AddNote(NoticeText(NoticeLevel::kError, absl::StrCat("no events are shown: ", noted)));
  };
  const absl::Status status = RepeatCall(
      stop, [&] { return client_.WatchEvents(session_, options, on_image, stop); }, on_error);
  if (!stop.stop_requested() && !status.ok() && !absl::IsNotFound(status)) on_error(status);
}

void SessionWatch::SendStates(const SessionHealth& health) {
  for (const ObjectHealth& object : health.objects) {
    const bool is_new = !shown_.contains(object.object_id);
    Shown& shown = shown_[object.object_id];
    if (object.latest_loss && shown.lost_at_us != object.latest_loss->t_us) {
      shown.lost_at_us = object.latest_loss->t_us;
      outbox_->AddNote(StateText(object.object_id, object.latest_loss->t_us, TrackState::kLost,
                                 CauseText(object.latest_loss->cause)));
      shown.state = TrackState::kLost;
    }
    if (!is_new && shown.state == object.state && shown.detail == object.detail) continue;
    shown.state = object.state;
    shown.detail = object.detail;
    outbox_->AddNote(StateText(object.object_id, health.t_us, object.state, object.detail));
  }
}

}  // namespace evpose::client
