// SPDX-License-Identifier: Apache-2.0
#include "server/connections/listen_address.h"

#include <boost/asio/ip/v6_only.hpp>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace evpose::server {

namespace asio = boost::asio;
using asio::ip::tcp;

std::string ListenAddress::WithPort(int actual_port) const {
  const bool is_ipv6 = absl::StrContains(host, ':');
  return absl::StrCat(is_ipv6 ? "[" : "", host, is_ipv6 ? "]:" : ":", actual_port);
}

bool ListenAddress::IsLoopback() const {
  if (host == "localhost") return true;
  boost::system::error_code error;
  const asio::ip::address address = asio::ip::make_address(host, error);
  return !error && address.is_loopback();
}

absl::StatusOr<ListenAddress> ParseListenAddress(const std::string& text) {
  const auto bad = [&text](const char* why) {
    return absl::InvalidArgumentError(
        absl::StrCat("address \"", text, "\" ", why, "; give HOST:PORT, such as 127.0.0.1:50051"));
  };
  const size_t colon = text.rfind(':');
  if (colon == std::string::npos) return bad("has no port");
  ListenAddress address;
  address.host = text.substr(0, colon);
  if (!absl::SimpleAtoi(text.substr(colon + 1), &address.port) || address.port < 0 || address.port > 65535) {
    return bad("has a port that is no number from 0 to 65535");
  }
  const bool has_brackets = absl::StartsWith(address.host, "[") && absl::EndsWith(address.host, "]");
  if (has_brackets) address.host = address.host.substr(1, address.host.size() - 2);
  if (address.host.empty()) return bad("has no host");
  if (!has_brackets && absl::StrContains(address.host, ':')) return bad("needs brackets around an IPv6 address");
  return address;
}

namespace {

const char* Advice(const boost::system::error_code& error) {
  if (error == asio::error::address_in_use) return "; another program has this port: give another, or 0 for a free one";
  if (error == asio::error::access_denied) return "; give a port of 1024 or above, or 0 for a free one";
  return "";
}

void Listen(const tcp::endpoint& endpoint, tcp::acceptor& acceptor, boost::system::error_code& error) {
  acceptor.open(endpoint.protocol(), error);
  if (!error) acceptor.set_option(asio::socket_base::reuse_address(true), error);  // for connections of a former server
  if (!error) acceptor.set_option(tcp::no_delay(true), error);
  if (!error && endpoint.address().is_v6()) {
    acceptor.set_option(asio::ip::v6_only(!endpoint.address().is_unspecified()), error);
  }
  if (!error) acceptor.native_non_blocking(true, error);
  if (!error) acceptor.bind(endpoint, error);
  if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
}

}  // namespace

absl::StatusOr<std::vector<tcp::acceptor>> ListenOn(asio::io_context& context, const ListenAddress& address) {
  boost::system::error_code error;
  tcp::resolver resolver(context);
  std::vector<tcp::endpoint> endpoints;
  for (const auto& resolved : resolver.resolve(address.host, std::to_string(address.port), error)) {
    endpoints.push_back(resolved.endpoint());
  }
  const bool is_wildcard = !endpoints.empty() && endpoints.front().address().is_unspecified();
  if (is_wildcard) {
    const uint16_t port = endpoints.front().port();
    endpoints = {{asio::ip::address_v6::any(), port}, {asio::ip::address_v4::any(), port}};
  }
  std::vector<tcp::acceptor> acceptors;
  for (tcp::endpoint& endpoint : endpoints) {
    if (is_wildcard && !acceptors.empty()) break;  // the acceptor of IPv6 accepts IPv4, too
    if (!acceptors.empty()) endpoint.port(acceptors.front().local_endpoint().port());
    tcp::acceptor acceptor(context);
    Listen(endpoint, acceptor, error);
    if (!error) acceptors.push_back(std::move(acceptor));
  }
  if (!acceptors.empty()) return acceptors;
  return absl::UnavailableError(
      absl::StrCat("cannot listen on ", address.WithPort(address.port), ": ", error.message(), Advice(error)));
}

}  // namespace evpose::server
