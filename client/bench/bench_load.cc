// SPDX-License-Identifier: Apache-2.0

// evpose bench load: many sessions on running servers, for their capacity.
#include <chrono>
#include <cmath>
#include <future>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/bench/bench.h"
#include "client/bench/bench_session.h"
#include "client/bench/load_run.h"
#include "client/bench/metrics_page.h"
#include "client/cli/console/progress.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/numerics/statistics.h"

namespace evpose::client {
namespace {

struct LoadArguments {
  ServerArguments server;
  int sessions = 16;
  double rate_hz = 1e6;
  double minutes = 1.0;
  double churn_per_minute = 0.0;
  int watchers = 0;
  double watch_hz = 30.0;
  double chunk_ms = 1.0;
  std::vector<std::string> metrics;
  bool is_json = false;
};

using Uses = std::vector<absl::StatusOr<ServerUse>>;

// Reads the pages in another thread, because the sender does not wait.
std::future<Uses> ReadLater(const std::vector<std::string>& pages) {
  return std::async(std::launch::async, [pages] {
    Uses uses;
    for (const std::string& page : pages) uses.push_back(ReadServerUse(page));
    return uses;
  });
}

struct Outcome {
  LoadResult result;
  std::vector<std::pair<ServerUse, ServerUse>> uses;  // before and after, in the order of --metrics
};

absl::StatusOr<Outcome> Measure(const LoadArguments& arguments, CliContext& context) {
  // A wrong address is an error before the work.
  for (const auto& use : ReadLater(arguments.metrics).get()) EVPOSE_RETURN_IF_ERROR(use.status());
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  ProgressLine progress(context);
  const auto on_simulated = [&](double ratio) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  simulating", 100.0 * ratio));
    return !context.IsInterrupted();
  };
  EVPOSE_ASSIGN_OR_RETURN(const LoadRecording recording,
                          LoadRecording::Make(arguments.rate_hz, std::llround(1e3 * arguments.chunk_ms), on_simulated));
  LoadOptions options;
  options.addresses = arguments.server.address;
  EVPOSE_ASSIGN_OR_RETURN(options.client, arguments.server.Options(context));
  EVPOSE_ASSIGN_OR_RETURN(options.config, UploadSession(*client, recording.scene(), Encoding::kEvt3));
  options.sessions = arguments.sessions;
  options.minutes = arguments.minutes;
  options.churn_per_minute = arguments.churn_per_minute;
  options.watchers = arguments.watchers;
  options.watch_hz = arguments.watch_hz;
  std::future<Uses> before, after;
  options.on_begin = [&] { before = ReadLater(arguments.metrics); };
  options.on_end = [&] { after = ReadLater(arguments.metrics); };
  options.is_read = [&] {
    const std::future<Uses>& last = after.valid() ? after : before;
    return last.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  };
  const auto on_progress = [&](double ratio, const LoadCounts& counts) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  %d sessions created, %d poses, %d lost", 100.0 * ratio,
                                         counts.created, counts.poses, counts.lost_poses));
    return !context.IsInterrupted();
  };
  Outcome outcome;
  EVPOSE_ASSIGN_OR_RETURN(outcome.result, RunLoad(options, recording, on_progress));
  progress.Clear();
  Uses first = before.get();
  Uses last = after.get();
  for (size_t i = 0; i < first.size(); ++i) {
    EVPOSE_RETURN_IF_ERROR(first[i].status());
    EVPOSE_RETURN_IF_ERROR(last[i].status());
    outcome.uses.emplace_back(*first[i], *last[i]);
  }
  return outcome;
}

// The distribution of the longest pauses of sessions; null where there is no session.
Json PausesToJson(const std::vector<double>& sorted_s) {
  const auto at = [&sorted_s](double fraction) {
    return sorted_s.empty() ? Json() : Json(NearestQuantile(sorted_s, fraction));
  };
  return {{"sessions", sorted_s.size()}, {"p50_s", at(0.5)}, {"p99_s", at(0.99)}, {"max_s", at(1.0)}};
}

// Null if the store does not report its processor time.
Json StoreCpuS(const ServerUse& before, const ServerUse& after) {
  if (!before.store_cpu_s.has_value() || !after.store_cpu_s.has_value()) return Json();
  return *after.store_cpu_s - *before.store_cpu_s;
}

std::string StoreText(const ServerUse& before, const ServerUse& after) {
  const Json cpu_s = StoreCpuS(before, after);
  std::string text = cpu_s.is_null() ? "no CPU of its own" : absl::StrFormat("CPU %.2f s", cpu_s.get<double>());
  if (before.store_mb.has_value() && after.store_mb.has_value()) {
    absl::StrAppendFormat(&text, ", %.1f MB before, %.1f MB after", *before.store_mb, *after.store_mb);
  }
  return text;
}

