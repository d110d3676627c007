// SPDX-License-Identifier: Apache-2.0

// Formats the metrics of a server in Prometheus's text format, and in that of OpenMetrics, which has exemplars.
#pragma once

#include <string>

#include "absl/strings/string_view.h"
#include "core/base/version.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

inline constexpr char kPrometheusContentType[] = "text/plain; version=0.0.4; charset=utf-8";

// Labels never contain sessions, tenants or client addresses, so that the number of series is constant.
std::string PrometheusText(const ServerMetrics& metrics, const ServerState& state, const BuildVersion& build);

inline constexpr char kOpenMetricsContentType[] = "application/openmetrics-text; version=1.0.0; charset=utf-8";

// The same metrics. The buckets of histograms have exemplars, which name sessions by their trace IDs
// (core/base/trace_context.h).
std::string OpenMetricsText(const ServerMetrics& metrics, const ServerState& state, const BuildVersion& build);

// Whether a client that sends this header Accept, or several that are joined by commas, prefers OpenMetrics.
bool PrefersOpenMetrics(absl::string_view accept);

}  // namespace evpose::server
