// SPDX-License-Identifier: Apache-2.0
#include "client/view/live_view.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/stream/retry.h"

namespace evpose::client {

LiveView::LiveView(Client& client, const HelloMessage& hello, std::shared_ptr<PageOutbox> outbox)
    : client_(client), server_(hello.source), outbox_(std::move(outbox)) {
  outbox_->Set(PageOutbox::Latest::kHello, ToText(hello));
  pending_.list = hello.session.empty();
  if (!hello.session.empty()) pending_.session = hello.session;
  thread_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

LiveView::~LiveView() { thread_ = {}; }

absl::Status LiveView::Handle(const PageRequest& request) {
  const std::lock_guard lock(mutex_);
  if (const auto* settings = std::get_if<ImageSettings>(&request)) {
    pending_.settings = *settings;
  } else if (const auto* open = std::get_if<OpenRequest>(&request)) {
    pending_.session = open->session;
    calls_.request_stop();
  } else if (std::holds_alternative<ListRequest>(request)) {
    pending_.list = true;
  } else {
    return absl::InvalidArgumentError("this is a live session: only a recording has other instants");
  }
  changed_.notify_one();
  return absl::OkStatus();
}

std::pair<LiveView::Pending, std::stop_token> LiveView::NextRequest(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, stop, [this] { return !pending_.IsEmpty(); });
  calls_ = std::stop_source();
  return {std::exchange(pending_, {}), calls_.get_token()};
}

void LiveView::Run(const std::stop_token& stop) {
  const std::stop_callback end_calls(stop, [this] {
    const std::lock_guard lock(mutex_);
    calls_.request_stop();
  });
  while (true) {
    const auto [next, calls] = NextRequest(stop);
    if (stop.stop_requested()) return;
    if (next.settings && !(*next.settings == settings_)) {
      // The page itself accumulates live images over the window (README, section 3); a change of it needs no new
      // stream.
      const bool is_other = next.settings->cell_px != settings_.cell_px || next.settings->rate_hz != settings_.rate_hz;
      settings_ = *next.settings;
      if (watch_ && is_other && !next.session) watch_->SetImages(settings_);
    }
    if (next.session) OpenSession(*next.session, calls);
    if (next.list) List(calls);
  }
}

void LiveView::List(const std::stop_token& stop) {
  const absl::StatusOr<std::vector<Session>> sessions = client_.ListSessions(stop);
  if (sessions.ok()) return outbox_->Set(PageOutbox::Latest::kSessions, SessionsText(*sessions));
  if (!stop.stop_requested()) return NoteError(sessions.status().message());
  const std::lock_guard lock(mutex_);
  pending_.list = true;  // after the session that is opened meanwhile
}

void LiveView::OpenSession(const std::string& name, const std::stop_token& stop) {
  watch_.reset();
  absl::StatusOr<Session> session;
  bool is_lost = false;
  const auto get = [&] {
    session = client_.GetSession(name, stop);
    return session.status();
  };
  const absl::Status status = RepeatCall(stop, get, [&](const absl::Status& error) {
    if (!std::exchange(is_lost, true)) outbox_->AddNote(ConnectionLostText(server_, error));
  });
  if (!status.ok()) {
    if (stop.stop_requested()) return;
    NoteError(status.message());
    outbox_->Set(PageOutbox::Latest::kEnd, EndText(std::string(status.message())));
    return List(stop);
  }
  const Scene scene = MakeScene(*session, stop);
  if (stop.stop_requested()) return;
  outbox_->StartScene(scene);
  watch_ = std::make_unique<SessionWatch>(client_, server_, name, outbox_, settings_);
  SendGeometries(*session, scene, stop);
}

Scene LiveView::MakeScene(const Session& session, const std::stop_token& stop) {
  Scene scene{.session = session.name, .camera = session.config.camera};
  for (const TrackedObject& object : session.config.objects) {
    const absl::StatusOr<ModelInfo> model = client_.GetModel(object.model, stop);
    const bool has_name = model.ok() && !model->file_name.empty();
    scene.objects.push_back(
        {object.object_id, has_name ? model->file_name : object.model, model.ok() ? model->diameter_m : 0.0});
  }
  return scene;
}

void LiveView::SendGeometries(const Session& session, const Scene& scene, const std::stop_token& stop) {
  auto frames = std::make_shared<PageOutbox::Prepared>();
  for (size_t i = 0; i < scene.objects.size(); ++i) {
    const absl::StatusOr<ModelGeometry> geometry =
        client_.GetModelGeometry(session.config.objects[i].model, /*max_faces=*/0, stop);
    if (stop.stop_requested()) return;
    if (geometry.ok()) {
      frames->push_back({ToBinary(scene.objects[i], *geometry), true});
    } else {
      NoteError(absl::StrCat(scene.objects[i].id, ": no 3D view: ", geometry.status().message()));
    }
  }
  outbox_->Add(std::move(frames));
}

void LiveView::NoteError(absl::string_view text) {
  outbox_->AddNote(NoticeText(NoticeLevel::kError, std::string(text)));
}

std::unique_ptr<PageView> LiveSource::Open(std::shared_ptr<PageOutbox> outbox) {
  return std::make_unique<LiveView>(
      client_, HelloMessage{.is_recording = false, .source = server_, .session = session_}, std::move(outbox));
}

}  // namespace evpose::client
