// SPDX-License-Identifier: Apache-2.0

// One of the servers of a client, and the connection to it. Internal, because it includes generated headers.
#pragma once

#include <grpcpp/channel.h>

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

// A channel with the stubs that use it.
struct Connection {
  explicit Connection(std::shared_ptr<grpc::Channel> to);

  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<v1::AdminService::StubInterface> admin;
  std::unique_ptr<v1::ModelService::StubInterface> models;
  std::unique_ptr<v1::SessionService::StubInterface> sessions;
};

// An address of a client. A load balancer of connections, such as a Service of Kubernetes, may choose another server
// for each connection to it. Thread-safe.
class Endpoint {
 public:
  using ChannelMaker = std::function<std::shared_ptr<grpc::Channel>()>;

  // `name` is the prefix of error messages. `make_channel` returns a further channel, which shares no connection with
  // others, or null if none can be made; empty: `channel` remains the only one.
  Endpoint(std::string name, std::shared_ptr<grpc::Channel> channel, ChannelMaker make_channel = {});

  const std::string name;
  // Returns the present connection. A call keeps it until the call has ended.
  std::shared_ptr<const Connection> connection() const;
  // Starts another connection attempt if the last one failed, and blocks until the channel is connected or a stop is
  // requested. It blocks for at most 1 s if the client has one server, and for at most 0.1 s if it has several.
  void ConnectAgain(size_t num_servers, const std::stop_token& stop) const;
  // As ConnectAgain(), also if no attempt has failed. Blocks for at most `longest`, and returns whether the channel is
  // connected.
  bool ConnectNow(absl::Duration longest, const std::stop_token& stop) const;
  // Informs the endpoint that a server has refused a session or a stream because it has no room for it.
  void NoteRefusal() { has_refused_ = true; }
  // If a server has refused a session or a stream since the last call, replaces the connection by a new one, for which
  // a load balancer may choose a server with room. Blocks until it is connected, or a stop is requested, for at most
  // 1 s. If it is not connected then, the former connection remains.
  void LeaveAfterRefusal(const std::stop_token& stop);

 private:
  const ChannelMaker make_channel_;
  std::atomic<bool> has_refused_ = false;
  mutable std::mutex mutex_;
  std::shared_ptr<const Connection> connection_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client
