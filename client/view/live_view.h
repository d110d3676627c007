// SPDX-License-Identifier: Apache-2.0

// The source of the pages that show the sessions of a server live.
#pragma once

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "client/view/session_watch.h"
#include "client/view/view_source.h"
#include "evpose/client.h"

namespace evpose::client {

// The view of one page. A thread makes the calls for the page's requests, and a SessionWatch reads the streams of the
// session that is shown. The calls end when the page leaves or opens another session.
class LiveView : public PageView {
 public:
  // `client` must outlive the view. Shows the session `hello.session` first, or the list of the sessions if it is
  // empty, with the poses in `frame`.
  LiveView(Client& client, const HelloMessage& hello, const PoseFrame& frame, std::shared_ptr<PageOutbox> outbox);
  ~LiveView() override;

  absl::Status Handle(const PageRequest& request) override;

 private:
  // Requests that the thread has not taken yet. A later request replaces an earlier one of the same kind.
  struct Pending {
    bool has_list = false;
    std::optional<std::string> session;
    std::optional<ImageSettings> settings;

    bool IsEmpty() const { return !has_list && !session && !settings; }
  };

  void Run(const std::stop_token& stop);
  // Waits until the page has made a request or `stop`, the token of the thread, requests the end. Returns the request
  // and a token for the calls that answer it; the token requests their end when the page leaves or opens another
  // session.
  std::pair<Pending, std::stop_token> NextRequest(const std::stop_token& stop);
  void List(const std::stop_token& stop);
  // Shows the session as soon as the server responds. If the server has no such session, sends the end and the list of
  // the sessions to the page.
  void OpenSession(const std::string& name, const std::stop_token& stop);
  // Repeats a call while an error may pass, and tells the page once that the connection is lost.
  absl::Status Repeat(const std::stop_token& stop, const std::function<absl::Status()>& call);
  // The name and the diameter of a model that the server does not know are its ID and 0.
  PageScene MakeScene(const Session& session, const std::stop_token& stop);
  // Sends the models for the 3D view, as soon as the server or its store has them. A diameter that is not known is
  // replaced by the size of the vertices.
  void SendGeometries(const SessionConfig& config, const PageScene& scene, const std::stop_token& stop);
  void NoteError(absl::string_view text);

  Client& client_;
  const std::string server_;
  const PoseFrame frame_;
  const std::shared_ptr<PageOutbox> outbox_;
  ImageSettings settings_;  // the thread's own
  std::mutex mutex_;
  std::condition_variable_any changed_;
  Pending pending_ ABSL_GUARDED_BY(mutex_);
  std::stop_source calls_ ABSL_GUARDED_BY(mutex_);  // cancels the calls of the thread
  std::unique_ptr<SessionWatch> watch_;             // of the session that is shown; the thread's own
  std::jthread geometries_;                         // of that session; the thread's own
  std::jthread thread_;
};

class LiveSource : public ViewSource {
 public:
  // `client` must outlive the source. `server` is the address that pages display. Pages show `session` first, or the
  // list of the sessions if it is empty, with the poses in `frame`.
  LiveSource(Client& client, const std::string& server, const std::string& session, const PoseFrame& frame = {})
      : client_(client), server_(server), session_(session), frame_(frame) {}

  std::unique_ptr<PageView> Open(std::shared_ptr<PageOutbox> outbox) override;

 private:
  Client& client_;
  const std::string server_;
  const std::string session_;
  const PoseFrame frame_;
};

}  // namespace evpose::client
