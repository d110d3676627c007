// SPDX-License-Identifier: Apache-2.0

// Operations of Client that need gRPC or a feed of the caller, for the command line and for tests. Internal.
#pragma once

#include <grpcpp/channel.h>

#include <cstddef>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "client/lib/stream/event_feed.h"
#include "evpose/client.h"
#include "evpose/clock.h"

namespace evpose::client {

struct ClientAccess {
  // Uses an existing channel, for example that of a server in this process. `name` is the prefix of error messages.
  // `clock` is that of the time before a call is made again; it must outlive the client.
  static std::unique_ptr<Client> OverChannel(std::shared_ptr<grpc::Channel> channel, const std::string& name,
                                             Clock& clock = SystemClock());
  // Uses existing channels to several servers that share their sessions, each with its name.
  static std::unique_ptr<Client> OverChannels(
      const std::vector<std::pair<std::string, std::shared_ptr<grpc::Channel>>>& servers, Clock& clock);
  // Replaces the clock of the time before a call is made again, before the first call. It must outlive the client.
  static void SetClock(Client& client, Clock& clock);
  // Client::Track() with a feed of the caller, from any position of a session. Stops the feed.
  static absl::StatusOr<TrackSummary> Track(Client& client, const TrackPosition& position, EventFeed& feed,
                                            const TrackCallbacks& callbacks, const TrackOptions& options = {});
  // Whether the server accepts sessions, by its health service, which requires no token. Errors: UNIMPLEMENTED if it
  // has no such service.
  static absl::StatusOr<bool> IsServing(Client& client);
  // Uploads `num_bytes` bytes, which the server counts and discards, and returns the time until it has confirmed the
  // number; a round trip is included. `num_bytes` must be below the limit of the server for a model. It takes a place
  // among the uploads of the tenant for that time. Errors: those of Client::UploadModel(); DEADLINE_EXCEEDED after
  // `timeout`.
  static absl::StatusOr<absl::Duration> TimeUpload(Client& client, size_t num_bytes, absl::Duration timeout);
};

}  // namespace evpose::client
