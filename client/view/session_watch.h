// SPDX-License-Identifier: Apache-2.0

// Reads the streams of a session for a page: poses, health and images of events.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>

#include "client/view/page_outbox.h"
#include "evpose/client.h"

namespace evpose::client {

// Returns the notice of a lost connection to a server. `server` is the address that pages display.
std::string ConnectionLostText(const std::string& server, const absl::Status& status);

// Reads each stream on a thread of its own. A broken stream is opened again until the session has ended or the server
// does not know it. The page receives a notice when the connection is lost and when it is restored.
class SessionWatch {
 public:
  // `client` must outlive the object. `server` is its address for people, `frame` that of the poses that are sent.
  SessionWatch(Client& client, const std::string& server, const std::string& session, const PoseFrame& frame,
               std::shared_ptr<PageOutbox> outbox, const ImageSettings& settings);
  // Cancels the calls of the threads and waits for the threads.
  ~SessionWatch() = default;

  // Ends the stream of images and opens one with these settings.
  void SetImages(const ImageSettings& settings);

 private:
  void WatchPoses(const std::stop_token& stop);
  void WatchHealth(const std::stop_token& stop);
  void WatchEvents(const std::stop_token& stop, const ImageSettings& settings);
  // Sends the state of each object whose state has changed. Used by the thread of the health only.
  void SendStates(const SessionHealth& health);

  Client& client_;
  const std::string server_;
  const std::string session_;
  const PoseFrame frame_;
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
