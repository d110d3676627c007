// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "server/rpc/server.h"

namespace evpose {

// A server in this process, at a free port.
struct LocalServer {
  std::unique_ptr<server::Server> server;
  std::string address;
};

inline LocalServer StartLocalServer(const server::ServerOptions& options = {}) {
  auto server = server::Server::Start(options);
  EXPECT_TRUE(server.ok()) << server.status();
  LocalServer local = {.server = *std::move(server)};
  local.address = "127.0.0.1:" + std::to_string(local.server->port());
  return local;
}

}  // namespace evpose
