// SPDX-License-Identifier: Apache-2.0

// Reads the streams of a session for a page: poses, health and images of events.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <stop_token>
#include <string>
#include <thread>

#include "client/view/page_outbox.h"
#include "evpose/client.h"

namespace evpose::client {

// One thread for each stream. A broken stream is opened again until the session has ended or the server does not know
// it; the page is told when the connection is lost and when there is one again.
class SessionWatch {
 public:
  // `client` must outlive the object. `server` is its address for people.
  SessionWatch(Client& client, const std::string& server, const std::string& session,
               std::shared_ptr<PageOutbox> outbox, const ImageSettings& settings);
  // Waits for the threads, whose calls are cancelled.
  ~SessionWatch() = default;

  // Reads images with other settings.
  void SetImages(const ImageSettings& settings);

 private:
  // Repeats a call that reads a stream: `call` returns after its end. `on_end` is called if there is nothing more to
  // read, with the status.
  void Repeat(const std::stop_token& stop, const std::function<absl::Status()>& call,
              const std::function<void(const absl::Status&)>& on_error,
              const std::function<void(const absl::Status&)>& on_end);
  void WatchPoses(const std::stop_token& stop);
  void WatchHealth(const std::stop_token& stop);
  void WatchEvents(const std::stop_token& stop, const ImageSettings& settings);
  // Sends the state of each object that has changed. Used by the thread of the health only.
  void SendStates(const SessionHealth& health);

  Client& client_;
  const std::string server_;
  const std::string session_;
  const std::shared_ptr<PageOutbox> outbox_;
  struct Shown {
    TrackState state = TrackState::kUnknown;
    std::string detail;
    std::optional<int64_t> lost_at_us;
  };
  std::map<std::string, Shown> shown_;  // by object
  std::jthread events_;
  std::jthread poses_;
  std::jthread health_;
};

}  // namespace evpose::client
