// SPDX-License-Identifier: Apache-2.0
#include "tests/integration/cutting_proxy.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <limits>

namespace evpose {
namespace {

constexpr int kLookMs = 20;  // interval of checks whether the proxy is to end

sockaddr_in Loopback(int port) {
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(static_cast<uint16_t>(port));
  return address;
}

// Closes a connection with a reset; data in transit are lost.
void Cut(int descriptor) {
  const linger hard = {1, 0};
  setsockopt(descriptor, SOL_SOCKET, SO_LINGER, &hard, sizeof(hard));
  close(descriptor);
}

bool SendAll(int descriptor, const char* bytes, size_t size) {
  while (size > 0) {
    const ssize_t sent = send(descriptor, bytes, size, MSG_NOSIGNAL);
    if (sent <= 0) return false;
    bytes += sent;
    size -= static_cast<size_t>(sent);
  }
  return true;
}

}  // namespace

CuttingProxy::CuttingProxy() : listener_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
  sockaddr_in address = Loopback(0);
  socklen_t size = sizeof(address);
  EXPECT_EQ(bind(listener_, reinterpret_cast<sockaddr*>(&address), size), 0);
  EXPECT_EQ(listen(listener_, 16), 0);
  EXPECT_EQ(getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size), 0);
  port_ = ntohs(address.sin_port);
  acceptor_ = std::jthread([this] { Accept(); });
}

CuttingProxy::~CuttingProxy() {
  is_stopped_ = true;
  acceptor_.join();
  connections_.clear();
  close(listener_);
}

void CuttingProxy::CutAfter(const std::vector<uint64_t>& client_bytes) {
  const std::lock_guard lock(mutex_);
  limits_.assign(client_bytes.begin(), client_bytes.end());
}

uint64_t CuttingProxy::TakeLimit() {
  const std::lock_guard lock(mutex_);
  if (limits_.empty()) return std::numeric_limits<uint64_t>::max();
  const uint64_t limit = limits_.front();
  limits_.pop_front();
  return limit;
}

void CuttingProxy::Accept() {
  while (!is_stopped_) {
    pollfd waiting = {listener_, POLLIN, 0};
    if (poll(&waiting, 1, kLookMs) <= 0) continue;
    const int client = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
    if (client < 0) continue;
    if (target_port_ == 0) {
      Cut(client);
      ++num_refused_;
      continue;
    }
    connections_.emplace_back([this, client] { Serve(client); });
  }
}

void CuttingProxy::Serve(int client) {
  const int server = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const sockaddr_in address = Loopback(target_port_);
  bool is_open = connect(server, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0;
  uint64_t left = TakeLimit();
  uint64_t num_sent = 0;
  char buffer[16 * 1024];
  while (is_open && !is_stopped_) {
    const uint64_t held = hold_after_;
    pollfd sides[2] = {{num_sent < held ? client : -1, POLLIN, 0}, {server, POLLIN, 0}};
    if (poll(sides, 2, kLookMs) <= 0) continue;
    for (int i = 0; i < 2 && is_open; ++i) {
      if (sides[i].revents == 0) continue;
      const size_t room = i == 0 ? std::min<uint64_t>({sizeof(buffer), left, held - num_sent}) : sizeof(buffer);
      const ssize_t size = recv(sides[i].fd, buffer, room, 0);
      is_open = size > 0 && SendAll(sides[1 - i].fd, buffer, static_cast<size_t>(size));
      if (i == 1 || !is_open) continue;
      left -= static_cast<uint64_t>(size);
      num_sent += static_cast<uint64_t>(size);
    }
    if (left > 0 || !is_open) continue;
    is_open = false;
    ++num_cut_;
  }
  Cut(client);
  Cut(server);
}

}  // namespace evpose
