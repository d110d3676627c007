// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/prometheus_text.h"

#include <prometheus/client_metric.h>
#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "server/runtime/out_of_memory.h"
#include "server/telemetry/open_metrics.h"

namespace evpose::server {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;
using Labels = std::vector<ClientMetric::Label>;

// Values of labels, in the order of the enumerations.
constexpr std::array kDropReasons = {"lag", "memory", "reader"};
constexpr std::array kAuthenticationFailures = {"no_token", "bad_token", "bad_certificate"};
constexpr std::array kCheckpointFailures = {"store_away", "store_full", "fenced", "store_failed", "rolled_back"};
constexpr std::array kCommitParts = {"checkpoint", "poses", "lifecycle"};
constexpr std::array kQuotaLimits = {"max_sessions",    "max_streams",           "max_model_store_bytes",
                                     "tenant_sessions", "tenant_model_bytes",    "tenant_watchers",
                                     "session_memory",  "tenant_session_memory", "tenant_streams",
                                     "max_uploads",     "tenant_uploads",        "tenant_responses"};
constexpr std::array kConnectionRefusals = {"max_connections", "max_connections_per_peer", "descriptors"};
constexpr std::array kStreamKinds = {"track", "watch"};
constexpr int kNumStatusCodes = 17;

std::string LowerCase(std::string_view name) { return absl::AsciiStrToLower(std::string(name)); }

// A list of metric families, in the order in which they are added.
class Families {
 public:
  void Begin(const char* name, MetricType type, const char* help) {
    families_.push_back({.name = name, .help = help, .type = type, .metric = {}});
    exemplars_.emplace_back();
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
  // Adds a gauge that has a value.
  template <typename Number>
  void AddKnownGauge(const char* name, const char* help, const std::optional<Number>& value) {
    if (value.has_value()) AddGauge(name, help, static_cast<double>(*value));
  }
  // Adds a counter for each kind.
  template <typename Kind, size_t kNumKinds>
  void AddByKind(const char* name, const char* help, const char* label, const std::array<const char*, kNumKinds>& kinds,
                 const OneFor<Kind, kNumKinds>& counters) {
    Begin(name, MetricType::Counter, help);
    for (size_t i = 0; i < kNumKinds; ++i) Value(counters[static_cast<Kind>(i)], {{label, kinds[i]}});
  }
  void AddHistogram(const char* name, const char* help, const DurationHistogram& histogram) {
    Begin(name, MetricType::Histogram, help);
    exemplars_.back() = histogram.ReadExemplars();  // first: the counts then include them
    const DurationHistogram::Reading reading = histogram.Read();
    ClientMetric metric;
    metric.histogram.sample_sum = reading.sum_s;
    constexpr auto& kBoundsUs = DurationHistogram::kUpperBoundsUs;
    for (size_t i = 0; i < reading.counts.size(); ++i) {
      metric.histogram.sample_count += reading.counts[i];
      const double bound_s =
          i < kBoundsUs.size() ? static_cast<double>(kBoundsUs[i]) / 1e6 : std::numeric_limits<double>::infinity();
      metric.histogram.bucket.push_back({metric.histogram.sample_count, bound_s});
    }
    families_.back().metric.push_back(std::move(metric));
  }

  const std::vector<MetricFamily>& all() const { return families_; }
  const std::vector<BucketExemplars>& exemplars() const { return exemplars_; }  // of each family

 private:
  std::vector<MetricFamily> families_;
  std::vector<BucketExemplars> exemplars_;
};

// The groups of a store that has several; otherwise there are names without values.
void AddStoreGroups(const std::vector<StoreGroup>& groups, Families& families) {
  const auto add = [&](const char* name, MetricType type, const char* help, const auto& value_of) {
    families.Begin(name, type, help);
    for (const StoreGroup& group : groups) {
      const std::optional<double> value = value_of(group);
      if (value.has_value()) families.Value(*value, {{"group", group.name}});
    }
  };
  using Known = std::optional<double>;
  add("evpose_store_group_up", MetricType::Gauge,
      "1 if the group of the store has responded to the last check, else 0.",
      [](const StoreGroup& group) -> Known { return group.health.ok() ? 1.0 : 0.0; });
  add("evpose_store_group_buckets", MetricType::Gauge, "The part of the store's 256 buckets that the group has.",
      [](const StoreGroup& group) -> Known { return group.parts; });
  add("evpose_store_group_bytes", MetricType::Gauge, "Bytes in use in the group (used_memory).",
      [](const StoreGroup& group) -> Known {
        if (!group.usage.has_value()) return std::nullopt;
        return static_cast<double>(group.usage->bytes);
      });
  add("evpose_store_group_max_bytes", MetricType::Gauge, "Limit of evpose_store_group_bytes (maxmemory).",
      [](const StoreGroup& group) -> Known {
        if (!group.usage.has_value() || group.usage->max_bytes == 0) return std::nullopt;
        return static_cast<double>(group.usage->max_bytes);
      });
  add("evpose_store_group_cpu_seconds_total", MetricType::Counter, "Processor time of the group's master.",
      [](const StoreGroup& group) -> Known { return group.usage.has_value() ? group.usage->cpu_s : std::nullopt; });
  add("evpose_store_group_commits_total", MetricType::Counter, "Commits that the group has completed.",
      [](const StoreGroup& group) -> Known { return static_cast<double>(group.commits); });
  add("evpose_store_group_commit_seconds_total", MetricType::Counter, "The sum of the durations of these commits.",
      [](const StoreGroup& group) -> Known { return group.commit_s; });
  add("evpose_store_group_unreplicated_commits_total", MetricType::Counter,
      "The part of evpose_store_unreplicated_commits_total that is the group's.",
      [](const StoreGroup& group) -> Known { return static_cast<double>(group.unreplicated_commits); });
}

void AddStore(const ServerState& state, Families& families) {
  families.AddKnownGauge("evpose_store_bytes",
                         "Bytes in use: memory of Redis (used_memory; of the fullest group if there are several), file "
                         "and log of SQLite, sessions in memory, or sessions and "
                         "models in PostgreSQL.",
                         state.store_bytes);
  families.AddKnownGauge("evpose_store_max_bytes", "Limit of evpose_store_bytes: maxmemory, or --store-max-bytes.",
                         state.store_max_bytes);
  if (state.store_cpu_s.has_value()) {
    families.Begin("evpose_store_cpu_seconds_total", MetricType::Counter,
                   "Processor time of Redis (the masters of all groups), at the last check of the store.");
    families.Value(*state.store_cpu_s);
  }
  families.Begin("evpose_store_unreplicated_commits_total", MetricType::Counter,
                 "Commits that Redis has executed and no replica has acknowledged in time; they are repeated. 0 if the "
                 "store waits for no replica.");
  families.Value(static_cast<double>(state.unreplicated_commits));
  AddStoreGroups(state.store_groups, families);
}

void AddState(const ServerState& state, const BuildVersion& build, Families& families) {
  families.Begin("evpose_build_info", MetricType::Gauge,
                 "Always 1; the labels have the version and commit of the server.");
  families.Value(1.0, {{"version", build.version}, {"commit", build.commit}});
  families.AddGauge("evpose_ready", "1 while the server accepts sessions (/readyz is 200), else 0.",
                    state.readiness.ok() ? 1.0 : 0.0);
  families.AddGauge("evpose_workers", "Threads that decode and track.", state.num_workers);
  families.AddKnownGauge("evpose_tokens",
                         "Valid tokens of --token-file. 0: it is missing or empty and nobody is admitted.",
                         state.num_tokens);
  AddStore(state, families);
  families.AddGauge("evpose_connections", "Connections of clients.", static_cast<double>(state.connections));
  families.AddGauge("evpose_load_ratio",
                    "Part of the server that is in use: the largest of the processor time of the workers per second "
                    "and worker, averaged over 5 s, and of the sessions and their memory, each over its limit.",
                    state.load_ratio);
  families.Begin("evpose_process_cpu_seconds_total", MetricType::Counter, "Processor time of all threads.");
  families.Value(state.process_cpu_s);
  families.AddGauge("evpose_process_resident_bytes", "Resident memory of the process.",
                    static_cast<double>(state.process_resident_bytes));
  families.AddGauge("evpose_listener_stalled", "1 while the server accepts no connections, else 0.",
                    state.listening.ok() ? 0.0 : 1.0);
  const SessionTotals& sessions = state.sessions;
  families.Begin(
      "evpose_sessions", MetricType::Gauge,
      "Sessions at this server, by state. closed: another server has taken the session, or the store was full.");
  families.Value(sessions.attached, {{"state", "attached"}});
  families.Value(sessions.detached, {{"state", "detached"}});
  families.Value(sessions.ended, {{"state", "ended"}});
  families.Value(sessions.closed, {{"state", "closed"}});
  families.AddGauge("evpose_max_sessions",
                    "Maximum number of sessions at this server: attached, detached and ended together.",
                    state.max_sessions);
  families.AddGauge("evpose_session_memory_bytes",
                    "Bytes charged for the sessions at this server: the most that each of them may take.",
                    static_cast<double>(state.session_memory_bytes));
  families.AddGauge("evpose_session_memory_limit_bytes", "Maximum of evpose_session_memory_bytes for new sessions.",
                    static_cast<double>(state.max_session_memory_bytes));
  families.Begin("evpose_objects", MetricType::Gauge,
                 "Objects of sessions that have not ended, by state of the track.");
  for (size_t i = 0; i < sessions.objects.size(); ++i) {
    families.Value(sessions.objects[i], {{"state", LowerCase(TrackStateName(static_cast<TrackState>(i)))}});
  }
  families.AddGauge("evpose_queue_bytes", "Bytes of received chunks that wait to be processed, of all sessions.",
                    static_cast<double>(sessions.queued_bytes));
  families.AddGauge("evpose_queue_age_seconds", "Age of the oldest received chunk that waits to be processed.",
                    static_cast<double>(sessions.oldest_queue_age_us) / 1e6);
  families.AddGauge("evpose_event_image_watchers", "Readers of images of events (WatchEvents).",
                    sessions.image_watchers);
}

void AddEvents(const ServerMetrics& metrics, Families& families) {
  families.AddCounter(
      "evpose_received_bytes_total",
      "Bytes of event chunks that sessions have accepted. Chunks that are sent again after a restart, a "
      "move or a lost connection count again, unless the session still had them.",
      metrics.received_bytes);
  families.AddCounter(
      "evpose_events_decoded_total",
      "Decoded events, including those that were not tracked. A chunk that is processed again after a restart "
      "or a move counts again.",
      metrics.decoded_events);
  families.AddByKind("evpose_events_skipped_total",
                     "Events that sessions with overload policy LATEST did not track, because they were too old (lag), "
                     "too many bytes were waiting (memory), or the client does not read its poses (reader).",
                     "reason", kDropReasons, metrics.skipped_events);
  families.Begin("evpose_events_dropped_total", MetricType::Counter,
                 "Events before the first time stamp (before_time) or with an address outside the sensor "
                 "(outside_sensor).");
  families.Value(metrics.events_before_time, {{"reason", "before_time"}});
  families.Value(metrics.events_outside_sensor, {{"reason", "outside_sensor"}});
  families.Begin("evpose_invalid_words_total", MetricType::Counter,
                 "Invalid words of event streams: bytes were lost or damaged, or the encoding is another one.");
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
      families.Value(counters[from][to], {{"from", LowerCase(phase_name(from))}, {"to", LowerCase(phase_name(to))}});
    }
  }
}

