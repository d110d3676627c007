// SPDX-License-Identifier: Apache-2.0

// Many clients on one server: a load test with stalled clients, and a soak test that detects leaks of memory and
// descriptors.
#include <grpcpp/grpcpp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/temporary_directory_testing.h"
#include "core/numerics/statistics.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "server/program/program_testing.h"
#include "server/rpc/raw_requests_testing.h"
#include "tests/bench/scene.h"
#include "tests/bench/scraper.h"
#include "tests/bench/track_clients.h"

namespace evpose::bench {
namespace {

struct Arguments {
  int sessions = 64;
  int watchers = 1000;
  int stalled = 200;
  double rate_mev_s = 0.1;
  double seconds = 5.0;
  int rounds = 2;
  double watch_hz = 30.0;
  int channels = 16;
  double minutes = 0.0;
  std::string store = "sqlite";
};

// A server in a separate process, and channels to it.
class Bench {
 public:
  Bench(const Arguments& arguments, const Scene& scene)
      : scene_(scene),
        program_({"--listen", "127.0.0.1:0", "--metrics-listen", "127.0.0.1:0", "--log-level", "warning", "--store",
                  arguments.store, "--data-dir", data_.path(), "--max-sessions",
                  absl::StrCat(arguments.sessions + 64)}) {
    const std::string address = program_.Announced("listening on ");
    metrics_port_ = server::PortOf(program_.Announced("metrics on "));
    for (int i = 0; i < arguments.channels; ++i) {
      grpc::ChannelArguments options;
      options.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);  // one connection for each channel
      channels_.push_back(grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), options));
      stubs_.push_back(v1::SessionService::NewStub(channels_.back()));
    }
  }

  v1::SessionService::Stub& stub(size_t i) { return *stubs_[i % stubs_.size()]; }
  int metrics_port() const { return metrics_port_; }

  bool Upload() {
    const auto models = v1::ModelService::NewStub(channels_[0]);
    v1::Model model;
    const bool is_good = server::UploadModel(*models, server::UploadRequests(scene_.model_obj), &model).ok();
    model_ = is_good ? model.name() : "";
    return !model_.empty();
  }
  server::CreatedSession CreateSession(size_t i) {
    v1::CreateSessionRequest request;
    *request.mutable_config() = scene_.config;
    request.mutable_config()->mutable_objects(0)->set_model(model_);
    grpc::ClientContext context;
    server::CreatedSession session;
    const grpc::Status status = stub(i).CreateSession(&context, request, session.response());
    if (!status.ok()) std::cerr << "CreateSession: " << status.error_message() << "\n";
    return session;
  }
  void Delete(const server::CreatedSession& session) {
    v1::DeleteSessionRequest request;
    request.set_name(session.name());
    grpc::ClientContext context;
    google::protobuf::Empty response;
    stub(0).DeleteSession(&context, request, &response);
  }

  double ResidentMb() const {
    std::ifstream statm(absl::StrCat("/proc/", program_.pid(), "/statm"));
    double pages = 0.0, resident = 0.0;
    statm >> pages >> resident;
    return resident * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
  }
  // The maximum resident memory so far: a session that has ended has released its memory.
  double PeakMb() const {
    std::ifstream status(absl::StrCat("/proc/", program_.pid(), "/status"));
    double kibibytes = 0.0;
    for (std::string line; std::getline(status, line);) {
      if (absl::StartsWith(line, "VmHWM:")) (void)std::sscanf(line.c_str(), "VmHWM: %lf kB", &kibibytes);
    }
    return kibibytes * 1024.0 / 1e6;
  }
  long Descriptors() const {
    const std::filesystem::directory_iterator begin(absl::StrCat("/proc/", program_.pid(), "/fd"));
    return static_cast<long>(std::distance(begin, std::filesystem::directory_iterator()));
  }

 private:
  const Scene& scene_;
  const TemporaryDirectory data_;  // the server's --data-dir
  server::Program program_;
  int metrics_port_ = 0;
  std::vector<std::shared_ptr<grpc::Channel>> channels_;
  std::vector<std::unique_ptr<v1::SessionService::Stub>> stubs_;
  std::string model_;
};

