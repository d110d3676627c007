// SPDX-License-Identifier: Apache-2.0

// The other end of a stream of events that does nothing with them: what is left is the transport.
#pragma once

#include <memory>
#include <string>

#include "client/lib/client.h"

namespace evpose::client {

// Speaks the Track protocol on a port of this machine: grants credit for all that it gets, makes no poses, and ends
// with a summary of the bytes received.
class TransportSink {
 public:
  // Errors: UNAVAILABLE when no port can be had.
  static absl::StatusOr<std::unique_ptr<TransportSink>> Start();
  ~TransportSink();

  Client& client() { return *client_; }  // of a connection to it
  static Session session();              // any number of times

 private:
  TransportSink();

  struct Impl;
  std::unique_ptr<Impl> impl_;
  std::unique_ptr<Client> client_;
};

}  // namespace evpose::client
