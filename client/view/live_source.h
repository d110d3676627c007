// SPDX-License-Identifier: Apache-2.0

// The source of a server's sessions, as they are tracked.
#pragma once

#include <memory>
#include <string>

#include "client/view/view_source.h"
#include "evpose/client.h"

namespace evpose::client {

class LiveSource : public ViewSource {
 public:
  // `client` must outlive the source. `server` is its address for people. `session` is shown first; empty: the list of
  // the sessions.
  LiveSource(Client& client, const std::string& server, const std::string& session)
      : client_(client), server_(server), session_(session) {}

  std::unique_ptr<PageView> Open(std::shared_ptr<PageOutbox> outbox) override;

 private:
  Client& client_;
  const std::string server_;
  const std::string session_;
};

}  // namespace evpose::client
