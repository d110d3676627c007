// SPDX-License-Identifier: Apache-2.0
#include "server/connections/connection_acceptor.h"

#include <fcntl.h>
#include <netinet/tcp.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/connections/owned_descriptor.h"
#include "server/runtime/out_of_memory.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

using boost::asio::ip::tcp;
using std::chrono::steady_clock;

// Largest default of the number of connections, which otherwise is half of the descriptors: bounds the memory for
// connections in a process with very many descriptors.
constexpr uint32_t kMaxDefaultConnections = 4096;
// Connections leave this many descriptors, or a quarter if that is less, to the rest of the process, so that its pages
// and its store keep working.
constexpr rlim_t kReservedDescriptors = 64;
// Short against all timeouts of connections, and rare enough to cost nothing.
constexpr std::chrono::seconds kMaintenancePeriod(1);
// Time between two lines of the log about refused connections, because a flood has many of them.
constexpr std::chrono::minutes kRefusalLogPeriod(1);
// TCP_USER_TIMEOUT, the value that gRPC's own listener sets with keepalive pings: a connection ends if its bytes are
// not acknowledged for this time.
constexpr int kUserTimeoutMs = 20'000;

rlim_t MaxDescriptors() {
  rlimit limit = {};
  return getrlimit(RLIMIT_NOFILE, &limit) == 0 ? limit.rlim_cur : RLIM_INFINITY;
}

// The kernel gives the lowest free number to a new descriptor; so a high number means that few are left.
bool IsReserved(int descriptor) {
  const rlim_t max = MaxDescriptors();
  return static_cast<rlim_t>(descriptor) >= max - std::min(kReservedDescriptors, max / 4);
}

ConnectionAcceptor::Options WithDefaults(ConnectionAcceptor::Options options) {
  if (options.max_connections == 0) {
    options.max_connections =
        static_cast<uint32_t>(std::clamp<rlim_t>(MaxDescriptors() / 2, 1, kMaxDefaultConnections));
  }
  if (options.max_connections_per_peer == 0) {
    options.max_connections_per_peer = std::max(1u, options.max_connections / 2);
  }
  return options;
}

}  // namespace

ConnectionAcceptor::ConnectionAcceptor(Options options)
    : options_(WithDefaults(std::move(options))),
      ledger_(options_.max_connections, options_.max_connections_per_peer) {}

absl::StatusOr<std::unique_ptr<ConnectionAcceptor>> ConnectionAcceptor::Listen(const ListenAddress& address,
                                                                               Options options) {
  std::unique_ptr<ConnectionAcceptor> acceptor(new ConnectionAcceptor(std::move(options)));
  EVPOSE_ASSIGN_OR_RETURN(acceptor->acceptors_, ListenOn(acceptor->context_, address));
  for (tcp::acceptor& listener : acceptor->acceptors_) {
    setsockopt(listener.native_handle(), IPPROTO_TCP, TCP_USER_TIMEOUT, &kUserTimeoutMs, sizeof(kUserTimeoutMs));
  }
  const tcp::endpoint endpoint = acceptor->acceptors_.front().local_endpoint();
  acceptor->port_ = endpoint.port();
  acceptor->check_.emplace(endpoint);
  return acceptor;
}

void ConnectionAcceptor::Start(std::function<void(int)> hand_over) {
  hand_over_ = std::move(hand_over);
  accept_loop_.Start(acceptors_);
  RepeatMaintenance();
  accepting_ = std::thread([this] { accept_loop_.Run(); });
  checking_ = std::thread([this] { CheckListener(); });
}

void ConnectionAcceptor::Stop() {
  {
    const std::lock_guard lock(mutex_);
    is_stopped_ = true;
  }
  stopped_.notify_one();
  context_.stop();
  if (accepting_.joinable()) accepting_.join();
  if (checking_.joinable()) checking_.join();
  acceptors_.clear();
}

