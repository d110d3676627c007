// SPDX-License-Identifier: Apache-2.0

// Formats the metrics of a server in Prometheus's text format. Only the .cc file uses Prometheus's library.
#pragma once

#include <string>

#include "core/base/version.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

inline constexpr char kPrometheusContentType[] = "text/plain; version=0.0.4; charset=utf-8";

// Labels never contain sessions, tenants or client addresses, so that the number of series is constant.
std::string PrometheusText(const ServerMetrics& metrics, const ServerState& state, const BuildVersion& build);

}  // namespace evpose::server