struct RoundResult {
  double p50_ms = 0.0, p99_ms = 0.0;
  uint64_t poses = 0, lost = 0, watched = 0;
  double peak_mb = 0.0;
  double scrape_ms = 0.0, idle_scrape_ms = 0.0;  // median during the streams, and after them
  bool is_good = true;
};

double Percentile(std::vector<float>& values, double share) {
  return values.empty() ? 0.0 : UpperQuantile(values, share);
}

// A stream whose client writes events and never reads the poses.
struct StalledStream {
  StalledStream(Bench& bench, size_t i) : session(bench.CreateSession(i)), track(bench.stub(i)) {
    track.Attach(session);
  }
  server::CreatedSession session;
  server::RawTrack track;
};

std::unique_ptr<StalledStream> Stall(Bench& bench, size_t i, const Scene& scene) {
  auto stalled = std::make_unique<StalledStream>(bench, i);
  const size_t count = std::min<size_t>(scene.chunks.size(), 50);  // fits into the buffers of the connection
  for (size_t k = 0; k < count; ++k) stalled->track.Events(k + 1, scene.chunks[k]);
  return stalled;
}

void Add(const Streamer& streamer, RoundResult& result, std::vector<float>& latencies_ms) {
  if (!streamer.is_ok()) std::cerr << "Track: " << streamer.status().error_message() << "\n";
  result.is_good &= streamer.is_ok() && streamer.health().poses() == streamer.seen().poses;
  result.poses += streamer.seen().poses;
  result.lost += streamer.seen().lost;
  latencies_ms.insert(latencies_ms.end(), streamer.seen().latencies_ms.begin(), streamer.seen().latencies_ms.end());
}

void AddScrapes(const Bench& bench, std::vector<float> loaded_ms, RoundResult& result) {
  constexpr int kIdleScrapes = 50;
  std::vector<float> idle_ms;
  for (int i = 0; i < kIdleScrapes; ++i) idle_ms.push_back(static_cast<float>(ScrapeMs(bench.metrics_port())));
  result.scrape_ms = Percentile(loaded_ms, 0.5);
  result.idle_scrape_ms = Percentile(idle_ms, 0.5);
  result.is_good &= Percentile(loaded_ms, 0.0) > 0.0 && Percentile(idle_ms, 0.0) > 0.0;
}

RoundResult RunRound(Bench& bench, const Arguments& arguments, const Scene& scene, bool with_stalled) {
  const auto num_sessions = static_cast<size_t>(arguments.sessions);
  std::vector<server::CreatedSession> sessions;
  for (size_t i = 0; i < num_sessions; ++i) sessions.push_back(bench.CreateSession(i));
  std::vector<std::unique_ptr<Watcher>> healthy, stalled;
  for (int i = 0; i < arguments.watchers - arguments.stalled; ++i) {
    const auto k = static_cast<size_t>(i);
    healthy.push_back(
        std::make_unique<Watcher>(bench.stub(k), sessions[k % num_sessions].name(), arguments.watch_hz, false));
  }
  std::vector<std::unique_ptr<StalledStream>> stalled_streams;
  for (int i = 0; with_stalled && i < arguments.stalled; ++i) {
    const auto k = static_cast<size_t>(i);
    stalled.push_back(std::make_unique<Watcher>(bench.stub(k), sessions[k % num_sessions].name(), 0.0, true));
    if (i % 25 == 0) stalled_streams.push_back(Stall(bench, k, scene));
  }

  const Clock::time_point begin = Clock::now() + std::chrono::milliseconds(500);
  std::vector<std::unique_ptr<Streamer>> streamers;
  for (size_t i = 0; i < num_sessions; ++i) {
    streamers.push_back(std::make_unique<Streamer>(bench.stub(i), sessions[i], scene, begin));
  }
  RoundResult result;
  std::vector<float> latencies_ms;
  Scraper scraper(bench.metrics_port());
  for (const auto& streamer : streamers) {
    streamer->Join();
    Add(*streamer, result, latencies_ms);
  }
  AddScrapes(bench, scraper.Stop(), result);
  result.p50_ms = Percentile(latencies_ms, 0.5);
  result.p99_ms = Percentile(latencies_ms, 0.99);
  result.peak_mb = bench.PeakMb();
  for (const auto& watcher : healthy) {
    watcher->Join();
    result.is_good &= watcher->status().ok();
    result.lost += watcher->skipped();
    result.watched += watcher->poses();
  }
  for (const auto& watcher : stalled) {
    watcher->Cancel();
    watcher->Join();
  }
  for (const auto& stream : stalled_streams) {
    stream->track.Cancel();
    stream->track.Finish();
    bench.Delete(stream->session);
  }
  for (const server::CreatedSession& session : sessions) bench.Delete(session);
  return result;
}

