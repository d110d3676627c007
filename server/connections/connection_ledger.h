// SPDX-License-Identifier: Apache-2.0

// The connections that were accepted and handed to gRPC, which does not report when it closes them.
#pragma once

#include <sys/types.h>

#include <boost/asio/ip/address.hpp>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <unordered_map>

#include "server/telemetry/metrics.h"

namespace evpose::server {

// The address by which connections are counted: an IPv4 address, also one in the form of IPv6, or the first 64 bits of
// an IPv6 address, because a client may use every address of its network.
boost::asio::ip::address PeerOf(const boost::asio::ip::address& address);

// Counts the connections in total and by peer. A connection counts while its descriptor refers to the same socket.
class ConnectionLedger {
 public:
  ConnectionLedger(uint32_t max_connections, uint32_t max_per_peer)
      : max_connections_(max_connections), max_per_peer_(max_per_peer) {}

  // Adds a connection, or returns the limit that forbids it. After a failed allocation the connection is not counted.
  std::optional<ConnectionRefusal> Add(int descriptor, const boost::asio::ip::address& peer);
  // Removes the connections that have been closed. Returns their number.
  size_t RemoveClosed();
  size_t size() const { return connections_.size(); }

 private:
  struct Connection {
    ino_t socket;  // the kernel's number of the socket
    boost::asio::ip::address peer;
  };
  using Connections = std::unordered_map<int, Connection>;
  std::optional<ConnectionRefusal> Limit(const boost::asio::ip::address& peer) const;
  Connections::iterator Remove(Connections::iterator connection);

  const uint32_t max_connections_;
  const uint32_t max_per_peer_;
  Connections connections_;                                   // by descriptor
  std::map<boost::asio::ip::address, uint32_t> num_by_peer_;  // zeros only after failed allocations
  std::chrono::steady_clock::time_point removed_at_;
};

}  // namespace evpose::server
