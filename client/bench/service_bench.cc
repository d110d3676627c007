// SPDX-License-Identifier: Apache-2.0
#include "client/bench/service_bench.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <map>
#include <set>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/bench/bench_session.h"
#include "client/bench/process_usage.h"
#include "client/cli/common/server_process.h"
#include "client/cli/common/transport_sink.h"
#include "core/base/status_macros.h"
#include "core/experiments/speed/measured_time.h"
#include "core/numerics/statistics.h"
#include "core/recordings/chunker.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"

namespace evpose::client {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Numbers of concurrent sessions that are measured. One session shows the latency of an idle server; 64 is the default
// of --max-sessions.
constexpr int kSessionCounts[] = {1, 4, 16, 64};
// Maximum number of sessions of one measurement, over all its repetitions.
constexpr int kMostSessions = 64;

// Limit of the server that is started: above the number of concurrent sessions.
constexpr int kMaxSessions = 128;
// Number of sessions after the first one, over which the growth of memory is averaged.
constexpr int kSessionsInMemory = 8;

// The scenes on which a part is measured.
std::vector<std::string> ScenesOf(const std::string& part) {
  if (part == "transport") return {"10"};
  if (part == "path") return {"1", "10", "50"};
  if (part == "memory") return {"1", "50"};
  return {"1"};
}

// The simulation of each scene, and the measurement of each part on each of its scenes.
size_t NumSteps(const std::vector<std::string>& parts) {
  std::set<std::string> scenes;
  size_t num_steps = 0;
  for (const std::string& part : parts) {
    for (const std::string& scene : ScenesOf(part)) num_steps += scenes.insert(scene).second ? 2 : 1;
  }
  return num_steps;
}

void AddPercentiles(const std::string& name, std::vector<double> values_ms, std::vector<NamedNumber>& numbers) {
  std::sort(values_ms.begin(), values_ms.end());
  numbers.push_back({name + "_p50_ms", NearestQuantile(values_ms, 0.5)});
  numbers.push_back({name + "_p99_ms", NearestQuantile(values_ms, 0.99)});
  numbers.push_back({name + "_max_ms", values_ms.back()});
}

// A server, its process if it is known, and a client.
struct BenchServer {
  std::unique_ptr<ServerProcess> own;
  std::unique_ptr<Client> client;
  pid_t pid = 0;
};

absl::StatusOr<BenchServer> StartServer(const ServiceBenchOptions& options, const CliContext& context) {
  BenchServer server;
  ServerArguments arguments = options.server;
  server.pid = options.server_pid;
  if (arguments.address.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(server.own, ServerProcess::Start({"--max-sessions", absl::StrCat(kMaxSessions)}));
    arguments.address = server.own->address();
    server.pid = server.own->pid();
  }
  EVPOSE_ASSIGN_OR_RETURN(server.client, arguments.Connect(context));
  return server;
}

// Latencies of the poses of some streams, milliseconds.
struct Latencies {
  std::vector<double> after_chunk_ms;   // from the end of the chunk that completes the pose's window
  std::vector<double> after_window_ms;  // from the end of the window
  std::vector<double> of_server_ms;     // from the receipt of that chunk, by the server's clock

  void Add(const StreamTimes& times) {
    const std::vector<int64_t>& ends_us = times.chunk_ends_us;
    const auto time_of = [&](int64_t t_us) { return times.begin + absl::Microseconds(t_us - ends_us.front()); };
    for (size_t i = 0; i + 1 < times.poses.size(); ++i) {
      const Arrival& pose = times.poses[i];
      // Consecutive poses belong to the middles of adjacent windows: the windows meet half-way.
      const int64_t window_end_us = pose.t_us + (times.poses[i + 1].t_us - pose.t_us) / 2;
      const auto chunk_end = std::lower_bound(ends_us.begin(), ends_us.end(), window_end_us);
      // The end of the recording closes the last window, not a chunk.
      if (chunk_end == ends_us.end() || window_end_us < ends_us.front()) continue;
      after_chunk_ms.push_back(absl::ToDoubleMilliseconds(pose.at - time_of(*chunk_end)));
      after_window_ms.push_back(absl::ToDoubleMilliseconds(pose.at - time_of(window_end_us)));
      of_server_ms.push_back(absl::ToDoubleMilliseconds(pose.server_latency));
    }
  }
};

struct Input {
  SpeedRecording recording;
  EncodedRecording encoded;
};

class ServiceBench {
 public:
  ServiceBench(const ServiceBenchOptions& options, CliContext& context,
               const std::function<void(const ServiceRow&)>& on_row, const SpeedProgress& on_progress)
      : options_(options), context_(context), on_row_(on_row), progress_(NumSteps(options.parts), on_progress) {}