int RunLoad(const Arguments& arguments) {
  const Scene scene = MakeScene(arguments.seconds, 1e6 * arguments.rate_mev_s);
  Bench bench(arguments, scene);
  if (!bench.Upload()) return 1;
  const double before_mb = bench.ResidentMb();
  std::printf("%d sessions of %.3f Mev/s for %.1f s, %d watchers at %.0f Hz\n", arguments.sessions,
              1e-6 * static_cast<double>(scene.num_events) / arguments.seconds, arguments.seconds, arguments.watchers,
              arguments.watch_hz);
  std::printf("%8s %9s %5s %9s %9s %9s %8s %9s %8s\n", "stalled", "poses", "lost", "watched", "p50 ms", "p99 ms",
              "peak MB", "scrape ms", "idle ms");
  bool is_good = true;
  std::vector<double> ratios;
  double most_mb = 0.0, scrape_ms = 0.0, idle_scrape_ms = 0.0;
  for (int round = 0; round < arguments.rounds; ++round) {
    RoundResult results[2];
    // The order alternates, so that no variant has the advantage of being first.
    for (const bool with_stalled : {round % 2 != 0, round % 2 == 0}) {
      RoundResult& result = results[with_stalled];
      result = RunRound(bench, arguments, scene, with_stalled);
      std::printf("%8d %9lu %5lu %9lu %9.2f %9.2f %8.1f %9.2f %8.2f\n", with_stalled ? arguments.stalled : 0,
                  static_cast<unsigned long>(result.poses), static_cast<unsigned long>(result.lost),
                  static_cast<unsigned long>(result.watched), result.p50_ms, result.p99_ms, result.peak_mb,
                  result.scrape_ms, result.idle_scrape_ms);
      std::fflush(stdout);
      is_good &= result.is_good && result.lost == 0;
      most_mb = std::max(most_mb, result.peak_mb);
      scrape_ms = std::max(scrape_ms, result.scrape_ms);
      idle_scrape_ms = std::max(idle_scrape_ms, result.idle_scrape_ms);
    }
    ratios.push_back(results[1].p99_ms / results[0].p99_ms);
  }
  const double ratio = UpperMedian(ratios);
  const double mb_per_session = (most_mb - before_mb) / arguments.sessions;
  std::printf("p99 with the stalled over without them: %.2f (at most 2)\n", ratio);
  std::printf("memory per session at the peak: %.1f MB (at most 32), above %.1f MB without any\n", mb_per_session,
              before_mb);
  std::printf("a scrape of /metrics: %.2f ms while they stream, %.2f ms at rest (at most 10)\n", scrape_ms,
              idle_scrape_ms);
  std::printf("poses: %s\n", is_good ? "none lost" : "LOST, or a stream failed");
  return is_good && ratio <= 2.0 && mb_per_session <= 32.0 && std::max(scrape_ms, idle_scrape_ms) <= 10.0 ? 0 : 1;
}

