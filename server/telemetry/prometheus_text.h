// SPDX-License-Identifier: Apache-2.0

// A server's metrics in Prometheus's text format. Only the .cc file knows Prometheus's library.
#pragma once

#include <string>

#include "core/base/version.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

inline constexpr char kPrometheusContentType[] = "text/plain; version=0.0.4; charset=utf-8";

// No label is of sessions, tenants or peers: the number of lines does not depend on who uses the server.
std::string PrometheusText(const ServerMetrics& metrics, const ServerState& state, const BuildVersion& build);

}  // namespace evpose::server
