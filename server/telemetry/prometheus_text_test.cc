// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/prometheus_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <string>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/telemetry/prometheus_testing.h"

namespace evpose::server {
namespace {

using std::chrono::microseconds;

const BuildVersion kBuild = {"1.2.3", "abc1234"};

// Names follow Prometheus's guidelines: the prefix evpose_, base units, and "_total" for counters only.
TEST(PrometheusTextTest, NamesTypesAndHelpsAreInOrder) {
  const ParsedMetrics parsed = ParseMetrics(PrometheusText(ServerMetrics(), ServerState(), kBuild));
  EXPECT_GT(parsed.types.size(), 25u);
  for (const auto& [name, type] : parsed.types) {
    EXPECT_TRUE(absl::StartsWith(name, "evpose_")) << name;
    EXPECT_EQ(absl::EndsWith(name, "_total"), type == "counter") << name;
    EXPECT_THAT(type, testing::AnyOf("counter", "gauge", "histogram")) << name;
    EXPECT_EQ(parsed.helps.count(name), 1u) << name;
    EXPECT_TRUE(type != "histogram" || absl::EndsWith(name, "_seconds")) << name;
    EXPECT_FALSE(absl::StrContains(name, "_us") || absl::StrContains(name, "_ms")) << name;
  }
  EXPECT_EQ(parsed.types.size(), parsed.helps.size());
}

TEST(PrometheusTextTest, AFreshServerHasEverySeriesAtZero) {
  const ParsedMetrics parsed = ParseMetrics(PrometheusText(ServerMetrics(), ServerState(), kBuild));
  for (const auto& [series, value] : parsed.values) {
    const bool is_one = absl::StartsWith(series, "evpose_build_info") || series == "evpose_ready";
    EXPECT_EQ(value, is_one ? 1.0 : 0.0) << series;
  }
  EXPECT_EQ(parsed.At("evpose_build_info{version=\"1.2.3\",commit=\"abc1234\"}"), 1.0);
}

template <typename Phase, typename Input>
bool IsTransition(int from, int to, int num_inputs) {
  for (int input = 0; input < num_inputs; ++input) {
    const Phase next = NextPhase(static_cast<Phase>(from), static_cast<Input>(input));
    if (from != to && next == static_cast<Phase>(to)) return true;
  }
  return false;
}

std::string TransitionSeries(const char* kind, std::string_view from, std::string_view to) {
  return absl::StrCat("evpose_", kind, "_transitions_total{from=\"", absl::AsciiStrToLower(std::string(from)),
                      "\",to=\"", absl::AsciiStrToLower(std::string(to)), "\"}");
}

// Gives each counter another value, and keeps the series in which it must appear.
class CounterSeries {
 public:
  CounterSeries() {
    CountWork();
    CountTransitions();
    CountStreams();
    CountRefusals();
  }

  const ServerMetrics& metrics() const { return metrics_; }
  const std::map<std::string, double>& expected() const { return expected_; }

 private:
  void Count(Counter& counter, const std::string& series, uint64_t unit = 1) {
    counter.Add(++next_ * unit);
    expected_[series] = static_cast<double>(next_);
  }

