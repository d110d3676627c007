// The whole server in one object: stores, sessions and services behind a listening address, an in-process channel,
// or both. evpose-server and `evpose replay` without --server run the same code.
#pragma once

#include <grpcpp/channel.h>

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"

namespace evpose::server {

struct ServerOptions {
  // HOST:PORT; port 0 takes a free one. Empty: no socket, the in-process channel only.
  std::string listen_address = "127.0.0.1:0";
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

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

class Server {
 public:
  // Errors: INVALID_ARGUMENT for options, UNAVAILABLE naming the address that cannot be listened on and why.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const ServerOptions& options);
  virtual ~Server() = default;  // Shutdown(1 s)

  virtual int port() const = 0;  // 0 without a socket
  virtual std::shared_ptr<grpc::Channel> InProcessChannel() = 0;

  // Health turns NOT_SERVING, new sessions and streams are refused and every Track stream gets GoAway; streams still
  // open at the deadline end UNAVAILABLE, watchers as soon as no Track stream is left. Returns when every reactor has
  // finished. Idempotent. Call it from one thread at a time.
  virtual void Shutdown(absl::Duration deadline) = 0;
};

}  // namespace evpose::server
