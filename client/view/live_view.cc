// SPDX-License-Identifier: Apache-2.0
#include "client/view/live_view.h"

#include <utility>

#include "absl/strings/str_cat.h"

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
  } else if (std::holds_alternative<ListRequest>(request)) {
    pending_.list = true;
  } else {
    return absl::InvalidArgumentError("this is a live session: only a recording has other instants");
  }
  changed_.notify_one();
  return absl::OkStatus();
}

void LiveView::Run(const std::stop_token& stop) {
  while (true) {
    Pending next;
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, stop, [this] { return !pending_.IsEmpty(); });
      if (stop.stop_requested()) return;
      next = std::exchange(pending_, {});
    }
    if (next.settings && !(*next.settings == settings_)) {
      // The window is the page's own.
      const bool is_other = next.settings->cell_px != settings_.cell_px || next.settings->rate_hz != settings_.rate_hz;
      settings_ = *next.settings;
      if (watch_ && is_other && !next.session) watch_->SetImages(settings_);
    }
    if (next.list) List();
    if (next.session) OpenSession(*next.session);
  }
}

void LiveView::List() {
  const absl::StatusOr<std::vector<Session>> sessions = client_.ListSessions();
  if (!sessions.ok()) return Note(NoticeLevel::kError, sessions.status().message());
  outbox_->Set(PageOutbox::Latest::kSessions, SessionsText(*sessions));
}

void LiveView::OpenSession(const std::string& name) {
  watch_.reset();
  const absl::StatusOr<Session> session = client_.GetSession(name);
  if (!session.ok()) {
    Note(NoticeLevel::kError, session.status().message());
    return List();
  }
  Scene scene{.session = session->name, .camera = session->config.camera};
  for (const TrackedObject& object : session->config.objects) {
    const absl::StatusOr<ModelInfo> model = client_.GetModel(object.model);
    const bool has_name = model.ok() && !model->file_name.empty();
    scene.objects.push_back(
        {object.object_id, has_name ? model->file_name : object.model, model.ok() ? model->diameter_m : 0.0});
  }
  outbox_->StartScene(scene);
  watch_ = std::make_unique<SessionWatch>(client_, server_, name, outbox_, settings_);
  SendGeometries(*session, scene);
}

void LiveView::SendGeometries(const Session& session, const Scene& scene) {
  auto frames = std::make_shared<PageOutbox::Prepared>();
  for (size_t i = 0; i < scene.objects.size(); ++i) {
    const absl::StatusOr<ModelGeometry> geometry = client_.GetModelGeometry(session.config.objects[i].model);
    if (geometry.ok()) {
      frames->push_back({ToBinary(scene.objects[i], *geometry), true});
    } else {
      Note(NoticeLevel::kError, absl::StrCat(scene.objects[i].id, ": no 3D view: ", geometry.status().message()));
    }
  }
  outbox_->Add(std::move(frames));
}

void LiveView::Note(NoticeLevel level, absl::string_view text) {
  outbox_->AddNote(NoticeText(level, std::string(text)));
}

}  // namespace evpose::client
