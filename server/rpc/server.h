// The whole server in one object: stores, sessions and services behind a listening address, an in-process channel,
// or both. evpose-server and `evpose replay` without --server run the same code.
#pragma once

#include <memory>
#include <string>

#include <grpcpp/channel.h>

#include "absl/status/statusor.h"
#include "absl/time/time.h"

namespace evpose::server {

struct ServerOptions {
  // HOST:PORT; port 0 takes a free one. Empty: no socket, the in-process channel only.
  std::string listen_address = "127.0.0.1:0";
  int worker_threads = 0;  // 0: one per core
  uint32_t max_sessions = 64;
  uint64_t max_model_bytes = 64ull << 20;
  uint32_t max_chunk_bytes = 1u << 20;
  uint64_t credit_bytes = 4ull << 20;  // undecoded bytes a session may have outstanding

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

  // Health turns NOT_SERVING, every stream gets GoAway, then streams still open at the deadline are cancelled.
  // Returns when every reactor has finished. Idempotent.
  virtual void Shutdown(absl::Duration deadline) = 0;
};

}  // namespace evpose::server