  absl::Status Run() {
    EVPOSE_RETURN_IF_ERROR(CheckParts());
    for (const std::string& part : options_.parts) {
      for (const std::string& scene : ScenesOf(part)) {
        EVPOSE_ASSIGN_OR_RETURN(input_, InputOf(scene));
        EVPOSE_RETURN_IF_ERROR(RunPart(part));
        progress_.FinishStep();
      }
    }
    return absl::OkStatus();
  }

 private:
  // Simulates the scene at the first call.
  absl::StatusOr<const Input*> InputOf(const std::string& scene) {
    const auto [found, is_new] = inputs_.try_emplace(scene);
    Input& input = found->second;
    if (!is_new) return &input;
    const auto on_simulated = [&](double ratio) {
      return progress_.Show(ratio, absl::StrCat("simulating ", scene, " Mev/s"));
    };
    EVPOSE_ASSIGN_OR_RETURN(input.recording, MakeSpeedRecording(scene, options_.duration_us, on_simulated));
    EVPOSE_ASSIGN_OR_RETURN(std::vector<uint8_t> bytes, EncodeRecording(input.recording, Encoding::kEvt3));
    progress_.FinishStep();
    input.encoded = {Encoding::kEvt3, input.recording.geometry,
                     std::make_shared<const std::vector<uint8_t>>(std::move(bytes))};
    return &input;
  }

  // Refuses, before any work, the parts that cannot be measured with the server given.
  absl::Status CheckParts() const {
    if (options_.server.address.empty()) return absl::OkStatus();
    for (const std::string& part : options_.parts) {
      if (part == "memory")
        return UsageError("--parts memory needs a new server, which the benchmark starts: leave out --server");
      if (part == "sessions" && options_.server_pid == 0) {
        return UsageError(
            "--parts sessions needs the processor time of the server: give --server-pid, or leave out --server");
      }
    }
    if (options_.server_pid == 0) return absl::OkStatus();
    return ProcessorSeconds(options_.server_pid).status();
  }

  absl::Status RunPart(const std::string& part) {
    if (!Continues(part)) return absl::CancelledError("interrupted");
    if (part == "transport") return Transport();
    if (part == "memory") return Memory();
    EVPOSE_RETURN_IF_ERROR(Connect());
    if (part == "path") return Path();
    if (part == "latency") return Latency();
    return Sessions();
  }

  // `ratio` is the share of the measurement that is done.
  bool Continues(const std::string& what, double ratio = 0.0) const {
    return progress_.Show(ratio, absl::StrCat(what, ", ", recording().scene, " Mev/s"));
  }
  double ShareOfRepetitions(int repetition) const { return static_cast<double>(repetition) / options_.num_repetitions; }

  // Connects to the server that all parts except memory share.
  absl::Status Connect() {
    if (server_.client == nullptr) {
      EVPOSE_ASSIGN_OR_RETURN(server_, StartServer(options_, context_));
    }
    EVPOSE_ASSIGN_OR_RETURN(config_, UploadSession(*server_.client, recording(), encoded().encoding));
    return absl::OkStatus();
  }

