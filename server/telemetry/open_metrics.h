// SPDX-License-Identifier: Apache-2.0

// Writes metric families in the text format of OpenMetrics 1.0, which has exemplars
// (https://prometheus.io/docs/specs/om/open_metrics_spec). Debian's Prometheus library writes only the older format.
#pragma once

#include <prometheus/metric_family.h>

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "server/telemetry/metrics.h"

namespace evpose::server {

// Exemplars by bucket; all absent for families that are no histograms.
using BucketExemplars = std::array<std::optional<Exemplar>, DurationHistogram::kNumBuckets>;

// `exemplars`: one element for each family. Families are counters with names in "_total", gauges and histograms with
// one series.
std::string OpenMetricsOf(const std::vector<prometheus::MetricFamily>& families,
                          const std::vector<BucketExemplars>& exemplars);

}  // namespace evpose::server
