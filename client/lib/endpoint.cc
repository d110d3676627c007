// SPDX-License-Identifier: Apache-2.0
#include "client/lib/endpoint.h"

#include <utility>

#include "client/lib/channel.h"

namespace evpose::client {
namespace {

// Longest wait for the connection to one server when there are others to try.
constexpr absl::Duration kConnectionWait = absl::Milliseconds(100);
// The same for the only server: a few round trips of a long link, as TLS needs them. Also for a new connection to a
// server that has just responded.
constexpr absl::Duration kOnlyConnectionWait = absl::Seconds(1);

}  // namespace

Connection::Connection(std::shared_ptr<grpc::Channel> to)
    : channel(std::move(to)),
      admin(v1::AdminService::NewStub(channel)),
      models(v1::ModelService::NewStub(channel)),
      sessions(v1::SessionService::NewStub(channel)) {}

Endpoint::Endpoint(std::string of, std::shared_ptr<grpc::Channel> channel, ChannelMaker make_channel)
    : name(std::move(of)),
      make_channel_(std::move(make_channel)),
      connection_(std::make_shared<const Connection>(std::move(channel))) {}

std::shared_ptr<const Connection> Endpoint::connection() const {
  const std::lock_guard lock(mutex_);
  return connection_;
}

void Endpoint::ConnectAgain(size_t num_servers, const std::stop_token& stop) const {
  if (connection()->channel->GetState(/*try_to_connect=*/false) != GRPC_CHANNEL_TRANSIENT_FAILURE) return;
  ConnectNow(num_servers == 1 ? kOnlyConnectionWait : kConnectionWait, stop);
}

bool Endpoint::ConnectNow(absl::Duration longest, const std::stop_token& stop) const {
  return client::ConnectNow(*connection()->channel, longest, stop);
}

void Endpoint::LeaveAfterRefusal(const std::stop_token& stop) {
  if (!make_channel_ || !has_refused_.exchange(false)) return;
  std::shared_ptr<grpc::Channel> channel = make_channel_();
  if (channel == nullptr || !client::ConnectNow(*channel, kOnlyConnectionWait, stop)) return;
  auto fresh = std::make_shared<const Connection>(std::move(channel));
  const std::lock_guard lock(mutex_);
  connection_ = std::move(fresh);
}

}  // namespace evpose::client