void AddTracking(const ServerMetrics& metrics, Families& families) {
  families.AddCounter(
      "evpose_poses_total",
      "Computed poses. A pose that is computed again after a restart or a move counts again, although its client "
      "receives it once.",
      metrics.poses);
  families.AddCounter("evpose_track_losses_total", "Number of times that the track of an object was lost.",
                      metrics.track_losses);
  families.AddCounter("evpose_reinitializations_total",
                      "Number of times that an object was found again after its track was lost.",
                      metrics.reinitializations);
  AddTransitions<ObjectPhase, ObjectInput, kNumObjectPhases, kNumObjectInputs>(
      "evpose_object_transitions_total", "Changes of the phase of objects (core/tracking/README.md, section 3).",
      metrics.object_transitions, ObjectPhaseName, families);
  AddTransitions<TrackPhase, TrackInput, kNumTrackPhases, kNumTrackInputs>(
      "evpose_track_transitions_total",
      "Changes of the phase of hypotheses, reported or not (core/tracking/README.md, section 3).",
      metrics.track_transitions, TrackPhaseName, families);
  families.AddHistogram("evpose_turn_seconds",
                        "Processor time for which a session was processed before another one had its turn.",
                        metrics.turn_time);
  families.AddHistogram("evpose_pose_latency_seconds", "Time from the receipt of a chunk to each of its poses.",
                        metrics.pose_latency);
  families.AddHistogram("evpose_decode_duration_seconds", "Time to decode a slice of a chunk, at most 16 KiB.",
                        metrics.decode_time);
  families.AddHistogram("evpose_track_duration_seconds",
                        "Time to track the events of a slice of a chunk, at most 16 KiB, without initialization.",
                        metrics.track_time);
  families.AddHistogram("evpose_initialization_duration_seconds",
                        "Time of a step of at most 1 ms of sensor time that contains a search for an object's pose.",
                        metrics.initialization_time);
  families.AddCounter(
      "evpose_processing_seconds_total",
      "Time that workers spent on events. Its rate divided by that of evpose_sensor_seconds_total is the "
      "mean real-time ratio of the sessions: above 1 they fall behind. Its rate divided by evpose_workers "
      "is the utilization of the workers.",
      metrics.processing_ns, 1e-9);
  families.AddCounter(
      "evpose_sensor_seconds_total",
      "Sensor time of the processed events, summed over sessions. Events that are processed again count "
      "again.",
      metrics.sensor_time_us, 1e-6);
  families.AddCounter("evpose_falls_behind_total",
                      "Number of times that a session began to be processed more slowly than its camera sends.",
                      metrics.falls_behind);
}

