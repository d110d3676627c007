// SPDX-License-Identifier: Apache-2.0

// A connection to evpose servers: models, sessions, and the stream of events and poses.
#pragma once

#include <grpcpp/channel.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "absl/types/span.h"
#include "client/lib/track.h"
#include "client/lib/types.h"

namespace evpose::client {

// Encryption. Files are PEM.
struct TlsOptions {
  bool is_on = false;
  std::string ca_file;           // the authorities that a server's certificate may be signed by; empty: the system's
  std::string certificate_file;  // shown to servers that ask for one, with its chain; empty: none
  std::string key_file;          // of that certificate
};

struct ClientOptions {
  absl::Duration connect_timeout = absl::Seconds(10);  // a server may just be starting
  absl::Duration call_timeout = absl::Seconds(60);     // of a single call; loading a large model takes seconds
  TlsOptions tls;
  // Says to the server who calls; a secret. Empty: none. Never sent in clear to another machine.
  std::string token;
  // The token of now, for streams that break long after Connect(). Asked before every call, by several threads at once;
  // while it fails, or says what is no token, the last one serves. Empty: `token` for good.
  std::function<absl::StatusOr<std::string>()> renew_token;
  std::function<bool()> is_cancelled;  // asked while no server answers yet; true: Connect() gives up

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Characters that a token may have; also of none.
bool IsToken(absl::string_view text);

struct UploadOptions {
  ModelFormat format = ModelFormat::kObj;
  double metres_per_unit = 1.0;
};

// Thread-safe. All calls block; statuses have the server's code and a message that begins with the server's address.
class Client {
 public:
  // `addresses` is HOST:PORT, or several with commas between them: servers that share their sessions. Waits for one of
  // them to answer, the first in their order that does; calls go to the one that answered last. Errors:
  // INVALID_ARGUMENT for an address that is none; UNAVAILABLE saying what was tried, for how long, and why it failed;
  // CANCELLED as the options say; UNIMPLEMENTED when what answers there is another service; UNAUTHENTICATED for a token
  // that it does not know; FAILED_PRECONDITION saying what is wrong with certificates, and for a token without TLS on
  // the way to another machine.
  static absl::StatusOr<std::unique_ptr<Client>> Connect(const std::string& addresses,
                                                         const ClientOptions& options = {});
  // Over a channel that exists, that of a server in this process above all. `name` leads the messages of errors.
  static std::unique_ptr<Client> OverChannel(std::shared_ptr<grpc::Channel> channel, const std::string& name,
                                             const ClientOptions& options = {});
  ~Client();

  absl::StatusOr<ServerInfo> GetServerInfo();
  // The server leaves, after `timeout` at the latest; absent: after its own. Answers how many sessions have a stream
  // attached: those that it waits for.
  absl::StatusOr<uint32_t> Drain(std::optional<absl::Duration> timeout = std::nullopt);
  // Of the server's log, until its process ends. Answers the level before.
  absl::StatusOr<LogLevel> SetLogLevel(LogLevel level);

  absl::StatusOr<ModelInfo> UploadModel(absl::Span<const uint8_t> bytes, const UploadOptions& options);
  absl::StatusOr<ModelInfo> GetModel(const std::string& name);
  absl::StatusOr<std::vector<ModelInfo>> ListModels();
  absl::Status DeleteModel(const std::string& name);

  // Each call makes a session of its own; with a `request_id` calls with the same one answer the same session, so that
  // one whose answer was lost can be repeated.
  absl::StatusOr<Session> CreateSession(const SessionConfig& config, const std::string& request_id = "");
  absl::StatusOr<Session> GetSession(const std::string& name);
  absl::StatusOr<std::vector<Session>> ListSessions();
  absl::Status DeleteSession(const std::string& name);

  // Feeds the session and delivers its poses until its summary: see track.h. A stream that breaks is taken up again as
  // options.retry says; then nothing is lost and no pose comes twice. Errors: what the server or the source said last,
  // with how far it came.
  absl::StatusOr<TrackSummary> Track(const Session& session, const ChunkSource& source, const TrackCallbacks& callbacks,
                                     const TrackOptions& options = {});
  // The same for a feed of the caller's, and from any position of a session that is not new. Stops the feed.
  absl::StatusOr<TrackSummary> Track(const TrackPosition& position, EventFeed& feed, const TrackCallbacks& callbacks,
                                     const TrackOptions& options = {});

  // Stored poses after `after_pose_seq`, then live ones, in order; `num_skipped` were lost just before them. Goes on
  // when the session goes to another server on the same store. Ends OK when the session has ended, and CANCELLED when
  // `stop` was requested.
  using PosesCallback = std::function<void(const std::vector<Pose>& poses, uint64_t num_skipped)>;
  absl::Status WatchPoses(const std::string& session, uint64_t after_pose_seq, const PosesCallback& on_poses,
                          std::stop_token stop = {});

 private:
  explicit Client(const ClientOptions& options);
  // Moves `after_pose_seq` on as poses come.
  absl::Status WatchUntilEnd(const std::string& session, uint64_t& after_pose_seq, const PosesCallback& on_poses,
                             const std::stop_token& stop);
  absl::StatusOr<ModelInfo> TryUpload(absl::Span<const uint8_t> bytes, const UploadOptions& options);
  void AddEndpoint(std::shared_ptr<grpc::Channel> channel, const std::string& name);
  // False when the time is over; FAILED_PRECONDITION saying why TLS prevents it.
  absl::StatusOr<bool> WaitForServer();
  bool WaitForServerUntil(absl::Time deadline);

  struct Endpoint;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace evpose::client