  // `measure`: ServiceRow::measure.
  absl::Status Report(const std::string& part, const std::string& what, const std::string& measure,
                      const std::vector<NamedNumber>& numbers, bool more_is_better = false) const {
    on_row_({part, what, recording().scene, recording().RateMevPerS(), recording().events.size(), numbers, measure,
             more_is_better});
    return absl::OkStatus();
  }
  const SpeedRecording& recording() const { return input_->recording; }
  const EncodedRecording& encoded() const { return input_->encoded; }
  double SensorSeconds() const { return 1e-6 * static_cast<double>(recording().duration_us); }
  double GigaEvents() const { return 1e-9 * static_cast<double>(recording().events.size()); }

  // 0 if the process of the server is unknown.
  absl::StatusOr<double> ServerSeconds() const {
    return server_.pid == 0 ? absl::StatusOr<double>(0.0) : ProcessorSeconds(server_.pid);
  }

  // Bytes per second over loopback with both sides in this process, and the ratio to copying the bytes.
  absl::Status Transport() {
    // The transfer takes some tens of milliseconds, so that the start of the stream is negligible.
    constexpr uint64_t kLeastBytes = 64 << 20;
    EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<TransportSink> sink, TransportSink::Start());
    const auto num_times = static_cast<int>(1 + kLeastBytes / encoded().bytes->size());
    const uint64_t num_bytes = encoded().bytes->size() * static_cast<uint64_t>(num_times);
    std::vector<uint8_t> copy(encoded().bytes->size());
    double wall_s = kInfinity, processor_s = kInfinity, copy_s = kInfinity;
    for (int i = 0; i < options_.num_repetitions; ++i) {
      if (!Continues("transport", ShareOfRepetitions(i))) return absl::CancelledError("interrupted");
      copy_s = std::min(copy_s, ProcessorSecondsOf([&] {
                          for (int k = 0; k < num_times; ++k) {
                            std::memcpy(copy.data(), encoded().bytes->data(), copy.size());
                          }
                        }));
      MemoryReader reader(encoded(), num_times);
      const auto next_chunk = [&]() -> absl::StatusOr<EventChunk> {
        if (context_.IsInterrupted()) return absl::CancelledError("interrupted");
        EventChunk chunk;
        chunk.bytes.resize(ChunkerOptions().max_bytes);
        EVPOSE_ASSIGN_OR_RETURN(const size_t size, reader.Read(absl::MakeSpan(chunk.bytes)));
        chunk.bytes.resize(size);
        return chunk;
      };
      TrackOptions track_options;
      track_options.retry.max_outage = absl::ZeroDuration();
      const double begin_s = SecondsOfClock(CLOCK_PROCESS_CPUTIME_ID);
      const absl::Time begin = SystemClock().Now();
      EVPOSE_ASSIGN_OR_RETURN(const TrackSummary summary,
                              sink->client().Track(TransportSink::session(), next_chunk, {}, track_options));
      wall_s = std::min(wall_s, absl::ToDoubleSeconds(SystemClock().Now() - begin));
      processor_s = std::min(processor_s, SecondsOfClock(CLOCK_PROCESS_CPUTIME_ID) - begin_s);
      if (summary.health.received_bytes != num_bytes) return absl::InternalError("transport: bytes are missing");
    }
    const double giga_bytes = 1e-9 * static_cast<double>(num_bytes);
    return Report("transport", "gRPC", "memcpy_ratio",
                  {{"mb_per_s", 1e3 * giga_bytes / wall_s},
                   {"cpu_s_per_gb", processor_s / giga_bytes},
                   {"memcpy_ratio", processor_s / copy_s}});
  }

