// SPDX-License-Identifier: Apache-2.0

// A peer of the Track protocol that discards all events: it measures the transport alone.
#pragma once

#include <grpcpp/server.h>

#include <memory>
#include <string>

#include "evpose/client.h"

namespace evpose::client {

// Implements the Track protocol on a port of the loopback interface: acknowledges each chunk at once, with the credit
// of evpose-server, sends no poses, and ends with a summary of the bytes received.
class TransportSink {
 public:
  // Error: UNAVAILABLE if no port is available.
  static absl::StatusOr<std::unique_ptr<TransportSink>> Start();
  ~TransportSink();

  Client& client() { return *client_; }  // connected to this sink
  static Session session();              // may be used any number of times

 private:
  TransportSink();

  const std::unique_ptr<grpc::Service> service_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<Client> client_;
};

}  // namespace evpose::client