void AddCalls(const ServerMetrics& metrics, Families& families) {
  families.AddCounter("evpose_reattaches_total", "Streams that attached to a session which had been attached before.",
                      metrics.reattaches);
  families.AddHistogram("evpose_checkpoint_duration_seconds",
                        "Time from the serialization of a checkpoint until it is durable, including retries.",
                        metrics.checkpoint_time);
  families.AddByKind(
      "evpose_checkpoint_failures_total",
      "Checkpoints that the store did not accept. store_away: the server tries again; store_full, store_failed: "
      "the session was closed; fenced: another server has taken the session; rolled_back: the store has lost earlier "
      "writes.",
      "reason", kCheckpointFailures, metrics.checkpoint_failures);
  families.AddByKind(
      "evpose_commit_bytes_total",
      "Bytes of the commits that are durable: the state of the session with its tracker (checkpoint), its "
      "new poses, and the record of its owner (lifecycle).",
      "part", kCommitParts, metrics.commit_bytes);
  families.AddCounter("evpose_event_images_total", "Images of events that were sent to their readers.",
                      metrics.event_images);
  families.AddCounter("evpose_event_images_skipped_total",
                      "Images of events that were replaced by later ones, because their reader was too slow.",
                      metrics.skipped_event_images);
  families.Begin(
      "evpose_stream_ends_total", MetricType::Counter,
      "Streams that have ended, by kind and status code. track: events; watch: poses, health or images of events.");
  for (size_t kind = 0; kind < kStreamKinds.size(); ++kind) {
    for (int i = 0; i < kNumStatusCodes; ++i) {
      const auto code = static_cast<absl::StatusCode>(i);
      families.Value(metrics.stream_ends[static_cast<StreamKind>(kind)][code],
                     {{"stream", kStreamKinds[kind]}, {"code", absl::StatusCodeToString(code)}});
    }
  }
  families.AddByKind("evpose_authentication_failures_total",
                     "Calls that were rejected with UNAUTHENTICATED, and open streams that ended with it, by reason.",
                     "reason", kAuthenticationFailures, metrics.authentication_failures);
  families.AddByKind("evpose_quota_refusals_total", "Calls that were rejected with RESOURCE_EXHAUSTED, by limit.",
                     "limit", kQuotaLimits, metrics.quota_refusals);
  families.AddCounter("evpose_overload_refusals_total",
                      "Sessions that were not created because the load of the workers was above --max-load.",
                      metrics.overload_refusals);
  families.AddByKind("evpose_connections_refused_total",
                     "Connections that were closed at once, by limit: all connections, those of one address, or the "
                     "descriptors of the process.",
                     "limit", kConnectionRefusals, metrics.connection_refusals);
  families.AddCounter(
      "evpose_quota_delays_total",
      "Number of times that the server paused reading a stream because its tenant exceeded its limit of bytes "
      "per second.",
      metrics.quota_delays);
  families.Begin("evpose_out_of_memory_total", MetricType::Counter,
                 "Calls and sessions that were ended because an allocation failed.");
  families.Value(static_cast<double>(OutOfMemoryCount()));
}