  // Processor time of the tracker without a server, in this thread.
  absl::StatusOr<double> TrackerSeconds() const {
    EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker,
                            Tracker::Create(recording().model, recording().camera, TrackerOptions(),
                                            recording().initial_camera_from_object));
    std::vector<PoseEstimate> poses;
    return ProcessorSecondsOf([&] {
      tracker->AddEvents(recording().events, poses);
      tracker->Finish(poses);
    });
  }

  absl::Status Path() {
    double wall_s = kInfinity, tracker_s = kInfinity, client_s = kInfinity, server_s = kInfinity;
    for (int i = 0; i < options_.num_repetitions; ++i) {
      if (!Continues("path", ShareOfRepetitions(i))) return absl::CancelledError("interrupted");
      EVPOSE_ASSIGN_OR_RETURN(const double tracker_once_s, TrackerSeconds());
      tracker_s = std::min(tracker_s, tracker_once_s);
      EVPOSE_ASSIGN_OR_RETURN(const auto session, BenchSession::Create(*server_.client, config_));
      const double client_begin_s = SecondsOfClock(CLOCK_PROCESS_CPUTIME_ID);
      EVPOSE_ASSIGN_OR_RETURN(const double server_begin_s, ServerSeconds());
      EVPOSE_ASSIGN_OR_RETURN(const StreamTimes times, Stream(*session, /*rate=*/0.0));
      wall_s = std::min(wall_s, absl::ToDoubleSeconds(times.end - times.begin));
      client_s = std::min(client_s, SecondsOfClock(CLOCK_PROCESS_CPUTIME_ID) - client_begin_s);
      EVPOSE_ASSIGN_OR_RETURN(const double server_end_s, ServerSeconds());
      server_s = std::min(server_s, server_end_s - server_begin_s);
    }
    const double mev = 1e3 * GigaEvents();
    std::vector<NamedNumber> numbers = {{"mev_per_s", mev / wall_s},
                                        {"tracker_mev_per_s", mev / tracker_s},
                                        {"tracker_ratio", tracker_s / wall_s},
                                        {"client_cpu_s_per_gev", client_s / GigaEvents()}};
    if (server_.pid != 0) numbers.push_back({"server_cpu_s_per_gev", server_s / GigaEvents()});
    return Report("path", "EVT3", "tracker_ratio", numbers, /*more_is_better=*/true);
  }

  // Streams in real time, in chunks of 1 ms.
  absl::Status Latency() {
    Latencies latencies;
    for (int i = 0; i < options_.num_repetitions; ++i) {
      if (!Continues("latency", ShareOfRepetitions(i))) return absl::CancelledError("interrupted");
      EVPOSE_ASSIGN_OR_RETURN(const auto session, BenchSession::Create(*server_.client, config_));
      EVPOSE_ASSIGN_OR_RETURN(const StreamTimes times, Stream(*session, /*rate=*/1.0));
      latencies.Add(times);
    }
    if (latencies.after_chunk_ms.empty()) {
      return absl::InternalError("latency: the recording has only one window: give a longer --duration");
    }
    std::vector<NamedNumber> numbers = {{"poses", static_cast<double>(latencies.after_chunk_ms.size())}};
    AddPercentiles("chunk", std::move(latencies.after_chunk_ms), numbers);
    AddPercentiles("window", std::move(latencies.after_window_ms), numbers);
    AddPercentiles("server", std::move(latencies.of_server_ms), numbers);
    return Report("latency", "--rate 1", "window_p50_ms", numbers);
  }

  absl::StatusOr<StreamTimes> Stream(BenchSession& session, double rate) const {
    return session.Stream(encoded(), recording().events.size(), rate, [this] { return context_.IsInterrupted(); });
  }

  using ManySessions = std::vector<std::unique_ptr<BenchSession>>;
  absl::StatusOr<ManySessions> CreateSessions(int num_sessions) {
    ManySessions sessions;
    for (int i = 0; i < num_sessions; ++i) {
      EVPOSE_ASSIGN_OR_RETURN(auto session, BenchSession::Create(*server_.client, config_));
      sessions.push_back(std::move(session));
    }
    return sessions;
  }

  // Streams the whole recording to all sessions concurrently, as fast as possible.
  absl::Status StreamAll(const ManySessions& sessions) {
    std::vector<absl::Status> statuses(sessions.size());
    {
      std::vector<std::jthread> threads;
      for (size_t i = 0; i < sessions.size(); ++i) {
        threads.emplace_back([this, &session = *sessions[i], &status = statuses[i]] {
          status = Stream(session, /*rate=*/0.0).status();
        });
      }
    }
    for (const absl::Status& status : statuses) EVPOSE_RETURN_IF_ERROR(status);
    return absl::OkStatus();
  }

  absl::Status Sessions() {
    double one_s = 0.0;
    double num_measured = 0.0;  // numbers of sessions
    for (const int num_sessions : kSessionCounts) {
      double server_s = kInfinity, create_s = kInfinity;
      // A measurement of many sessions is an average already and needs fewer repetitions.
      const int num_repetitions = std::clamp(kMostSessions / num_sessions, 1, options_.num_repetitions);
      for (int i = 0; i < num_repetitions; ++i) {
        const double ratio = (num_measured + static_cast<double>(i) / num_repetitions) / std::size(kSessionCounts);
        if (!Continues(absl::StrCat(num_sessions, " sessions"), ratio)) return absl::CancelledError("interrupted");
        EVPOSE_ASSIGN_OR_RETURN(const double idle_s, ProcessorSeconds(server_.pid));
        EVPOSE_ASSIGN_OR_RETURN(const ManySessions sessions, CreateSessions(num_sessions));
        EVPOSE_ASSIGN_OR_RETURN(const double begin_s, ProcessorSeconds(server_.pid));
        create_s = std::min(create_s, (begin_s - idle_s) / num_sessions);
        EVPOSE_RETURN_IF_ERROR(StreamAll(sessions));
        EVPOSE_ASSIGN_OR_RETURN(const double end_s, ProcessorSeconds(server_.pid));
        server_s = std::min(server_s, (end_s - begin_s) / num_sessions);
      }
      num_measured += 1.0;
      if (num_sessions == 1) one_s = server_s;
      const char* const measure = num_sessions == 1 ? "server_real_time_ratio" : "to_one_ratio";
      EVPOSE_RETURN_IF_ERROR(Report("sessions", absl::StrCat(num_sessions), measure,
                                    {{"server_real_time_ratio", server_s / SensorSeconds()},
                                     {"to_one_ratio", server_s / one_s},
                                     {"create_cpu_ms", 1e3 * create_s}}));
    }
    return absl::OkStatus();
  }

  // Measures a new server, because memory of earlier sessions would be reused. Data that the first session allocates
  // for all sessions are not counted for the others.
  absl::Status Memory() {
    server_ = {};
    EVPOSE_RETURN_IF_ERROR(Connect());
    EVPOSE_ASSIGN_OR_RETURN(const ProcessMemory idle, MemoryOf(server_.pid));
    EVPOSE_ASSIGN_OR_RETURN(const ManySessions first, CreateSessions(1));
    EVPOSE_RETURN_IF_ERROR(StreamAll(first));
    EVPOSE_ASSIGN_OR_RETURN(const ProcessMemory with_first, MemoryOf(server_.pid));
    EVPOSE_ASSIGN_OR_RETURN(const ManySessions others, CreateSessions(kSessionsInMemory));
    EVPOSE_RETURN_IF_ERROR(StreamAll(others));
    EVPOSE_ASSIGN_OR_RETURN(const ProcessMemory with_all, MemoryOf(server_.pid));
    return Report("memory", absl::StrCat("1+", kSessionsInMemory), "mb_per_session",
                  {{"server_mb", idle.resident_mb},
                   {"first_session_mb", with_first.peak_mb - idle.resident_mb},
                   {"mb_per_session", (with_all.peak_mb - with_first.peak_mb) / kSessionsInMemory}});
  }

  const ServiceBenchOptions& options_;
  CliContext& context_;
  const std::function<void(const ServiceRow&)>& on_row_;
  StepProgress progress_;
  std::map<std::string, Input> inputs_;  // by scene
  const Input* input_ = nullptr;         // the input of the current part

  BenchServer server_;
  SessionConfig config_;
};

}  // namespace

absl::Status RunServiceBench(const ServiceBenchOptions& options, CliContext& context,
                             const std::function<void(const ServiceRow&)>& on_row, const SpeedProgress& on_progress) {
  return ServiceBench(options, context, on_row, on_progress).Run();
}

}  // namespace evpose::client
