// SPDX-License-Identifier: Apache-2.0

// tests/monitoring_test.sh reads the page of a server with the parser of Prometheus's Python client.
#include "server/telemetry/open_metrics.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <regex>
#include <sstream>
#include <string>

#include "absl/strings/match.h"
#include "server/telemetry/prometheus_testing.h"
#include "server/telemetry/prometheus_text.h"

namespace evpose::server {
namespace {

using std::chrono::microseconds;
using testing::HasSubstr;

const BuildVersion kBuildWithQuotes = {"1.2.3 \"next\"", "back\\slash\nline"};
const std::string kTraceId = "0af7651916cd43dd8448eb211c80319c";

TEST(OpenMetricsTest, HasTheSameSeriesAndValuesAsPrometheusText) {
  ServerMetrics metrics;
  metrics.decoded_events.Add(9'007'199'254'740'991);
  metrics.pose_latency.Add(microseconds(1500), kTraceId);
  const BuildVersion build = {"1.2.3", "abc"};
  std::string text = OpenMetricsText(metrics, ServerState(), build);
  EXPECT_TRUE(absl::EndsWith(text, "\n# EOF\n"));
  text.resize(text.size() - std::string("# EOF\n").size());
  // The differences between the formats: exemplars, the names of families of counters, and whole bounds.
  text = std::regex_replace(text, std::regex(" # \\{[^\n]*"), "");
  text = std::regex_replace(text, std::regex("# TYPE (\\S+) counter\n# HELP \\S+"),
                            "# TYPE $1_total counter\n# HELP $1_total");
  text = std::regex_replace(text, std::regex("le=\"(\\d+)\\.0\""), "le=\"$1\"");
  const ParsedMetrics open = ParseMetrics(text), plain = ParseMetrics(PrometheusText(metrics, ServerState(), build));
  EXPECT_EQ(open.types, plain.types);
  EXPECT_EQ(open.values, plain.values);
  EXPECT_EQ(open.helps.size(), plain.helps.size());
}

TEST(OpenMetricsTest, BucketsHaveExemplars) {
  ServerMetrics metrics;
  metrics.pose_latency.Add(microseconds(1500));
  metrics.pose_latency.SetExemplar(microseconds(1500), kTraceId,
                                   std::chrono::system_clock::time_point(std::chrono::milliseconds(1'520'879'607'789)));
  const std::string text = OpenMetricsText(metrics, ServerState(), {"1", "2"});
  EXPECT_THAT(text, HasSubstr("# TYPE evpose_pose_latency_seconds histogram\n# HELP evpose_pose_latency_seconds "));
  EXPECT_THAT(text, HasSubstr("evpose_pose_latency_seconds_bucket{le=\"0.001\"} 0\n"));
  EXPECT_THAT(text, HasSubstr("evpose_pose_latency_seconds_bucket{le=\"0.0025\"} 1 # {trace_id=\"" + kTraceId +
                              "\"} 0.0015 1520879607.789\n"));
  EXPECT_THAT(text, HasSubstr("evpose_pose_latency_seconds_bucket{le=\"1.0\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("evpose_pose_latency_seconds_bucket{le=\"+Inf\"} 1\n"
                              "evpose_pose_latency_seconds_sum 0.0015\nevpose_pose_latency_seconds_count 1\n"));
  EXPECT_THAT(text, testing::Not(HasSubstr("_sum 0 #")));
}

TEST(OpenMetricsTest, CountersHaveTheirSuffixInTheirSeriesOnly) {
  const std::string text = OpenMetricsText(ServerMetrics(), ServerState(), {"1", "2"});
  EXPECT_THAT(text, HasSubstr("\n# TYPE evpose_poses counter\n# HELP evpose_poses Computed poses."));
  EXPECT_THAT(text, HasSubstr("\nevpose_poses_total 0\n"));
  EXPECT_THAT(text, HasSubstr("\nevpose_events_dropped_total{reason=\"before_time\"} 0\n"));
}

TEST(OpenMetricsTest, TextIsEscaped) {
  const std::string text = OpenMetricsText(ServerMetrics(), ServerState(), kBuildWithQuotes);
  EXPECT_THAT(text, HasSubstr(R"(evpose_build_info{version="1.2.3 \"next\"",commit="back\\slash\nline"} 1)"));
}

TEST(OpenMetricsTest, IsWrittenForWhoAsksForIt) {
  EXPECT_FALSE(PrefersOpenMetrics(""));
  EXPECT_FALSE(PrefersOpenMetrics("*/*"));
  EXPECT_FALSE(PrefersOpenMetrics("text/plain"));
  EXPECT_FALSE(PrefersOpenMetrics("text/html,application/xhtml+xml,*/*;q=0.8"));
  EXPECT_TRUE(PrefersOpenMetrics("application/openmetrics-text"));
  EXPECT_TRUE(PrefersOpenMetrics("Application/OpenMetrics-Text; version=1.0.0; charset=utf-8"));
  // Prometheus 2.42 and 3.
  EXPECT_TRUE(
      PrefersOpenMetrics("application/openmetrics-text;version=1.0.0,application/openmetrics-text;version=0.0.1;q=0.75,"
                         "text/plain;version=0.0.4;q=0.5,*/*;q=0.1"));
  EXPECT_TRUE(
      PrefersOpenMetrics("application/openmetrics-text;version=1.0.0;escaping=allow-utf-8;q=0.5,application/"
                         "openmetrics-text;version=0.0.1;q=0.4,text/plain;version=1.0.0;q=0.3,*/*;q=0.1"));
  EXPECT_FALSE(PrefersOpenMetrics("application/openmetrics-text;q=0.5,text/plain"));
  EXPECT_FALSE(PrefersOpenMetrics("application/openmetrics-text;q=0"));
  for (const char* nonsense : {",,;;,", "application/openmetrics-text;q=", "application/openmetrics-text;q=nan",
                               "application/openmetrics-text;q=-1", ";q=1"}) {
    EXPECT_FALSE(PrefersOpenMetrics(nonsense)) << nonsense;
  }
}

}  // namespace
}  // namespace evpose::server
