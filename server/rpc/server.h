// SPDX-License-Identifier: Apache-2.0

// The complete server: store, models, sessions and services behind a listening address, an in-process channel, or both.
// evpose-server and `evpose replay` without --server run the same code.
#pragma once

#include <grpcpp/channel.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/auth/tls_files.h"
#include "server/models/model_preparer.h"
#include "server/sessions/memory/available_memory.h"
#include "server/stores/open_store.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

struct ServerOptions {
  // HOST:PORT; port 0 chooses a free port. Empty: no socket, only the in-process channel.
  std::string listen_address = "127.0.0.1:0";
  // Certificate files for the socket, read again when they change. Empty: no encryption.
  TlsPaths tls;
  // File of tokens (server/auth/token_file.h), read again when it changes. Calls on the in-process channel need a
  // token, too. Empty: with tls.client_ca the CN of a client's certificate is its tenant, otherwise every caller is
  // accepted.
  std::string token_file;
  // Maximum number of connections to the socket; 0: half of the descriptors that the process may have, at most 4096, so
  // that the store and the HTTP pages have the others. Each takes a descriptor and about 15 kB.
  uint32_t max_connections = 0;
  // Maximum number of connections from one IPv4 address or from one network of 64 bits of IPv6; 0: half of all, so that
  // one client cannot take the connections of the others. Behind a proxy all connections have its address.
  uint32_t max_connections_per_peer = 0;
  // The server connects to its own socket; if it accepts no connection for this time, on_stalled is called. Four such
  // connections are made in this time; a busy machine delays them by less than a second.
  absl::Duration listener_timeout = absl::Seconds(10);
  // Called once when the server has stopped accepting connections, which only a restart remedies. It must not block.
  std::function<void()> on_stalled;
  // Memory that gRPC may take for connections and calls, bytes; beyond it, it delays reading and closes connections.
  // Enough for the default of max_streams at 50 kB each, and for a message of a hundred of them at a time. In addition,
  // responses that clients have not read may take a quarter of it, and those of one tenant an eighth.
  uint64_t max_transport_bytes = 512ull << 20;
  // The store of sessions and models. The default, in memory, is enough for an in-process server.
  StoreOptions store;
  // Number of threads that decode and track, shared by all sessions; 0: one per core.
  int worker_threads = 0;
  // Maximum processor seconds per second of a session, averaged over about 0.1 s; 0: no limit. A session at its limit
  // waits, and then its client. One thread at a time processes a session, so that it never uses more than 1.
  double max_session_cpu = 1.0;
  // Maximum number of sessions, including ended ones until they are deleted or expire.
  uint32_t max_sessions = 64;
  // Maximum memory of all sessions together, bytes: each is charged with the most that it may take
  // (server/sessions/memory). Default: 75 % of the memory that the process may take; models, connections and the store
  // have the rest. (evpose-server leaves more to them on a small machine: server/program/session_memory.h.)
  uint64_t max_session_memory = AvailableMemoryBytes() / 4 * 3;
  // Maximum size of a model file, bytes.
  uint64_t max_model_bytes = 64ull << 20;
  // Maximum size of all model files together, including the received bytes of uploads, bytes. Bounds memory.
  uint64_t max_model_store_bytes = 512ull << 20;
  // Number of items of slow work that run at a time, without those that compute for long, and of models that are
  // prepared at a time. Each tenant uses one of them, so with two a tenant waits only while two others are served.
  int slow_threads = 2;
  // Path of evpose-prepare-model, which prepares uploaded models. Empty: the server prepares them in its own threads,
  // without a bound, for a server in the process of its only user.
  std::string model_preparer;
  // Bounds of the preparation of one model; the largest honest meshes take 6 s and 640 MB.
  PreparationBudget model_budget;
  // Maximum number of uploads under way: as many as sessions. Their files are bounded by max_model_store_bytes.
  uint32_t max_uploads = 64;
  // Time within which the file of an upload must arrive: 64 MiB at 5 Mbit/s take 107 s.
  absl::Duration upload_timeout = absl::Seconds(120);
  // Time within which a client must have taken the response of a call; streams have none. The largest response, 4 MB,
  // takes 32 s at 1 Mbit/s.
  absl::Duration response_timeout = absl::Seconds(60);
  // Maximum size of a chunk of events, bytes. Larger chunks would only delay acks and poses.
  uint32_t max_chunk_bytes = 1u << 20;
  // Maximum number of received but undecoded bytes of a session: one second of a busy EVK4. At least max_chunk_bytes.
  uint64_t credit_bytes = 4ull << 20;
  // Number of poses kept for readers and streams that attach again, about 16 s at 1 kHz; older ones are deleted. At
  // least 4096, because a stream may be 1024 poses behind before its session waits.
  uint32_t pose_log_capacity = 16'384;
  // Maximum size of these poses in the store, bytes: the oldest beyond it are deleted, but not the last 4096. The
  // default has room for all of pose_log_capacity, about 150 bytes each, and for 4096 poses with alternatives, which
  // have up to 1 kB each.
  uint64_t pose_log_bytes = 4ull << 20;
  // A session without a stream is deleted after this time, so that a client that has crashed does not occupy a slot
  // forever. This and the other durations are at most a year, which bounds the arithmetic of time points.
  absl::Duration session_expiry = absl::Minutes(10);
  // Time for streams to finish after AdminService.Drain, unless the request has a timeout. Clients need some round
  // trips to attach elsewhere; after it the streams are ended.
  absl::Duration drain_timeout = absl::Seconds(10);
  // Interval of the health checks of the store. While the store does not respond, the server's health is NOT_SERVING. A
  // check costs one small request; a longer interval delays the report of an outage.
  absl::Duration store_check_period = absl::Seconds(1);
  // Whether tenants may watch the events of their sessions (SessionService.WatchEvents).
  bool serves_event_images = true;
  // Called once, by a thread of gRPC, after a call of AdminService.Drain. The program must then call Shutdown() with
  // this duration, but from another thread; the callback must not block.
  std::function<void(absl::Duration)> on_drain;

