// SPDX-License-Identifier: Apache-2.0

// A connection to evpose servers: models, sessions, and the stream of events and poses.
#pragma once

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
#include "evpose/track.h"
#include "evpose/types.h"

namespace evpose::client {

// TLS encryption. The files are PEM.
struct TlsOptions {
  bool is_on = false;
  std::string ca_file;           // certificate authorities that are trusted; empty: those of the system
  std::string certificate_file;  // client certificate with its chain, for servers that require one; empty: none
  std::string key_file;          // private key of that certificate
};

struct ClientOptions {
  absl::Duration connect_timeout = absl::Seconds(10);  // the server may be starting
  absl::Duration call_timeout = absl::Seconds(60);     // of one call; loading a large model takes seconds
  TlsOptions tls;
  // Authentication token; a secret. Empty: none. It is never sent unencrypted to another machine.
  std::string token;
  // Returns the current token, for streams that reconnect long after Connect(). Called before every call, from several
  // threads. If it fails or returns an invalid token, the previous token is used. If `token` is empty, Connect() calls
  // it for the first one and returns its error. Empty: `token` is always used.
  std::function<absl::StatusOr<std::string>()> renew_token;
  std::function<bool()> is_cancelled;  // polled while no server responds; true: Connect() ends with CANCELLED

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Returns whether all characters are valid in a token; true for an empty text.
bool IsToken(absl::string_view text);

// Returns a random text for the `request_id` of Client::CreateSession(): 32 hexadecimal digits.
std::string RandomRequestId();

struct UploadOptions {
  ModelFormat format = ModelFormat::kObj;
  double metres_per_unit = 1.0;
  double crease_angle_deg = 30.0;  // edges at which the surface turns by more are lines
  ModelSurface surface = ModelSurface::kSmooth;
  std::string file_name;  // for lists of models; at most 255 bytes of printable UTF-8
};

struct WatchPosesOptions {
  uint64_t after_pose_seq = 0;        // the poses after this one are delivered; 0: all that are stored
  std::optional<double> max_rate_hz;  // limit of the poses per second of sensor time and object; absent: all poses
  // Called when the session has fewer poses than were delivered, or than after_pose_seq: it was resumed from a
  // checkpoint, or its store has lost the last writes. It continues after the pose with this number and computes the
  // same poses again, which are not delivered again. May be empty.
  std::function<void(uint64_t last_pose_seq)> on_rolled_back = {};
};

struct WatchEventsOptions {
  int cell_px = 2;            // width and height of the cells of the images: 1, 2 or 4
  double max_rate_hz = 30.0;  // limit of the images per second; at most 60
};

// Returns the format that the extension of a file name stands for. Error: INVALID_ARGUMENT naming the extensions.
absl::StatusOr<ModelFormat> ModelFormatFromPath(const std::string& path);

// Thread-safe. All calls block. A status has the server's code and a message that begins with the server's address. A
// request of `stop` cancels a call, which then returns CANCELLED unless it has already ended.
class Client {
 public:
  // `addresses` is HOST:PORT, or several of them, separated by commas, of servers that share their sessions. Waits
  // until one of them responds, and prefers the first in the list; later calls go to the server that responded last.
  // When it cannot be reached, shuts down or has lost its store, the next servers are tried in turn, three times each
  // with growing delays: by all calls except Drain() and SetLogLevel(), which are about one server. Track() has its own
  // limit (track.h). A call that is made again after a server became unreachable has the effect of one call.
  // Errors: INVALID_ARGUMENT for an invalid address; UNAVAILABLE with the addresses, the duration and the cause;
  // CANCELLED by the options; UNIMPLEMENTED if the server is another service; UNAUTHENTICATED for an unknown token;
  // FAILED_PRECONDITION for invalid certificates, and for a token without TLS to another machine.
  static absl::StatusOr<std::unique_ptr<Client>> Connect(const std::string& addresses,
                                                         const ClientOptions& options = {});
  ~Client();

  // Returns version, limits and state of the server.
  absl::StatusOr<ServerInfo> GetServerInfo();
  // Shuts the server down when its streams have finished, at the latest after `timeout` (absent: the server's own).
  // Returns the number of sessions with an attached stream, for which the server waits.
  absl::StatusOr<uint32_t> Drain(std::optional<absl::Duration> timeout = std::nullopt);
  // Sets the level of the server's log until its process ends. Returns the previous level.
  absl::StatusOr<LogLevel> SetLogLevel(LogLevel level);

  // Uploads the bytes of a model and waits until the server has prepared it. The name of the model follows from its
  // content: another upload of the same bytes has no effect and returns the same model. Errors: INVALID_ARGUMENT if it
  // cannot be loaded or takes too much processor time or memory; RESOURCE_EXHAUSTED for a limit of the server or
  // tenant.
  absl::StatusOr<ModelInfo> UploadModel(absl::Span<const uint8_t> bytes, const UploadOptions& options);
  // Uploads an OBJ, PLY or STL file. Additional errors name the path: those of reading it, and INVALID_ARGUMENT for
  // another file name extension or for more bytes than the server accepts (ServerInfo::max_model_bytes).
  absl::StatusOr<ModelInfo> UploadModelFile(const std::string& path, double metres_per_unit = 1.0);
  // NOT_FOUND, also for a model of another tenant.
  absl::StatusOr<ModelInfo> GetModel(const std::string& name, const std::stop_token& stop = {});
  // All models of the tenant, by pages.
  absl::StatusOr<std::vector<ModelInfo>> ListModels();
  // Errors: NOT_FOUND; FAILED_PRECONDITION while a session uses the model.
  absl::Status DeleteModel(const std::string& name);
  // Returns the triangles and the edges of a model as the server prepared them. A mesh of more than `max_faces`
  // triangles (at most 100,000; 0: 20,000) is simplified. Additional error: INTERNAL for a geometry that contradicts
  // itself.
  absl::StatusOr<ModelGeometry> GetModelGeometry(const std::string& name, uint32_t max_faces = 0,
                                                 const std::stop_token& stop = {});

