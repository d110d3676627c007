// SPDX-License-Identifier: Apache-2.0

// IPv4 addresses in the form of IPv6.
#pragma once

#include <boost/asio/ip/address.hpp>

namespace evpose::server {

// Returns an IPv4 address that is mapped to IPv6 (::ffff:1.2.3.4) as IPv4, and any other address unchanged. Sockets
// that accept both report the addresses of IPv4 clients in the mapped form.
inline boost::asio::ip::address Unmapped(const boost::asio::ip::address& address) {
  if (address.is_v4() || !address.to_v6().is_v4_mapped()) return address;
  return boost::asio::ip::make_address_v4(boost::asio::ip::v4_mapped, address.to_v6());
}

}  // namespace evpose::server
