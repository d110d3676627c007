// SPDX-License-Identifier: Apache-2.0

// Reads the page /metrics of a server.
#pragma once

#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::client {

struct ServerUse {
  double cpu_s = 0.0;        // processor time of the process since its start
  double resident_mb = 0.0;  // 1 MB is 2^20 bytes
  double load_ratio = 0.0;   // evpose_load_ratio
  // Use of the store at the server's last check, up to a second ago. Absent if the store does not report it.
  std::optional<double> store_cpu_s;  // processor time since its start
  std::optional<double> store_mb;     // memory in use, or bytes of the file
};

// `address` is HOST:PORT of --metrics-listen, or http://HOST:PORT/metrics. Errors: INVALID_ARGUMENT for another
// address; UNAVAILABLE if the page cannot be read within seconds or is not that of an evpose-server of this version.
absl::StatusOr<ServerUse> ReadServerUse(const std::string& address);

// The value of a metric without labels in a page in Prometheus's text format. Error: NOT_FOUND.
absl::StatusOr<double> MetricValue(absl::string_view page, absl::string_view name);

}  // namespace evpose::client
