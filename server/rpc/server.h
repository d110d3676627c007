// SPDX-License-Identifier: Apache-2.0

// The whole server in one object: stores, sessions and services behind a listening address, an in-process channel,
// or both. evpose-server and `evpose replay` without --server run the same code.
#pragma once

#include <grpcpp/channel.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/auth/tls_files.h"
#include "server/stores/open_store.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

struct ServerOptions {
  // HOST:PORT; port 0 takes a free one. Empty: no socket, the in-process channel only.
  std::string listen_address = "127.0.0.1:0";
  // Of the socket; the files are read again when they change. None: nothing is encrypted.
  TlsPaths tls;
  // Who may call, as server/auth/token_file.h describes it; read again when it changes. Holds for the in-process
  // channel, too. Empty: with tls.client_ca the CN of a client's certificate is its tenant, otherwise everybody may
  // call.
  std::string token_file;
  // Where sessions and models live; an in-process server needs none that outlives it.
  StoreOptions store;
  // Threads that decode and track; 0: one per core. Sessions share them.
  int worker_threads = 0;
  // Sessions at a time, ended ones included until they are deleted or expire. Each takes at worst credit_bytes plus
  // about 500 bytes for each pose of its log, besides its trackers.
  uint32_t max_sessions = 64;
  // Of one model file.
  uint64_t max_model_bytes = 64ull << 20;
  // Of all model files together, those on their way included: bounds memory.
  uint64_t max_model_store_bytes = 512ull << 20;
  // Of one chunk of events; larger ones only delay acks and poses.
  uint32_t max_chunk_bytes = 1u << 20;
  // Undecoded bytes a session may have outstanding: a second of a busy EVK4; at least max_chunk_bytes.
  uint64_t credit_bytes = 4ull << 20;
  // Poses kept per session for readers and re-attaching streams, about 16 s at 1 kHz; older ones are forgotten. At
  // least 4096: a stream may be 1024 poses behind before its session waits.
  uint32_t pose_log_capacity = 16'384;
  // A session without a stream is deleted after so long: a client that died holds no slot for ever.
  absl::Duration session_expiry = absl::Minutes(10);
  // For streams to finish after AdminService.Drain, when its caller gives no time.
  absl::Duration drain_timeout = absl::Seconds(10);
  // The store is asked so often whether it answers; while it does not, health is NOT_SERVING.
  absl::Duration store_check_period = absl::Seconds(1);
  // Called once, by a thread of gRPC, when a client has asked the server to leave: Shutdown is to be called with this
  // time. It must not block, and not call it itself.
  std::function<void(absl::Duration)> on_drain;

  // Of each tenant; 0: no other limit than the server's own.
  struct TenantLimits {
    uint32_t max_sessions = 0;
    uint64_t max_model_bytes = 0;
    uint32_t max_watchers = 0;
    // Payload of all its Track streams together, over the seconds. A stream that is too fast is read more slowly.
    uint64_t max_bytes_per_s = 0;
  } tenant;
  // A Track stream that has not attached, and an upload whose next message has not come, ends after so long.
  absl::Duration attach_timeout = absl::Seconds(30);
  // Track and Watch streams at a time, each of some 50 kB.
  uint32_t max_streams = 8192;
  // Calls at a time on one connection; a client waits with more.
  uint32_t max_calls_per_connection = 2048;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

class Server {
 public:
  // Takes up the sessions that the store has. Errors: INVALID_ARGUMENT for options; those of OpenStore; those of
  // TlsFiles and TokenFile; UNAVAILABLE naming the address that cannot be listened on and why.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const ServerOptions& options);
  virtual ~Server() = default;  // Shutdown(1 s)

  virtual int port() const = 0;  // 0 without a socket
  virtual std::shared_ptr<grpc::Channel> InProcessChannel() = 0;

  // For those who operate it; at any time, from any thread.
  virtual const ServerMetrics& metrics() const = 0;
  virtual ServerState state() const = 0;

  // Readiness and health turn false, and nothing else changes: whoever shares clients out among servers sends no more
  // here, before Shutdown sends away those that are here.
  virtual void AnnounceShutdown() = 0;
  // Health turns NOT_SERVING, new sessions and streams are refused and every Track stream gets GoAway; streams still
  // open shortly before the deadline end UNAVAILABLE, watchers as soon as no Track stream is left. Returns when every
  // reactor has finished, by the deadline or, if that is less than 3 s away, at most 1.5 s after it; whatever
  // clients do or do not do. Idempotent. Call it from one thread at a time.
  virtual void Shutdown(absl::Duration deadline) = 0;
};

}  // namespace evpose::server
