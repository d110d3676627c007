// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/listen_address.h"

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace evpose::server {

namespace asio = boost::asio;

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
    return absl::InvalidArgumentError(absl::StrCat("address \"", text, "\" ", why, "; give HOST:PORT, as 127.0.0.1:0"));
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

}  // namespace

absl::Status ProbeListenAddress(const ListenAddress& address) {
  const std::string what = address.WithPort(address.port);
  boost::system::error_code error;
  asio::io_context context;
  asio::ip::tcp::resolver resolver(context);
  const auto endpoints = resolver.resolve(address.host, std::to_string(address.port), error);
  if (error) return absl::UnavailableError(absl::StrCat("cannot listen on ", what, ": ", error.message()));
  for (const auto& endpoint : endpoints) {
    asio::ip::tcp::acceptor acceptor(context);
    acceptor.open(endpoint.endpoint().protocol(), error);
    if (!error) acceptor.bind(endpoint.endpoint(), error);
    if (!error) acceptor.listen(1, error);
    if (error) {
      return absl::UnavailableError(absl::StrCat("cannot listen on ", what, ": ", error.message(), Advice(error)));
    }
  }
  return absl::OkStatus();
}

}  // namespace evpose::server
