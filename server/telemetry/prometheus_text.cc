// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/prometheus_text.h"

#include <prometheus/client_metric.h>
#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"

namespace evpose::server {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;
using Labels = std::vector<ClientMetric::Label>;

constexpr std::pair<DropReason, const char*> kDropReasons[] = {
    {DropReason::kLag, "lag"}, {DropReason::kMemory, "memory"}, {DropReason::kReader, "reader"}};
constexpr std::pair<CheckpointFailure, const char*> kCheckpointFailures[] = {
    {CheckpointFailure::kStoreAway, "store_away"},
    {CheckpointFailure::kStoreFull, "store_full"},
    {CheckpointFailure::kFenced, "fenced"},
    {CheckpointFailure::kStoreFailed, "store_failed"}};
constexpr std::pair<QuotaLimit, const char*> kQuotaLimits[] = {
    {QuotaLimit::kMaxSessions, "max_sessions"},
    {QuotaLimit::kMaxStreams, "max_streams"},
    {QuotaLimit::kMaxModelStoreBytes, "max_model_store_bytes"},
    {QuotaLimit::kTenantSessions, "tenant_sessions"},
    {QuotaLimit::kTenantModelBytes, "tenant_model_bytes"},
    {QuotaLimit::kTenantWatchers, "tenant_watchers"}};
constexpr std::pair<StreamKind, const char*> kStreamKinds[] = {{StreamKind::kTrack, "track"},
                                                               {StreamKind::kWatch, "watch"}};
constexpr std::pair<TrackState, const char*> kTrackStates[] = {{TrackState::kInitializing, "initializing"},
                                                               {TrackState::kTracking, "tracking"},
                                                               {TrackState::kDegraded, "degraded"},
                                                               {TrackState::kLost, "lost"}};
constexpr int kNumStatusCodes = 17;

// The families in the order in which they are added.
class Families {
 public:
  void Begin(const char* name, MetricType type, const char* help) {
    families_.push_back({.name = name, .help = help, .type = type, .metric = {}});
  }
  void Value(double value, Labels labels = {}) {
    ClientMetric metric;
    metric.label = std::move(labels);
    (families_.back().type == MetricType::Counter ? metric.counter.value : metric.gauge.value) = value;
    families_.back().metric.push_back(std::move(metric));
  }
  void Value(const Counter& counter, Labels labels = {}) {
    Value(static_cast<double>(counter.value()), std::move(labels));
  }

  void AddCounter(const char* name, const char* help, const Counter& counter, double unit = 1.0) {
    Begin(name, MetricType::Counter, help);
    Value(static_cast<double>(counter.value()) * unit);
  }
  void AddGauge(const char* name, const char* help, double value) {
    Begin(name, MetricType::Gauge, help);
    Value(value);
  }
  // One value for each kind; `read(kind)` is it.
  template <typename Kinds, typename Read>
  void AddByKind(const char* name, MetricType type, const char* help, const char* label, const Kinds& kinds,
                 const Read& read) {
    Begin(name, type, help);
    for (const auto& [kind, kind_name] : kinds) Value(read(kind), {{label, kind_name}});
  }
  void AddHistogram(const char* name, const char* help, const DurationHistogram& histogram) {
    Begin(name, MetricType::Histogram, help);
    const DurationHistogram::Reading reading = histogram.Read();
    ClientMetric metric;
    metric.histogram.sample_sum = reading.sum_s;
    constexpr auto& kBounds_us = DurationHistogram::kUpperBounds_us;
    for (size_t i = 0; i < reading.counts.size(); ++i) {
      metric.histogram.sample_count += reading.counts[i];
      const double bound_s =
          i < kBounds_us.size() ? static_cast<double>(kBounds_us[i]) / 1e6 : std::numeric_limits<double>::infinity();
      metric.histogram.bucket.push_back({metric.histogram.sample_count, bound_s});
    }
    families_.back().metric.push_back(std::move(metric));
  }

  const std::vector<MetricFamily>& all() const { return families_; }