// The soak test: repeatedly creates, streams, watches and deletes sessions.
int RunSoak(const Arguments& arguments) {
  constexpr int kAtOnce = 4;
  const Scene scene = MakeScene(0.5, 1e6 * arguments.rate_mev_s);
  Bench bench(arguments, scene);
  if (!bench.Upload()) return 1;
  const auto end = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                      std::chrono::duration<double, std::ratio<60>>(arguments.minutes));
  // The baseline is measured after a sixth of the time, ten minutes of an hour.
  const auto settled = Clock::now() + (end - Clock::now()) / 6;
  double settled_mb = 0.0, mb = 0.0, most_mb = 0.0;
  long settled_descriptors = 0, descriptors = 0;
  uint64_t cycles = 0, poses = 0;
  bool is_good = true;
  for (auto report = Clock::now(); Clock::now() < end; cycles += kAtOnce) {
    Arguments few = arguments;
    few.sessions = kAtOnce;
    few.watchers = 2 * kAtOnce;
    few.stalled = kAtOnce;
    const RoundResult result = RunRound(bench, few, scene, true);
    is_good &= result.is_good && result.lost == 0;
    poses += result.poses;
    mb = bench.ResidentMb();
    descriptors = bench.Descriptors();
    if (Clock::now() <= settled) {
      settled_mb = std::max(settled_mb, mb);
      settled_descriptors = std::max(settled_descriptors, descriptors);
    }
    most_mb = std::max(most_mb, mb);
    if (Clock::now() < report) continue;
    report = Clock::now() + (end - Clock::now()) / 20 + std::chrono::seconds(1);
    std::printf("%8lu sessions %9lu poses %8.1f MB %4ld descriptors\n", static_cast<unsigned long>(cycles + kAtOnce),
                static_cast<unsigned long>(poses), mb, descriptors);
    std::fflush(stdout);
  }
  const double growth = settled_mb > 0.0 ? most_mb / settled_mb - 1.0 : 0.0;
  std::printf("%lu sessions: memory %+.2f %% after the first sixth (at most 2), descriptors %ld, then %ld; %s\n",
              static_cast<unsigned long>(cycles), 100.0 * growth, settled_descriptors, descriptors,
              is_good ? "no pose lost" : "POSES LOST, or a stream failed");
  return is_good && growth <= 0.02 && descriptors <= settled_descriptors ? 0 : 1;
}

int Main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app(
      "Many clients on one evpose-server, which it starts. Exit status 0: all within the limits that it prints.",
      "many_clients");
  app.option_defaults()->always_capture_default();
  app.add_option("--sessions", arguments.sessions)->check(CLI::PositiveNumber);
  app.add_option("--watchers", arguments.watchers, "the stalled ones included");
  app.add_option("--stalled", arguments.stalled, "watchers that read nothing; for each 25 a stream that does so, too");
  app.add_option("--rate", arguments.rate_mev_s, "million events per second and session")->check(CLI::PositiveNumber);
  app.add_option("--seconds", arguments.seconds, "of a round")->check(CLI::PositiveNumber);
  app.add_option("--rounds", arguments.rounds, "each without the stalled and with them")->check(CLI::PositiveNumber);
  app.add_option("--watch-hz", arguments.watch_hz, "poses per second of a watcher")->check(CLI::PositiveNumber);
  app.add_option("--store", arguments.store, "--store of the server: sqlite, memory or redis://HOST:PORT");
  app.add_option("--minutes", arguments.minutes, "of the soak, instead of the load")->check(CLI::NonNegativeNumber);
  CLI11_PARSE(app, argc, argv);
  return arguments.minutes > 0.0 ? RunSoak(arguments) : RunLoad(arguments);
}

}  // namespace
}  // namespace evpose::bench

// NOLINTNEXTLINE(bugprone-exception-escape): an exception ends the program
int main(int argc, char** argv) { return evpose::bench::Main(argc, argv); }
