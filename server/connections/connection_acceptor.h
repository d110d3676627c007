// SPDX-License-Identifier: Apache-2.0

// Accepts the connections of the server and hands their descriptors to gRPC. The listener of gRPC 1.51 has no limit of
// connections, and it stops for ever when an attempt to accept finds no free descriptor (CVE-2023-4785).
#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/connections/accept_loop.h"
#include "server/connections/connection_ledger.h"
#include "server/connections/listen_address.h"
#include "server/connections/listener_check.h"
#include "server/connections/memory_trimmer.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

class ConnectionAcceptor {
 public:
  struct Options {
    // Maximum number of connections; 0: half of the descriptors that the process may have, at most 4096. The other half
    // is for the store and for the HTTP pages.
    uint32_t max_connections = 0;
    // Maximum number of connections from one address; 0: half of max_connections, so that one client does not take the
    // connections of all others.
    uint32_t max_connections_per_peer = 0;
    // Time without an accepted connection, although the server itself connects, after which on_stalled is called.
    absl::Duration listener_timeout = absl::Seconds(10);
    // Called once, from a thread of the acceptor. It must not block or call Stop().
    std::function<void()> on_stalled = [] {};
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
  };

  // Listens on the address; connections wait until Start(). Errors: those of ListenOn().
  static absl::StatusOr<std::unique_ptr<ConnectionAcceptor>> Listen(const ListenAddress& address, Options options);
  ~ConnectionAcceptor() { Stop(); }

  // `hand_over` receives the non-blocking descriptor of each connection and owns it. It is called on one thread.
  void Start(std::function<void(int descriptor)> hand_over);
  // Closes the listener. Afterwards no connection is handed over. Idempotent.
  void Stop();

  int port() const { return port_; }
  // Thread-safe, as the next one. Includes a connection for up to a second after it was closed.
  size_t num_connections() const { return num_connections_; }
  // OK while connections are accepted, otherwise UNAVAILABLE with the reason.
  absl::Status status() const;

 private:
  explicit ConnectionAcceptor(Options options);
  void Take(int descriptor, const boost::asio::ip::tcp::endpoint& peer);
  void SetShortOfDescriptors(bool is_short);
  void RepeatMaintenance();
  void Maintain();
  void LogRefusals();
  void CheckListener();

  const Options options_;
  boost::asio::io_context context_{1};
  AcceptLoop accept_loop_{context_,
                          {.take = [this](int descriptor, const auto& peer) { Take(descriptor, peer); },
                           .on_no_descriptor = [this] { SetShortOfDescriptors(true); }}};
  std::vector<boost::asio::ip::tcp::acceptor> acceptors_;
  boost::asio::steady_timer maintenance_{context_};
  int port_ = 0;
  std::function<void(int)> hand_over_;
  // Used by the accepting thread only:
  ConnectionLedger ledger_;
  MemoryTrimmer trimmer_;
  uint64_t num_refused_ = 0;
  uint64_t num_logged_refusals_ = 0;
  std::chrono::steady_clock::time_point refusals_logged_at_;

  std::optional<ListenerCheck> check_;
  std::atomic<uint64_t> num_accepted_ = 0;
  std::atomic<size_t> num_connections_ = 0;
  std::atomic<bool> is_short_of_descriptors_ = false;
  std::atomic<ListenerCheck::State> state_ = ListenerCheck::State::kAccepts;
  std::mutex mutex_;
  std::condition_variable stopped_;
  bool is_stopped_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread accepting_;
  std::thread checking_;
};

}  // namespace evpose::server
