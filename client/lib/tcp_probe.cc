// SPDX-License-Identifier: Apache-2.0
#include "client/lib/tcp_probe.h"

#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <memory>
#include <string>
#include <system_error>

#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

TcpFailure DescribeConnectError(int error, const ServerAddress& address, absl::Duration timeout) {
  switch (error) {
    case ECONNREFUSED:
      return {absl::StrCat("nothing listens on port ", address.port, " of ", address.host),
              "start evpose-server there, or give the port of its --listen"};
    case EINPROGRESS:  // the timeout of the socket
    case EAGAIN:
    case ETIMEDOUT:
      return {absl::StrCat(address.host, " does not respond on port ", address.port, " within ",
                           absl::FormatDuration(timeout)),
              "check the address, and whether a firewall drops the connection"};
    case ENETUNREACH:
    case EHOSTUNREACH:
      return {absl::StrCat("there is no route to ", address.host), "check the network of this machine and the address"};
    default:
      return {absl::StrCat(address.host, ", port ", address.port, ": ", std::generic_category().message(error)),
              "check the address and the network"};
  }
}

}  // namespace

int ConnectTcp(const ServerAddress& address, absl::Duration timeout, TcpFailure& failure) {
  addrinfo hints = {};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const int result = getaddrinfo(address.host.c_str(), std::to_string(address.port).c_str(), &hints, &found);
  if (result != 0) {
    failure = {absl::StrCat("the name ", address.host, " has no address: ", gai_strerror(result)),
               "check the spelling of the name, and the name service (DNS) of this machine"};
    return -1;
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> addresses(found, freeaddrinfo);
  const timeval limit = absl::ToTimeval(timeout);
  for (const addrinfo* it = found; it != nullptr; it = it->ai_next) {
    const int fd = socket(it->ai_family, it->ai_socktype | SOCK_CLOEXEC, it->ai_protocol);
    int error = errno;
    if (fd >= 0) {
      setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof(limit));
      setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof(limit));  // also limits connect()
      if (connect(fd, it->ai_addr, it->ai_addrlen) == 0) return fd;
      error = errno;
      close(fd);
    }
    failure = DescribeConnectError(error, address, timeout);
  }
  return -1;
}

std::optional<TcpFailure> ExplainUnreachable(const std::string& address, absl::Duration timeout) {
  const auto parsed = ParseServerAddress(address);
  if (!parsed.ok()) return TcpFailure{std::string(parsed.status().message()), "give HOST:PORT"};
  TcpFailure failure;
  const int fd = ConnectTcp(*parsed, timeout, failure);
  if (fd < 0) return failure;
  close(fd);
  return std::nullopt;
}

}  // namespace evpose::client
