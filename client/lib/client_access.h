// SPDX-License-Identifier: Apache-2.0

// Operations of Client that need gRPC or a feed of the caller, for the command line and for tests. Internal.
#pragma once

#include <grpcpp/channel.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "client/lib/stream/event_feed.h"
#include "evpose/client.h"
#include "evpose/clock.h"

namespace evpose::client {

struct ClientAccess {
  // Uses an existing channel, for example that of a server in this process. `name` is the prefix of error messages.
  // `clock` is that of the time before a stream of a watcher is opened again; it must outlive the client.
  static std::unique_ptr<Client> OverChannel(std::shared_ptr<grpc::Channel> channel, const std::string& name,
                                             Clock& clock = SystemClock());
  // Client::Track() with a feed of the caller, from any position of a session. Stops the feed.
  static absl::StatusOr<TrackSummary> Track(Client& client, const TrackPosition& position, EventFeed& feed,
                                            const TrackCallbacks& callbacks, const TrackOptions& options = {});
};

}  // namespace evpose::client
