// A connection to an evpose server: models, sessions, and the stream of events and poses.
#pragma once

#include <grpcpp/channel.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "absl/types/span.h"
#include "client/lib/track.h"
#include "client/lib/types.h"

namespace evpose::client {

struct ClientOptions {
  absl::Duration connect_timeout = absl::Seconds(10);  // a server may just be starting
  absl::Duration call_timeout = absl::Seconds(60);     // of a single call; loading a large model takes seconds

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct UploadOptions {
  ModelFormat format = ModelFormat::kObj;
  double metres_per_unit = 1.0;
};

// Thread-safe. All calls block; statuses have the server's code and a message that begins with the server's address.
class Client {
 public:
  // `address` is HOST:PORT. Waits for the server to answer. Errors: INVALID_ARGUMENT for an address that is none;
  // UNAVAILABLE saying what was tried, for how long, and why it failed; UNIMPLEMENTED when what answers there is
  // another service.
  static absl::StatusOr<std::unique_ptr<Client>> Connect(const std::string& address, const ClientOptions& options = {});
  // Over a channel that exists, that of a server in this process above all. `name` leads the messages of errors.
  static std::unique_ptr<Client> OverChannel(std::shared_ptr<grpc::Channel> channel, const std::string& name,
                                             const ClientOptions& options = {});
  ~Client();

  absl::StatusOr<ServerInfo> GetServerInfo();

  absl::StatusOr<ModelInfo> UploadModel(absl::Span<const uint8_t> bytes, const UploadOptions& options);
  absl::StatusOr<ModelInfo> GetModel(const std::string& name);
  absl::StatusOr<std::vector<ModelInfo>> ListModels();
  absl::Status DeleteModel(const std::string& name);

  // Each call makes a session of its own.
  absl::StatusOr<Session> CreateSession(const SessionConfig& config);
  absl::StatusOr<Session> GetSession(const std::string& name);
  absl::StatusOr<std::vector<Session>> ListSessions();
  absl::Status DeleteSession(const std::string& name);

  // Feeds the session and delivers its poses until the stream has ended: see track.h.
  absl::StatusOr<TrackSummary> Track(const Session& session, const ChunkSource& source, const TrackCallbacks& callbacks,
                                     const TrackOptions& options = {});

  // Stored poses after `after_pose_seq`, then live ones, in order; `num_skipped` were lost just before them. Ends OK
  // when the session has ended, and CANCELLED when `stop` was requested.
  using PosesCallback = std::function<void(const std::vector<Pose>& poses, uint64_t num_skipped)>;
  absl::Status WatchPoses(const std::string& session, uint64_t after_pose_seq, const PosesCallback& on_poses,
                          std::stop_token stop = {});

 private:
  Client();
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace evpose::client
