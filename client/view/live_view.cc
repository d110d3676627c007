// SPDX-License-Identifier: Apache-2.0
#include "client/view/live_view.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/stream/retry.h"

namespace evpose::client {
namespace {

// Returns twice the distance of the farthest vertex from the middle of all, metres: a bound of the diameter.
double SizeOf(const ModelGeometry& geometry) {
  Eigen::AlignedBox3f box;
  for (const Eigen::Vector3f& vertex : geometry.vertices_m) box.extend(vertex);
  double size_m = 0.0;
  for (const Eigen::Vector3f& vertex : geometry.vertices_m) {
    size_m = std::max(size_m, 2.0 * static_cast<double>((vertex - box.center()).norm()));
  }
  return size_m;
}

}  // namespace

LiveView::LiveView(Client& client, const HelloMessage& hello, const PoseFrame& frame,
                   std::shared_ptr<PageOutbox> outbox)
    : client_(client), server_(hello.source), frame_(frame), outbox_(std::move(outbox)) {
  outbox_->Set(PageOutbox::Latest::kHello, ToText(hello));
  pending_.has_list = hello.session.empty();
  if (!hello.session.empty()) pending_.session = hello.session;
  thread_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

LiveView::~LiveView() {
  thread_ = {};
  geometries_ = {};
}

absl::Status LiveView::Handle(const PageRequest& request) {
  const std::lock_guard lock(mutex_);
  if (const auto* settings = std::get_if<ImageSettings>(&request)) {
    pending_.settings = *settings;
  } else if (const auto* open = std::get_if<OpenRequest>(&request)) {
    pending_.session = open->session;
    calls_.request_stop();
  } else if (std::holds_alternative<ListRequest>(request)) {
    pending_.has_list = true;
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
    if (next.has_list) List(calls);
  }
}

void LiveView::List(const std::stop_token& stop) {
  const absl::StatusOr<std::vector<Session>> sessions = client_.ListSessions(stop);
  if (sessions.ok()) return outbox_->Set(PageOutbox::Latest::kSessions, SessionsText(*sessions));
  if (!stop.stop_requested()) return NoteError(sessions.status().message());
  const std::lock_guard lock(mutex_);
  pending_.has_list = true;  // after the session that is opened meanwhile
}

void LiveView::OpenSession(const std::string& name, const std::stop_token& stop) {
  watch_.reset();
  geometries_ = {};
  absl::StatusOr<Session> session;
  const absl::Status status = Repeat(stop, [&] {
    session = client_.GetSession(name, stop);
    return session.status();
  });
  if (!status.ok()) {
    if (stop.stop_requested()) return;
    NoteError(status.message());
    outbox_->Set(PageOutbox::Latest::kEnd, EndText(std::string(status.message())));
    return List(stop);
  }
  const PageScene scene = MakeScene(*session, stop);
  if (stop.stop_requested()) return;
  outbox_->StartScene(scene);
  watch_ = std::make_unique<SessionWatch>(client_, server_, name, frame_, outbox_, settings_);
  // Another thread, because the calls are repeated while the page makes requests.
  geometries_ = std::jthread(
      [this, config = session->config, scene](const std::stop_token& end) { SendGeometries(config, scene, end); });
}

absl::Status LiveView::Repeat(const std::stop_token& stop, const std::function<absl::Status()>& call) {
  bool is_lost = false;
  return RepeatCall(stop, call, [&](const absl::Status& error) {
    if (!std::exchange(is_lost, true)) outbox_->AddNote(ConnectionLostText(server_, error));
  });
}

PageScene LiveView::MakeScene(const Session& session, const std::stop_token& stop) {
  PageScene scene{.session = session.name, .frame = frame_, .camera = session.config.camera};
  for (const TrackedObject& object : session.config.objects) {
    absl::StatusOr<ModelInfo> model;
    // A server that has not seen the model does not know it, although its store has the geometry.
    Repeat(stop, [&] {
      model = client_.GetModel(object.model, stop);
      return model.status();
    }).IgnoreError();
    const bool has_name = model.ok() && !model->file_name.empty();
    scene.objects.push_back(
        {object.object_id, has_name ? model->file_name : object.model, model.ok() ? model->diameter_m : 0.0});
  }
  return scene;
}

void LiveView::SendGeometries(const SessionConfig& config, const PageScene& scene, const std::stop_token& stop) {
  for (size_t i = 0; i < scene.objects.size(); ++i) {
    SceneObject object = scene.objects[i];
    bool is_late = false;
    absl::StatusOr<ModelGeometry> geometry;
    const auto get = [&] {
      geometry = client_.GetModelGeometry(config.objects[i].model, /*max_faces=*/0, stop);
      return geometry.status();
    };
    RepeatCall(stop, get, [&](const absl::Status& error) {
      if (std::exchange(is_late, true)) return;
      NoteError(absl::StrCat(object.id, ": no 3D view yet: ", error.message()));
    }).IgnoreError();
    if (stop.stop_requested()) return;
    if (!geometry.ok()) {
      NoteError(absl::StrCat(object.id, ": no 3D view: ", geometry.status().message()));
      continue;
    }
    if (object.diameter_m <= 0.0) object.diameter_m = SizeOf(*geometry);
    auto frames = std::make_shared<PageOutbox::Prepared>();
    frames->push_back({ToBinary(object, *geometry), true});
    outbox_->Add(std::move(frames));
  }
}

void LiveView::NoteError(absl::string_view text) {
  outbox_->AddNote(NoticeText(NoticeLevel::kError, std::string(text)));
}

std::unique_ptr<PageView> LiveSource::Open(std::shared_ptr<PageOutbox> outbox) {
  return std::make_unique<LiveView>(
      client_, HelloMessage{.is_recording = false, .source = server_, .session = session_}, frame_, std::move(outbox));
}

}  // namespace evpose::client