Families AllFamilies(const ServerMetrics& metrics, const ServerState& state, const BuildVersion& build) {
  Families families;
  AddState(state, build, families);
  AddEvents(metrics, families);
  AddTracking(metrics, families);
  AddCalls(metrics, families);
  return families;
}

// The weight of a media range of the header Accept; 1 unless it states another one, 0 for one that is no number.
double WeightOf(const std::vector<std::string>& parameters) {
  for (size_t i = 1; i < parameters.size(); ++i) {
    const absl::string_view parameter = absl::StripAsciiWhitespace(parameters[i]);
    if (!absl::StartsWithIgnoreCase(parameter, "q=")) continue;
    double weight = 0.0;
    return absl::SimpleAtod(parameter.substr(2), &weight) && weight > 0.0 ? weight : 0.0;
  }
  return 1.0;
}

}  // namespace

std::string PrometheusText(const ServerMetrics& metrics, const ServerState& state, const BuildVersion& build) {
  return prometheus::TextSerializer().Serialize(AllFamilies(metrics, state, build).all());
}

std::string OpenMetricsText(const ServerMetrics& metrics, const ServerState& state, const BuildVersion& build) {
  const Families families = AllFamilies(metrics, state, build);
  return OpenMetricsOf(families.all(), families.exemplars());
}

bool PrefersOpenMetrics(absl::string_view accept) {
  double open_metrics = 0.0, text = 0.0;
  for (const absl::string_view range : absl::StrSplit(accept, ',')) {
    const std::vector<std::string> parts = absl::StrSplit(range, ';');
    const absl::string_view type = absl::StripAsciiWhitespace(parts[0]);
    if (absl::EqualsIgnoreCase(type, "application/openmetrics-text")) {
      open_metrics = std::max(open_metrics, WeightOf(parts));
    } else if (absl::EqualsIgnoreCase(type, "text/plain")) {
      text = std::max(text, WeightOf(parts));
    }
  }
  return open_metrics > 0.0 && open_metrics >= text;
}

}  // namespace evpose::server