std::string PausesText(const Json& pauses) {
  if (pauses["sessions"] == 0) return "0 sessions";
  const auto seconds = [&pauses](const char* name) { return pauses[name].get<double>(); };
  return absl::StrFormat("%d sessions: p50 %.3f, p99 %.3f, max %.3f s", pauses["sessions"].get<size_t>(),
                         seconds("p50_s"), seconds("p99_s"), seconds("max_s"));
}

Json ToJson(const Outcome& outcome, const LoadArguments& arguments) {
  const LoadResult& result = outcome.result;
  const LoadCounts& counts = result.counts;
  const auto ms_of = [&](double fraction) {
    return 1e-3 * static_cast<double>(std::min(counts.latency.Percentile(fraction), counts.max_latency_us));
  };
  const std::vector<double> reconnected = counts.SortedPausesS(true);
  Json servers = Json::array();
  for (size_t i = 0; i < outcome.uses.size(); ++i) {
    const auto& [before, after] = outcome.uses[i];
    servers.push_back({{"metrics", arguments.metrics[i]},
                       {"cpu_s", after.cpu_s - before.cpu_s},
                       {"resident_mb_before", before.resident_mb},
                       {"resident_mb_after", after.resident_mb},
                       {"load_ratio_before", before.load_ratio},
                       {"load_ratio_after", after.load_ratio},
                       {"store_cpu_s", StoreCpuS(before, after)},
                       {"store_mb_before", OrNull(before.store_mb)},
                       {"store_mb_after", OrNull(after.store_mb)}});
  }
  return {{"sessions", arguments.sessions},
          {"rate_events_per_s", arguments.rate_hz},
          {"seconds", result.seconds},
          {"created", counts.created},
          {"completed", counts.completed},
          {"refused", counts.refusals},
          {"failed", counts.failures},
          {"unfinished", counts.unfinished},
          {"events", counts.events},
          {"poses", counts.poses},
          {"lost_poses", counts.lost_poses},
          {"latency_p50_ms", ms_of(0.5)},
          {"latency_p90_ms", ms_of(0.9)},
          {"latency_p99_ms", ms_of(0.99)},
          {"latency_max_ms", 1e-3 * static_cast<double>(counts.max_latency_us)},
          {"pauses", PausesToJson(counts.SortedPausesS(false))},
          {"reconnections", counts.reconnections},
          {"reconnected_pauses", PausesToJson(reconnected)},
          {"reconnected_pauses_s", reconnected},
          {"watched_poses", counts.watched_poses},
          {"unwatched_poses", counts.unwatched_poses},
          {"cpu_s", result.cpu_s},
          {"late_p99_ms", 1e-3 * static_cast<double>(std::min(result.late_p99_us, result.late_max_us))},
          {"late_max_ms", 1e-3 * static_cast<double>(result.late_max_us)},
          {"servers", std::move(servers)}};
}

std::string Reasons(const std::map<std::string, uint64_t>& counts) {
  if (counts.empty()) return "0";
  return absl::StrJoin(
      counts, ", ", [](std::string* out, const auto& entry) { absl::StrAppend(out, entry.first, " ", entry.second); });
}

void Print(const Outcome& outcome, const LoadArguments& arguments, std::ostream& out) {
  const LoadResult& result = outcome.result;
  const LoadCounts& counts = result.counts;
  const Json json = ToJson(outcome, arguments);
  const auto number = [&json](const char* name) { return json[name].get<double>(); };
  const auto row = [&out](const char* name, const std::string& value) {
    out << absl::StrFormat("%-22s %s\n", name, value);
  };
  row("sessions created", absl::StrCat(counts.created, " (", counts.completed, " completed)"));
  row("sessions refused", Reasons(counts.refusals));
  row("sessions failed", Reasons(counts.failures));
  if (counts.unfinished > 0) row("sessions unfinished", absl::StrCat(counts.unfinished));
  row("events", absl::StrFormat("%.3f Mev in %.1f s", 1e-6 * static_cast<double>(counts.events), result.seconds));
  row("poses received", absl::StrCat(counts.poses));
  row("poses lost", absl::StrCat(counts.lost_poses));
  row("latency", absl::StrFormat("p50 %.2f, p90 %.2f, p99 %.2f, max %.2f ms", number("latency_p50_ms"),
                                 number("latency_p90_ms"), number("latency_p99_ms"), number("latency_max_ms")));
  row("longest pauses", PausesText(json["pauses"]));
  row("after reconnection", PausesText(json["reconnected_pauses"]));
  row("reconnections", absl::StrCat(counts.reconnections));
  if (arguments.watchers > 0) {
    row("poses watched", absl::StrCat(counts.watched_poses, " (", counts.unwatched_poses, " too late for a watcher)"));
  }
  row("CPU of this process", absl::StrFormat("%.2f s; late by p99 %.2f, max %.2f ms", result.cpu_s,
                                             number("late_p99_ms"), number("late_max_ms")));
  for (size_t i = 0; i < outcome.uses.size(); ++i) {
    const auto& [before, after] = outcome.uses[i];
    row("server", absl::StrFormat("%s: CPU %.2f s, memory %.1f MB before, %.1f MB after, load %.2f before, %.2f after",
                                  arguments.metrics[i], after.cpu_s - before.cpu_s, before.resident_mb,
                                  after.resident_mb, before.load_ratio, after.load_ratio));
    row("its store", StoreText(before, after));
  }
}