 private:
  std::vector<MetricFamily> families_;
};

void AddState(const ServerState& state, const BuildVersion& build, Families& families) {
  families.Begin("evpose_build_info", MetricType::Gauge, "1; what runs here is in the labels.");
  families.Value(1.0, {{"version", build.version}, {"commit", build.commit}});
  families.AddGauge("evpose_ready", "1 while the server takes sessions, as /readyz says; else 0.",
                    state.readiness.ok() ? 1.0 : 0.0);
  families.AddGauge("evpose_workers", "Threads that decode and track.", state.num_workers);
  const SessionTotals& sessions = state.sessions;
  families.Begin("evpose_sessions", MetricType::Gauge,
                 "Sessions at this server. closed: another server has taken it, or the store had no room for it.");
  families.Value(sessions.attached, {{"state", "attached"}});
  families.Value(sessions.detached, {{"state", "detached"}});
  families.Value(sessions.ended, {{"state", "ended"}});
  families.Value(sessions.closed, {{"state", "closed"}});
  families.AddGauge("evpose_max_sessions", "Sessions that this server takes at a time: attached, detached and ended.",
                    state.max_sessions);
  families.AddByKind("evpose_objects", MetricType::Gauge, "Objects of sessions that have not ended.", "state",
                     kTrackStates, [&sessions](TrackState track_state) {
                       return static_cast<double>(sessions.objects[static_cast<size_t>(track_state)]);
                     });
  families.AddGauge("evpose_queue_bytes", "Bytes of chunks that have come and are not worked off, of all sessions.",
                    static_cast<double>(sessions.queued_bytes));
  families.AddGauge("evpose_queue_age_seconds", "Age of the oldest chunk that has come and is not worked off.",
                    static_cast<double>(sessions.oldest_queue_age_us) / 1e6);
}

void AddEvents(const ServerMetrics& metrics, Families& families) {
  families.AddCounter("evpose_received_bytes_total",
                      "Bytes of event chunks that sessions have taken. What is sent again after a restart, a move or a "
                      "lost connection counts again, unless the session still had it.",
                      metrics.received_bytes);
  families.AddCounter(
      "evpose_events_decoded_total",
      "Events decoded, those that were skipped included. A chunk that is processed again after a restart "
      "or a move counts again.",
      metrics.decoded_events);
  families.AddByKind("evpose_events_skipped_total", MetricType::Counter,
                     "Events that sessions with overload policy LATEST did not track: for their age (lag), for want of "
                     "room (memory), or because the client takes no poses (reader).",
                     "reason", kDropReasons,
                     [&metrics](DropReason reason) -> const Counter& { return metrics.skipped_events[reason]; });
  families.Begin("evpose_events_dropped_total", MetricType::Counter,
                 "Events that came before the first time stamp, or whose address the sensor does not have.");
  families.Value(metrics.events_before_time, {{"reason", "before_time"}});
  families.Value(metrics.events_outside_sensor, {{"reason", "outside_sensor"}});
  families.Begin("evpose_invalid_words_total", MetricType::Counter,
                 "Words of the event stream that mean nothing: bytes were lost or damaged, or have another encoding.");
  families.Value(metrics.unknown_words, {{"reason", "unknown"}});
  families.Value(metrics.broken_vectors, {{"reason", "broken_vector"}});
}

// Counters of the transitions that the transition function allows, by the phases before and after.
template <typename Phase, typename Input, int kNumPhases, int kNumInputs, typename Counters>
void AddTransitions(const char* name, const char* help, const Counters& counters, std::string_view (*phase_name)(Phase),
                    Families& families) {
  families.Begin(name, MetricType::Counter, help);
  for (int i = 0; i < kNumPhases; ++i) {
    const auto from = static_cast<Phase>(i);
    for (int j = 0; j < kNumPhases; ++j) {
      const auto to = static_cast<Phase>(j);
      bool is_allowed = false;
      for (int input = 0; input < kNumInputs && from != to; ++input) {
        is_allowed = is_allowed || NextPhase(from, static_cast<Input>(input)) == to;
      }
      if (!is_allowed) continue;
      families.Value(counters[from][to], {{"from", absl::AsciiStrToLower(std::string(phase_name(from)))},
                                          {"to", absl::AsciiStrToLower(std::string(phase_name(to)))}});
    }
  }
}

void AddTracking(const ServerMetrics& metrics, Families& families) {
  families.AddCounter(
      "evpose_poses_total",
      "Poses made. One that is made again after a restart or a move counts again, though its client gets "
      "it once.",
      metrics.poses);
  families.AddCounter("evpose_track_losses_total", "Times that an object was lost.", metrics.track_losses);
  families.AddCounter("evpose_reinitializations_total", "Times that an object has a pose again after it was lost.",
                      metrics.reinitializations);
  AddTransitions<ObjectPhase, ObjectInput, kNumObjectPhases, kNumObjectInputs>(
      "evpose_object_transitions_total", "Changes of the phase of objects (core/tracking/README.md, section 3).",
      metrics.object_transitions, ObjectPhaseName, families);
  AddTransitions<TrackPhase, TrackInput, kNumTrackPhases, kNumTrackInputs>(
      "evpose_track_transitions_total",
      "Changes of the phase of hypotheses, reported or not (core/tracking/README.md, section 3).",
      metrics.track_transitions, TrackPhaseName, families);
  families.AddHistogram("evpose_pose_latency_seconds", "From the receipt of a chunk to each of its poses.",
                        metrics.pose_latency);
  families.AddHistogram("evpose_decode_duration_seconds", "Decoding of a slice of at most 16 KiB of a chunk.",
                        metrics.decode_time);
  families.AddHistogram("evpose_track_duration_seconds",
                        "Tracking in a slice of at most 16 KiB of a chunk, initialization excepted.",
                        metrics.track_time);
  families.AddHistogram("evpose_initialization_duration_seconds",
                        "A step of at most 1 ms of sensor time in which an object's pose was searched for.",
                        metrics.initialization_time);
  families.AddCounter(
      "evpose_processing_seconds_total",
      "Time that workers spent on events. Its rate over that of evpose_sensor_seconds_total is the "
      "real-time ratio, the mean of the sessions: above 1 they fall behind. Its rate over evpose_workers "
      "is the share of the workers that is busy.",
      metrics.processing_ns, 1e-9);
  families.AddCounter("evpose_sensor_seconds_total",
                      "Sensor time of the events that were processed, summed over sessions; again when they are "
                      "processed again.",
                      metrics.sensor_time_us, 1e-6);
}

void AddCalls(const ServerMetrics& metrics, Families& families) {
  families.AddCounter("evpose_reattaches_total", "Streams that took a session up again.", metrics.reattaches);
  families.AddHistogram("evpose_checkpoint_duration_seconds",
                        "From the making of a checkpoint until the store has it, tries included.",
                        metrics.checkpoint_time);
  families.AddByKind(
      "evpose_checkpoint_failures_total", MetricType::Counter,
      "Checkpoints that the store did not take. store_away: it is tried again; store_full, store_failed: "
      "the session ended; fenced: another server has the session.",
      "reason", kCheckpointFailures,
      [&metrics](CheckpointFailure reason) -> const Counter& { return metrics.checkpoint_failures[reason]; });
  families.Begin("evpose_stream_ends_total", MetricType::Counter,
                 "Streams that have ended, by status code: of events (track), of poses or health (watch).");
  for (const auto& [kind, name] : kStreamKinds) {
    for (int i = 0; i < kNumStatusCodes; ++i) {
      const auto code = static_cast<absl::StatusCode>(i);
      families.Value(metrics.stream_ends[kind][code], {{"stream", name}, {"code", absl::StatusCodeToString(code)}});
    }
  }
  families.AddByKind("evpose_quota_refusals_total", MetricType::Counter,
                     "What was refused with RESOURCE_EXHAUSTED, by the limit that was reached.", "limit", kQuotaLimits,
                     [&metrics](QuotaLimit limit) -> const Counter& { return metrics.quota_refusals[limit]; });
  families.AddCounter(
      "evpose_quota_delays_total",
      "Times that a stream was not read for a while because its tenant sends more bytes per second than "
      "it may.",
      metrics.quota_delays);
}

}  // namespace

std::string PrometheusText(const ServerMetrics& metrics, const ServerState& state, const BuildVersion& build) {
  Families families;
  AddState(state, build, families);
  AddEvents(metrics, families);
  AddTracking(metrics, families);
  AddCalls(metrics, families);
  return prometheus::TextSerializer().Serialize(families.all());
}

}  // namespace evpose::server