  // Limits of each tenant; 0 or absent: only the limits of the server apply. (evpose-server replaces absent ones by
  // half of the server's when there may be several tenants: server/program/tenant_limits.h.)
  struct TenantLimits {
    std::optional<uint32_t> max_sessions;
    std::optional<uint64_t> max_session_memory;  // bytes
    std::optional<uint64_t> max_model_bytes;
    std::optional<uint32_t> max_watchers;
    std::optional<uint32_t> max_streams;  // Track and Watch streams
    std::optional<uint32_t> max_uploads;
    // Payload of all Track streams of the tenant together, bytes per second. The server reads faster streams more
    // slowly.
    std::optional<uint64_t> max_bytes_per_s;
    // Messages of all WatchHealth streams of the tenant together, per second; periods are prolonged beyond it.
    // Enough for 1000 readers with the default period; 0: no limit.
    uint32_t max_health_per_s = 1000;
    // Processor seconds per second of all sessions of the tenant together. Without it, tenants share the workers
    // equally while several of them have work.
    std::optional<double> max_cpu;
  } tenant;
  // Time within which a Track stream must attach, and within which the next message of an upload must arrive: longer
  // than the delays of a slow connection, so that only clients that have stopped lose their place.
  absl::Duration attach_timeout = absl::Seconds(30);
  // A Track stream that sends no message for this time ends, so that its session can expire; zero: never. Clients
  // without events send empty chunks at a third of it. Longer than keepalive pings need to detect a broken connection.
  absl::Duration stream_idle_timeout = absl::Seconds(60);
  // Maximum number of Track and Watch streams; each takes about 50 kB.
  uint32_t max_streams = 8192;
  // Maximum number of concurrent calls of a connection; further calls wait at the client.
  uint32_t max_calls_per_connection = 2048;
  // While the workers use more than this part of their time, averaged over some seconds, a tenant that has a session
  // here gets no other (OVERLOADED); 0: no bound. By default there is none, because replays use all time that cameras
  // leave: a server without others beside it would refuse one replay because of another. Behind a load balancer, 0.9
  // leaves time for searches of lost objects and for the sessions of a server that fails.
  double max_load = 0.0;

  // Errors: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Upper bound of durations in options and calls: keeps the arithmetic of time points in range.
constexpr absl::Duration kLongestDuration = absl::Hours(24 * 365);

// Checks the duration of an option: 0 to one year. (absl::Seconds() makes infinity of NaN.) Errors: INVALID_ARGUMENT
// naming the field.
absl::Status CheckDuration(absl::string_view field, absl::Duration duration);

class Server {
 public:
  // Starts a server. It restores a session of its store when a client first uses it.
  // Errors: INVALID_ARGUMENT for the options; those of OpenStore(), TlsFiles and TokenFile; UNAVAILABLE with address
  // and cause when the server cannot listen.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const ServerOptions& options);
  virtual ~Server() = default;  // Shutdown(1 s)

  virtual int port() const = 0;  // 0 without a socket
  virtual std::shared_ptr<grpc::Channel> InProcessChannel() = 0;

  // These are for the operator; they may be called at any time from any thread.
  virtual const ServerMetrics& metrics() const = 0;
  virtual ServerState state() const = 0;
  // ServerState::load_ratio of the latest measurement, at most LoadMonitor::kPeriod ago. Takes no lock.
  virtual double load_ratio() const = 0;

  // Makes the server not ready and its health NOT_SERVING, and changes nothing else, so that load balancers stop
  // sending clients before Shutdown().
  virtual void AnnounceShutdown() = 0;
  // Shuts the server down: health becomes NOT_SERVING, new sessions and streams are rejected, and every Track stream
  // receives GoAway. Streams that are still open shortly before the deadline end with UNAVAILABLE, watchers as soon as
  // no Track stream is left. Returns when all calls have finished: by the deadline or, if it is less than 3 s away, at
  // most 1.5 s after it, independent of the clients; slow work that waits is rejected, and preparations of models and
  // the creation of trackers are ended. Idempotent. To be called from one thread at a time.
  virtual void Shutdown(absl::Duration deadline) = 0;
};

}  // namespace evpose::server