  void CountWork() {
    Count(metrics_.received_bytes, "evpose_received_bytes_total");
    Count(metrics_.decoded_events, "evpose_events_decoded_total");
    Count(metrics_.skipped_events[DropReason::kLag], "evpose_events_skipped_total{reason=\"lag\"}");
    Count(metrics_.skipped_events[DropReason::kMemory], "evpose_events_skipped_total{reason=\"memory\"}");
    Count(metrics_.skipped_events[DropReason::kReader], "evpose_events_skipped_total{reason=\"reader\"}");
    Count(metrics_.events_before_time, "evpose_events_dropped_total{reason=\"before_time\"}");
    Count(metrics_.events_outside_sensor, "evpose_events_dropped_total{reason=\"outside_sensor\"}");
    Count(metrics_.unknown_words, "evpose_invalid_words_total{reason=\"unknown\"}");
    Count(metrics_.broken_vectors, "evpose_invalid_words_total{reason=\"broken_vector\"}");
    Count(metrics_.poses, "evpose_poses_total");
    Count(metrics_.track_losses, "evpose_track_losses_total");
    Count(metrics_.reinitializations, "evpose_reinitializations_total");
    Count(metrics_.reattaches, "evpose_reattaches_total");
    Count(metrics_.falls_behind, "evpose_falls_behind_total");
    Count(metrics_.processing_ns, "evpose_processing_seconds_total", 1'000'000'000);
    Count(metrics_.sensor_time_us, "evpose_sensor_seconds_total", 1'000'000);
    Count(metrics_.checkpoint_failures[CheckpointFailure::kStoreUnavailable],
          "evpose_checkpoint_failures_total{reason=\"store_away\"}");
    Count(metrics_.checkpoint_failures[CheckpointFailure::kStoreFull],
          "evpose_checkpoint_failures_total{reason=\"store_full\"}");
    Count(metrics_.checkpoint_failures[CheckpointFailure::kFenced],
          "evpose_checkpoint_failures_total{reason=\"fenced\"}");
    Count(metrics_.checkpoint_failures[CheckpointFailure::kRolledBack],
          "evpose_checkpoint_failures_total{reason=\"rolled_back\"}");
    Count(metrics_.checkpoint_failures[CheckpointFailure::kStoreFailed],
          "evpose_checkpoint_failures_total{reason=\"store_failed\"}");
    Count(metrics_.commit_bytes[CommitPart::kCheckpoint], "evpose_commit_bytes_total{part=\"checkpoint\"}");
    Count(metrics_.commit_bytes[CommitPart::kPoses], "evpose_commit_bytes_total{part=\"poses\"}");
    Count(metrics_.commit_bytes[CommitPart::kLifecycle], "evpose_commit_bytes_total{part=\"lifecycle\"}");
    Count(metrics_.quota_delays, "evpose_quota_delays_total");
    Count(metrics_.overload_refusals, "evpose_overload_refusals_total");
    Count(metrics_.event_images, "evpose_event_images_total");
    Count(metrics_.skipped_event_images, "evpose_event_images_skipped_total");
    expected_["evpose_out_of_memory_total"] = 0.0;               // of the process
    expected_["evpose_process_cpu_seconds_total"] = 0.0;         // in ServerState
    expected_["evpose_store_unreplicated_commits_total"] = 0.0;  // likewise
  }

  void CountTransitions() {
    for (int from = 0; from < kNumObjectPhases; ++from) {
      for (int to = 0; to < kNumObjectPhases; ++to) {
        if (!IsTransition<ObjectPhase, ObjectInput>(from, to, kNumObjectInputs)) continue;
        const auto before = static_cast<ObjectPhase>(from), after = static_cast<ObjectPhase>(to);
        Count(metrics_.object_transitions[before][after],
              TransitionSeries("object", ObjectPhaseName(before), ObjectPhaseName(after)));
      }
    }
    for (int from = 0; from < kNumTrackPhases; ++from) {
      for (int to = 0; to < kNumTrackPhases; ++to) {
        if (!IsTransition<TrackPhase, TrackInput>(from, to, kNumTrackInputs)) continue;
        const auto before = static_cast<TrackPhase>(from), after = static_cast<TrackPhase>(to);
        Count(metrics_.track_transitions[before][after],
              TransitionSeries("track", TrackPhaseName(before), TrackPhaseName(after)));
      }
    }
  }

  void CountStreams() {
    for (int i = 0; i <= 16; ++i) {
      const auto code = static_cast<absl::StatusCode>(i);
      const std::string label = absl::StrCat("code=\"", absl::StatusCodeToString(code), "\"}");
      Count(metrics_.stream_ends[StreamKind::kTrack][code],
            absl::StrCat("evpose_stream_ends_total{stream=\"track\",", label));
      Count(metrics_.stream_ends[StreamKind::kWatch][code],
            absl::StrCat("evpose_stream_ends_total{stream=\"watch\",", label));
    }
  }

  void CountRefusals() {
    const std::pair<QuotaLimit, const char*> limits[] = {{QuotaLimit::kMaxSessions, "max_sessions"},
                                                         {QuotaLimit::kMaxStreams, "max_streams"},
                                                         {QuotaLimit::kMaxModelStoreBytes, "max_model_store_bytes"},
                                                         {QuotaLimit::kTenantSessions, "tenant_sessions"},
                                                         {QuotaLimit::kTenantModelBytes, "tenant_model_bytes"},
                                                         {QuotaLimit::kTenantWatchers, "tenant_watchers"},
                                                         {QuotaLimit::kSessionMemory, "session_memory"},
                                                         {QuotaLimit::kTenantSessionMemory, "tenant_session_memory"},
                                                         {QuotaLimit::kTenantStreams, "tenant_streams"},
                                                         {QuotaLimit::kMaxUploads, "max_uploads"},
                                                         {QuotaLimit::kTenantUploads, "tenant_uploads"},
                                                         {QuotaLimit::kTenantResponses, "tenant_responses"}};
    for (const auto& [limit, name] : limits) {
      Count(metrics_.quota_refusals[limit], absl::StrCat("evpose_quota_refusals_total{limit=\"", name, "\"}"));
    }
    const std::pair<AuthenticationFailure, const char*> failures[] = {
        {AuthenticationFailure::kNoToken, "no_token"},
        {AuthenticationFailure::kBadToken, "bad_token"},
        {AuthenticationFailure::kBadCertificate, "bad_certificate"}};
    for (const auto& [failure, name] : failures) {
      Count(metrics_.authentication_failures[failure],
            absl::StrCat("evpose_authentication_failures_total{reason=\"", name, "\"}"));
    }
    const std::pair<ConnectionRefusal, const char*> refusals[] = {
        {ConnectionRefusal::kMaxConnections, "max_connections"},
        {ConnectionRefusal::kMaxPerPeer, "max_connections_per_peer"},
        {ConnectionRefusal::kDescriptors, "descriptors"}};
    for (const auto& [refusal, name] : refusals) {
      Count(metrics_.connection_refusals[refusal],
            absl::StrCat("evpose_connections_refused_total{limit=\"", name, "\"}"));
    }
  }

  ServerMetrics metrics_;
  uint64_t next_ = 0;
  std::map<std::string, double> expected_;
};

TEST(PrometheusTextTest, EveryCounterHasItsOwnSeries) {
  const CounterSeries series;
  const ParsedMetrics parsed = ParseMetrics(PrometheusText(series.metrics(), ServerState(), kBuild));
  for (const auto& [name, value] : series.expected()) EXPECT_NEAR(parsed.At(name), value, 1e-9 * value) << name;
  size_t num_counters = 0;
  for (const auto& [name, value] : parsed.values) {
    num_counters += parsed.types.count(name.substr(0, name.find('{'))) == 1 &&
                    parsed.types.at(name.substr(0, name.find('{'))) == "counter";
  }
  EXPECT_EQ(num_counters, series.expected().size()) << "this test does not cover a counter";
}

TEST(PrometheusTextTest, LargeCountsKeepTheirDigits) {
  ServerMetrics metrics;
  metrics.decoded_events.Add(9'007'199'254'740'991);  // 2^53 - 1: doubles represent every integer up to it
  EXPECT_THAT(PrometheusText(metrics, ServerState(), kBuild),
              testing::HasSubstr("\nevpose_events_decoded_total 9007199254740991\n"));
}

TEST(PrometheusTextTest, HistogramsAreCumulativeAndAddUp) {
  ServerMetrics metrics;
  const int64_t durations_us[] = {-3, 10, 11, 250, 251, 999'999, 10'000'000, 10'000'001, 60'000'000};
  for (const int64_t duration_us : durations_us) metrics.pose_latency.Add(microseconds(duration_us));
  const ParsedMetrics parsed = ParseMetrics(PrometheusText(metrics, ServerState(), kBuild));
  const auto bucket = [&parsed](const std::string& bound) {
    return parsed.At(absl::StrCat("evpose_pose_latency_seconds_bucket{le=\"", bound, "\"}"));
  };
  EXPECT_EQ(bucket("1e-05"), 2.0) << "a bound belongs to its bucket";
  EXPECT_EQ(bucket("0.00025"), 4.0);
  EXPECT_EQ(bucket("0.0005"), 5.0);
  EXPECT_EQ(bucket("1"), 6.0);
  EXPECT_EQ(bucket("10"), 7.0);
  EXPECT_EQ(bucket("+Inf"), 9.0);
  EXPECT_EQ(parsed.At("evpose_pose_latency_seconds_count"), 9.0);
  EXPECT_NEAR(parsed.At("evpose_pose_latency_seconds_sum"), 1e-6 * (10 + 11 + 250 + 251 + 999'999 + 80'000'001), 1e-9);
}

TEST(PrometheusTextTest, EveryHistogramHasItsOwnFamily) {
  ServerMetrics metrics;
  const std::pair<DurationHistogram*, const char*> histograms[] = {
      {&metrics.turn_time, "evpose_turn_seconds"},
      {&metrics.pose_latency, "evpose_pose_latency_seconds"},
      {&metrics.decode_time, "evpose_decode_duration_seconds"},
      {&metrics.track_time, "evpose_track_duration_seconds"},
      {&metrics.initialization_time, "evpose_initialization_duration_seconds"},
      {&metrics.checkpoint_time, "evpose_checkpoint_duration_seconds"}};
  int times = 0;
  for (const auto& [histogram, name] : histograms) {
    ++times;
    for (int i = 0; i < times; ++i) histogram->Add(microseconds(1));
  }
  const ParsedMetrics parsed = ParseMetrics(PrometheusText(metrics, ServerState(), kBuild));
  times = 0;
  for (const auto& [histogram, name] : histograms) EXPECT_EQ(parsed.At(absl::StrCat(name, "_count")), ++times) << name;
}

TEST(PrometheusTextTest, GaugesShowTheState) {
  ServerState state;
  state.sessions = {.attached = 1,
                    .detached = 2,
                    .ended = 3,
                    .closed = 4,
                    .objects = {5, 6, 7, 8, 9},
                    .queued_bytes = 9,
                    .oldest_queue_age_us = 1'500'000};
  state.max_sessions = 10;
  state.num_workers = 11;
  state.session_memory_bytes = 12;
  state.max_session_memory_bytes = 13;
  state.num_tokens = 0;
  state.store_bytes = 12;
  state.unreplicated_commits = 16;
  state.sessions.image_watchers = 14;
  state.connections = 12;
  state.load_ratio = 0.25;
  state.process_cpu_s = 2.5;
  state.process_resident_bytes = 15;
  state.listening = absl::UnavailableError("secret");
  state.readiness = absl::UnavailableError("secret");
  const std::string text = PrometheusText(ServerMetrics(), state, kBuild);
  const ParsedMetrics parsed = ParseMetrics(text);
  EXPECT_EQ(parsed.At("evpose_load_ratio"), 0.25);
  EXPECT_EQ(parsed.At("evpose_process_cpu_seconds_total"), 2.5);
  EXPECT_EQ(parsed.At("evpose_process_resident_bytes"), 15.0);
  EXPECT_EQ(parsed.At("evpose_sessions{state=\"attached\"}"), 1.0);
  EXPECT_EQ(parsed.At("evpose_sessions{state=\"detached\"}"), 2.0);
  EXPECT_EQ(parsed.At("evpose_sessions{state=\"ended\"}"), 3.0);
  EXPECT_EQ(parsed.At("evpose_sessions{state=\"closed\"}"), 4.0);
  EXPECT_EQ(parsed.At("evpose_objects{state=\"initializing\"}"), 5.0);
  EXPECT_EQ(parsed.At("evpose_objects{state=\"tracking\"}"), 6.0);
  EXPECT_EQ(parsed.At("evpose_objects{state=\"degraded\"}"), 7.0);
  EXPECT_EQ(parsed.At("evpose_objects{state=\"ambiguous\"}"), 9.0);
  EXPECT_EQ(parsed.At("evpose_objects{state=\"lost\"}"), 8.0);
  EXPECT_EQ(parsed.At("evpose_queue_bytes"), 9.0);
  EXPECT_EQ(parsed.At("evpose_queue_age_seconds"), 1.5);
  EXPECT_EQ(parsed.At("evpose_event_image_watchers"), 14.0);
  EXPECT_EQ(parsed.At("evpose_max_sessions"), 10.0);
  EXPECT_EQ(parsed.At("evpose_workers"), 11.0);
  EXPECT_EQ(parsed.At("evpose_session_memory_bytes"), 12.0);
  EXPECT_EQ(parsed.At("evpose_session_memory_limit_bytes"), 13.0);
  EXPECT_EQ(parsed.At("evpose_connections"), 12.0);
  EXPECT_EQ(parsed.At("evpose_listener_stalled"), 1.0);
  EXPECT_EQ(parsed.At("evpose_ready"), 0.0);
  EXPECT_EQ(parsed.At("evpose_tokens"), 0.0);
  EXPECT_EQ(parsed.At("evpose_store_bytes"), 12.0);
  EXPECT_EQ(parsed.At("evpose_store_unreplicated_commits_total"), 16.0);
  EXPECT_EQ(parsed.types.count("evpose_store_max_bytes"), 0u) << "there is no limit";
  EXPECT_EQ(parsed.types.count("evpose_store_cpu_seconds_total"), 0u) << "the store reports none";
  state.store_cpu_s = 1.25;
  EXPECT_EQ(ParseMetrics(PrometheusText(ServerMetrics(), state, kBuild)).At("evpose_store_cpu_seconds_total"), 1.25);
  EXPECT_THAT(text, testing::Not(testing::HasSubstr("secret")));
}

TEST(PrometheusTextTest, AStoreWithSeveralGroupsHasTheirState) {
  ServerState state;
  state.store_groups = {{.name = "a",
                         .health = absl::OkStatus(),
                         .usage = StoreUsage{.bytes = 5, .max_bytes = 10, .cpu_s = 2.5},
                         .parts = 128,
                         .commits = 3,
                         .commit_s = 0.5,
                         .unreplicated_commits = 2},
                        {.name = "b", .health = absl::UnavailableError("secret")}};
  const std::string text = PrometheusText(ServerMetrics(), state, kBuild);
  const ParsedMetrics parsed = ParseMetrics(text);
  EXPECT_EQ(parsed.At("evpose_store_group_up{group=\"a\"}"), 1.0);
  EXPECT_EQ(parsed.At("evpose_store_group_up{group=\"b\"}"), 0.0);
  EXPECT_EQ(parsed.At("evpose_store_group_buckets{group=\"a\"}"), 128.0);
  EXPECT_EQ(parsed.At("evpose_store_group_bytes{group=\"a\"}"), 5.0);
  EXPECT_EQ(parsed.At("evpose_store_group_max_bytes{group=\"a\"}"), 10.0);
  EXPECT_EQ(parsed.At("evpose_store_group_cpu_seconds_total{group=\"a\"}"), 2.5);
  EXPECT_EQ(parsed.At("evpose_store_group_commits_total{group=\"a\"}"), 3.0);
  EXPECT_EQ(parsed.At("evpose_store_group_commit_seconds_total{group=\"a\"}"), 0.5);
  EXPECT_EQ(parsed.At("evpose_store_group_unreplicated_commits_total{group=\"a\"}"), 2.0);
  EXPECT_THAT(text, testing::Not(testing::HasSubstr("secret")));
}

}  // namespace
}  // namespace evpose::server