absl::Status Run(const LoadArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const Outcome outcome, Measure(arguments, context));
  EVPOSE_RETURN_IF_ERROR(PrintResult(context, arguments.is_json, ToJson(outcome, arguments),
                                     [&](std::ostream& out) { Print(outcome, arguments, out); }));
  const LoadCounts& counts = outcome.result.counts;
  if (counts.created == 0) {
    return absl::UnavailableError(
        absl::StrCat("no session was created (", Reasons(counts.refusals), "): free the servers, or give others"));
  }
  if (counts.IsComplete()) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(counts.lost_poses,
                                          " poses were lost; sessions that failed: ", Reasons(counts.failures),
                                          "; unfinished: ", counts.unfinished, "; the servers' logs have the reasons"));
}

constexpr char kAboutLoad[] =
    "One simulated recording is encoded once, before the start, and shared by all sessions, each of which has it from "
    "the beginning. It is played forwards and backwards without an end; only the time words of a repetition differ. "
    "Sensor time is stretched until the rate is that of --rate, so the object moves slowly at a low rate.\n"
    "\n"
    "A session attaches again after an error of a server or of the network, at the next address of --server. A refused "
    "creation is repeated after the delay that the server asks for.\n"
    "\n"
    "Latency: from the time at which the chunk that completes a window was to be sent, so the wait for credit and for "
    "another server counts, until its pose has arrived; exact to one chunk and to 5 %. \"late\": how late this process "
    "itself was; if that is not far below the latency, the machine is too slow for the load. Poses lost: missing "
    "numbers, and poses that the server no longer had. Longest pauses: the longest time between two poses of each "
    "session, of all sessions and of those that attached again after an error. Numbers of events and poses: those of "
    "the test itself, after the creation of the sessions and before their end; losses, failures and sessions: those of "
    "the whole run.\n"
    "\n"
    "Exit status:\n"
    "  0  No pose was lost and no session failed\n"
    "  1  Poses were lost, or a session failed, or none was created\n"
    "  2  Wrong usage\n"
    "\nExample:\n"
    "  evpose bench load --server 127.0.0.1:50051 --sessions 4 --rate 20000 --minutes 0.02";

}  // namespace

CommandRunner AddBenchLoadCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<LoadArguments>();
  app.option_defaults()->group(kExperimentGroup);
  AddOption(app, "--sessions", arguments->sessions, "Number of sessions at a time", NumberRange(1, 100'000));
  AddOption(app, "--rate", arguments->rate_hz, "Events per second of each session",
            NumberRange(LoadRecording::kMinRateHz, LoadRecording::kMaxRateHz))
      ->type_name("HZ");
  AddOption(app, "--minutes", arguments->minutes, "Length of the test, after the creation of the sessions",
            NumberRange(0.001, 1e5))
      ->type_name("MINUTES");
  AddOption(app, "--churn", arguments->churn_per_minute,
            "Number of sessions per minute that end and are replaced by new ones", NumberRange(0.0, 1e5))
      ->type_name("PER_MINUTE");
  AddOption(app, "--watchers", arguments->watchers, "Number of readers of poses, of all sessions together",
            NumberRange(0, 100'000));
  AddOption(app, "--watch-hz", arguments->watch_hz, "Most poses per second for a watcher", NumberRange(0.1, 1e4))
      ->type_name("HZ");
  AddOption(app, "--chunk-ms", arguments->chunk_ms, "Period of the chunks of events",
            NumberRange(1.0, 1e-3 * static_cast<double>(LoadRecording::kMaxChunkUs)))
      ->type_name("MILLISECONDS");
  AddNames(
      app, "--metrics", arguments->metrics,
      "Addresses of the servers' pages (--metrics-listen), for the processor time and the memory of servers and store")
      ->type_name("HOST:PORT,...");
  AddJson(app, arguments->is_json)->group(kOutputGroup);
  arguments->server.AddTo(app, true);
  app.footer(kAboutLoad);
  return [arguments, &context] { return Run(*arguments, context); };
}

}  // namespace evpose::client