absl::Status ConnectionAcceptor::status() const {
  if (is_short_of_descriptors_) {
    return absl::UnavailableError("no connection is accepted: the process has too few descriptors (ulimit -n)");
  }
  if (state_ == ListenerCheck::State::kAccepts) return absl::OkStatus();
  return absl::UnavailableError("the server does not accept its own connections");
}

void ConnectionAcceptor::Take(int descriptor, const tcp::endpoint& peer) {
  ++num_accepted_;
  OwnedDescriptor owned(descriptor);
  if (check_->IsMine(peer)) return;
  std::optional<ConnectionRefusal> refusal = ConnectionRefusal::kDescriptors;
  if (IsReserved(descriptor)) {
    SetShortOfDescriptors(true);
  } else {
    refusal = ledger_.Add(descriptor, peer.address());
  }
  num_connections_ = ledger_.size();
  if (!refusal.has_value()) {
    owned.Release();
    return hand_over_(descriptor);
  }
  options_.metrics->connection_refusals[*refusal].Add();
  ++num_refused_;
}

void ConnectionAcceptor::SetShortOfDescriptors(bool is_short) {
  if (is_short_of_descriptors_.exchange(is_short) == is_short) return;
  if (is_short) {
    Log(LogLevel::kWarning, "descriptors_exhausted",
        {{"message", "not ready until descriptors are free: raise the limit of open files or lower --max-connections"},
         {"limit", MaxDescriptors()},
         {"connections", num_connections()}});
  } else {
    Log(LogLevel::kInfo, "descriptors_free", {{"message", "connections are accepted again"}});
  }
}

void ConnectionAcceptor::RepeatMaintenance() {
  maintenance_.expires_after(kMaintenancePeriod);
  maintenance_.async_wait([this](const boost::system::error_code&) {
    RunUnlessOutOfMemory([this] { Maintain(); });
    RepeatMaintenance();
  });
}

void ConnectionAcceptor::Maintain() {
  trimmer_.Step(ledger_.RemoveClosed());
  num_connections_ = ledger_.size();
  if (is_short_of_descriptors_) {
    const int next = fcntl(acceptors_.front().native_handle(), F_DUPFD_CLOEXEC, 0);
    if (next >= 0 && !IsReserved(next)) SetShortOfDescriptors(false);
    if (next >= 0) close(next);
  }
  if (num_refused_ != num_logged_refusals_ && steady_clock::now() - refusals_logged_at_ >= kRefusalLogPeriod) {
    LogRefusals();
  }
}

void ConnectionAcceptor::LogRefusals() {
  Log(LogLevel::kWarning, "connections_refused",
      {{"message", "a limit of connections is reached; evpose_connections_refused_total has the reasons"},
       {"refused", num_refused_ - num_logged_refusals_},
       {"connections", num_connections()},
       {"max_connections", options_.max_connections},
       {"max_connections_per_peer", options_.max_connections_per_peer}});
  num_logged_refusals_ = num_refused_;
  refusals_logged_at_ = steady_clock::now();
}

void ConnectionAcceptor::CheckListener() {
  const auto period = absl::ToChronoNanoseconds(options_.listener_timeout / ListenerCheck::kStepsToStall);
  bool is_reported = false;
  std::unique_lock lock(mutex_);
  while (!stopped_.wait_for(lock, period, [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return is_stopped_; })) {
    const ListenerCheck::State state = check_->Step(num_accepted_);
    // Without descriptors the connection waits, and the listener will accept it later.
    state_ = is_short_of_descriptors_ ? ListenerCheck::State::kAccepts : state;
    if (state_ != ListenerCheck::State::kStalled || is_reported) continue;
    is_reported = true;
    Log(LogLevel::kError, "listener_stalled",
        {{"message", absl::StrCat("no connection, not even the server's own, has been accepted for ",
                                  absl::FormatDuration(options_.listener_timeout))}});
    options_.on_stalled();
  }
}

}  // namespace evpose::server
