// SPDX-License-Identifier: Apache-2.0
#include "server/connections/connection_ledger.h"

#include <sys/stat.h>

#include <algorithm>
#include <iterator>

#include "server/connections/unmapped_address.h"

namespace evpose::server {
namespace {

namespace ip = boost::asio::ip;

// A server at its limit looks for closed connections at most this often: a flood of connections must not cost a look at
// all others for each of them.
constexpr std::chrono::milliseconds kMinRemovalPeriod(100);

// The number of the socket; 0 if the descriptor is closed or refers to something else.
ino_t SocketOf(int descriptor) {
  struct stat status;
  return fstat(descriptor, &status) == 0 && S_ISSOCK(status.st_mode) ? status.st_ino : 0;
}

}  // namespace

ip::address PeerOf(const ip::address& address) {
  const ip::address peer = Unmapped(address);
  if (peer.is_v4()) return peer;
  ip::address_v6::bytes_type network = peer.to_v6().to_bytes();
  std::fill(network.begin() + 8, network.end(), 0);
  return ip::address_v6(network);
}

std::optional<ConnectionRefusal> ConnectionLedger::Add(int descriptor, const ip::address& address) {
  // The descriptor of a new connection may be that of a closed one.
  if (const auto closed = connections_.find(descriptor); closed != connections_.end()) Remove(closed);
  const ip::address peer = PeerOf(address);
  std::optional<ConnectionRefusal> refusal = Limit(peer);
  if (refusal.has_value() && std::chrono::steady_clock::now() - removed_at_ >= kMinRemovalPeriod) {
    RemoveClosed();
    refusal = Limit(peer);
  }
  if (refusal.has_value()) return refusal;
  uint32_t& num_of_peer = num_by_peer_[peer];
  connections_[descriptor] = {SocketOf(descriptor), peer};
  ++num_of_peer;
  return std::nullopt;
}

std::optional<ConnectionRefusal> ConnectionLedger::Limit(const ip::address& peer) const {
  if (connections_.size() >= max_connections_) return ConnectionRefusal::kMaxConnections;
  const auto found = num_by_peer_.find(peer);
  if (found != num_by_peer_.end() && found->second >= max_per_peer_) return ConnectionRefusal::kMaxPerPeer;
  return std::nullopt;
}

size_t ConnectionLedger::RemoveClosed() {
  const size_t num_before = connections_.size();
  for (auto connection = connections_.begin(); connection != connections_.end();) {
    const bool is_open = SocketOf(connection->first) == connection->second.socket;
    connection = is_open ? std::next(connection) : Remove(connection);
  }
  removed_at_ = std::chrono::steady_clock::now();
  return num_before - connections_.size();
}

ConnectionLedger::Connections::iterator ConnectionLedger::Remove(Connections::iterator connection) {
  const auto num = num_by_peer_.find(connection->second.peer);
  if (--num->second == 0) num_by_peer_.erase(num);
  return connections_.erase(connection);
}

}  // namespace evpose::server