  // Each call creates a session. Calls with the same non-empty `request_id` return the same session, so that a call
  // without a response can be repeated. With several servers, an empty one is replaced by a random one, because the
  // call may be made again to another server.
  // A server without room refuses with RESOURCE_EXHAUSTED (OVERLOADED, TOO_MANY_SESSIONS, SESSION_MEMORY,
  // OUT_OF_MEMORY). The next servers are then tried at once. If all refuse, the call is made again after at least the
  // shortest delay of RetryInfo, as long as these delays end within `max_wait` from the start (zero: never); then it
  // returns the last refusal. A refusal without RetryInfo by all servers, and TENANT_QUOTA, are returned at once. If
  // a full server has refused the session, NOT_FOUND for the model from a later server is treated like a refusal: the
  // next server is tried, because models may be stored at some servers only. The default permits several delays of 5 s,
  // which is what evpose-server proposes. A server that has refused is called again on a new connection, for which a
  // load balancer of connections may choose another server; other calls and streams that are under way continue.
  absl::StatusOr<Session> CreateSession(const SessionConfig& config, const std::string& request_id = "",
                                        absl::Duration max_wait = absl::Seconds(30), const std::stop_token& stop = {});
  // NOT_FOUND, also for a session of another tenant.
  absl::StatusOr<Session> GetSession(const std::string& name, const std::stop_token& stop = {});
  // All sessions of the tenant, by pages.
  absl::StatusOr<std::vector<Session>> ListSessions(const std::stop_token& stop = {});
  // Ends the streams of the session and deletes it. OK if there is no such session, unlike DeleteModel(), because the
  // server deletes a session by itself when it expires.
  absl::Status DeleteSession(const std::string& name);

  // Sends the events of the session and delivers its poses until the summary: see track.h. A broken stream is
  // re-established as options.retry specifies; then no event is lost and no pose is delivered twice. Errors: the last
  // error of the server or of the source, with the position.
  absl::StatusOr<TrackSummary> Track(const Session& session, const ChunkSource& source, const TrackCallbacks& callbacks,
                                     const TrackOptions& options = {});
  // Continues a session at a position that on_position reported, in this process or another one. The source returns the
  // events of the session from the start; those before the position are compared with a digest and not sent.
  // Additional error: FAILED_PRECONDITION if they differ from the events of the session.
  absl::StatusOr<TrackSummary> Track(const TrackPosition& position, const ChunkSource& source,
                                     const TrackCallbacks& callbacks, const TrackOptions& options = {});

  // Restarts the tracking of an object from a pose. The Track() of the session must run in this client; the call is
  // possible from any thread.
  // The reset takes effect after the events that the source has returned so far; a source that must decide the exact
  // place returns EventChunk::resets instead. If the session has no such object, the stream ends with INVALID_ARGUMENT.
  // Errors: INVALID_ARGUMENT naming the field; FAILED_PRECONDITION if Track() does not run or the events have ended.
  absl::Status ResetPose(const std::string& session, const PoseReset& reset);

  // Delivers the stored poses after options.after_pose_seq, then live ones, in order; `num_skipped` poses were lost
  // just before those of a call. Follows the session to another server on the same store, and continues at another one
  // of this client when its server is unreachable. Returns OK when the session has ended, and CANCELLED after a request
  // of `stop`. Errors: INVALID_ARGUMENT for a rate that is not positive; DATA_LOSS (ROLLED_BACK) when the store has
  // lost events that the session's writer cannot send again.
  using PosesCallback = std::function<void(const std::vector<Pose>& poses, uint64_t num_skipped)>;
  absl::Status WatchPoses(const std::string& session, const WatchPosesOptions& options, const PosesCallback& on_poses,
                          std::stop_token stop = {});
  // Delivers the health of a session: at once, after each `period`, and when the session has ended. Otherwise as
  // WatchPoses(). Error: INVALID_ARGUMENT for a period below 10 ms.
  using HealthCallback = std::function<void(const SessionHealth& health)>;
  absl::Status WatchHealth(const std::string& session, absl::Duration period, const HealthCallback& on_health,
                           std::stop_token stop = {});
  // Delivers images of the events that the server tracks, at most options.max_rate_hz per second; each contains the
  // events since the end of the one before, also of the images that this reader was too slow for. A server makes them
  // only while somebody watches, and does not store them. Otherwise as WatchPoses(). Errors: INVALID_ARGUMENT naming
  // the option; FAILED_PRECONDITION if the server shows no events, or if none of the servers of this client tracks
  // them.
  using EventsCallback = std::function<void(EventImage image)>;
  absl::Status WatchEvents(const std::string& session, const WatchEventsOptions& options,
                           const EventsCallback& on_image, std::stop_token stop = {});

 private:
  friend struct ClientAccess;
  explicit Client(const ClientOptions& options);

  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace evpose::client
