// SPDX-License-Identifier: Apache-2.0
#include "client/bench/metrics_page.h"

#include <sys/socket.h>
#include <unistd.h>

#include <array>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "client/lib/server_address.h"
#include "client/lib/tcp_probe.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr absl::Duration kPageTimeout = absl::Seconds(5);  // a loaded server responds within a second
constexpr size_t kMaxPageBytes = size_t{4} << 20;          // a page has some 50 kB

absl::StatusOr<std::string> ReadPage(const std::string& address) {
  EVPOSE_ASSIGN_OR_RETURN(const ServerAddress parsed, ParseServerAddress(address));
  TcpFailure failure;
  const int socket = ConnectTcp(parsed, kPageTimeout, failure);
  if (socket < 0) return absl::UnavailableError(absl::StrCat(failure.cause, "; ", failure.remedy));
  const absl::Cleanup close_socket = [socket] { close(socket); };
  const std::string request = absl::StrCat("GET /metrics HTTP/1.0\r\nHost: ", address, "\r\n\r\n");
  if (send(socket, request.data(), request.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(request.size())) {
    return absl::UnavailableError("the connection broke");
  }
  std::string page;
  std::array<char, 16384> buffer;
  while (page.size() < kMaxPageBytes) {
    const ssize_t size = recv(socket, buffer.data(), buffer.size(), 0);
    if (size < 0) return absl::UnavailableError("the response did not arrive in time");
    if (size == 0) break;
    page.append(buffer.data(), static_cast<size_t>(size));
  }
  const std::string first = page.substr(0, page.find("\r\n"));
  if (!absl::StrContains(first, " 200 "))
    return absl::UnavailableError(absl::StrCat("the response is \"", first, "\""));
  return page;
}

}  // namespace

absl::StatusOr<double> MetricValue(absl::string_view page, absl::string_view name) {
  for (const absl::string_view line : absl::StrSplit(page, '\n')) {
    double value = 0.0;
    absl::string_view rest = line;
    if (absl::ConsumePrefix(&rest, name) && absl::ConsumePrefix(&rest, " ") && absl::SimpleAtod(rest, &value)) {
      return value;
    }
  }
  return absl::NotFoundError(absl::StrCat("the page has no metric ", name));
}

absl::StatusOr<ServerUse> ReadServerUse(const std::string& address) {
  absl::string_view rest = address;
  absl::ConsumePrefix(&rest, "http://");
  if (!absl::ConsumeSuffix(&rest, "/metrics")) absl::ConsumeSuffix(&rest, "/");
  const std::string host(rest);
  EVPOSE_RETURN_IF_ERROR(ParseServerAddress(host).status());
  const auto read = [&]() -> absl::StatusOr<ServerUse> {
    EVPOSE_ASSIGN_OR_RETURN(const std::string page, ReadPage(host));
    ServerUse use;
    EVPOSE_ASSIGN_OR_RETURN(use.cpu_s, MetricValue(page, "evpose_process_cpu_seconds_total"));
    EVPOSE_ASSIGN_OR_RETURN(use.resident_mb, MetricValue(page, "evpose_process_resident_bytes"));
    use.resident_mb /= 1 << 20;
    EVPOSE_ASSIGN_OR_RETURN(use.load_ratio, MetricValue(page, "evpose_load_ratio"));
    if (const auto cpu_s = MetricValue(page, "evpose_store_cpu_seconds_total"); cpu_s.ok()) use.store_cpu_s = *cpu_s;
    if (const auto bytes = MetricValue(page, "evpose_store_bytes"); bytes.ok()) use.store_mb = *bytes / (1 << 20);
    return use;
  };
  absl::StatusOr<ServerUse> use = read();
  if (use.ok()) return use;
  return absl::UnavailableError(absl::StrCat("http://", host, "/metrics: ", use.status().message(),
                                             "; give --metrics the address of --metrics-listen of the server"));
}

}  // namespace evpose::client
