// SPDX-License-Identifier: Apache-2.0

// evpose bench speed: how long decoding, tracking, the search for a first pose and the way through a server take on
// this machine.
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/bench/bench.h"
#include "client/bench/service_bench.h"
#include "client/cli/common/progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/experiments/speed/speed_bench.h"

namespace evpose::client {
namespace {

struct SpeedArguments {
  std::vector<std::string> parts;
  double duration_s = 0.2;
  int num_repetitions = 7;
  std::string json;
  ServerArguments server;
  int server_pid = 0;
};

std::vector<std::string> AllParts() {
  std::vector<std::string> parts = SpeedParts();
  parts.insert(parts.end(), ServiceParts().begin(), ServiceParts().end());
  return parts;
}

struct Plan {
  SpeedBenchOptions speed;  // without parts: nothing
  ServiceBenchOptions service;
};

// Of those that nobody asked for by name, the ones that a server somewhere else cannot be asked for are left out.
std::vector<std::string> PartsByDefault(const SpeedArguments& arguments) {
  std::vector<std::string> parts = AllParts();
  if (arguments.server.address.empty()) return parts;
  parts.erase(std::remove(parts.begin(), parts.end(), "memory"), parts.end());
  if (arguments.server_pid == 0) parts.erase(std::remove(parts.begin(), parts.end(), "sessions"), parts.end());
  return parts;
}

absl::StatusOr<Plan> MakePlan(const SpeedArguments& arguments) {
  Plan plan;
  for (const std::string& part : arguments.parts.empty() ? PartsByDefault(arguments) : arguments.parts) {
    if (absl::c_linear_search(SpeedParts(), part)) {
      plan.speed.parts.push_back(part);
    } else if (absl::c_linear_search(ServiceParts(), part)) {
      plan.service.parts.push_back(part);
    } else {
      return UsageError(
          absl::StrCat("--parts: no part is called \"", part, "\"; known are: ", absl::StrJoin(AllParts(), ", ")));
    }
  }
  plan.speed.duration_us = plan.service.duration_us = std::llround(1e6 * arguments.duration_s);
  plan.speed.num_repetitions = plan.service.num_repetitions = arguments.num_repetitions;
  plan.service.server = arguments.server;
  plan.service.server_pid = arguments.server_pid;
  if (const absl::Status status = plan.speed.Validate(); !status.ok()) {
    return UsageError(std::string(status.message()));
  }
  return plan;
}

constexpr char kSpeedHeader[] =
    "part        what        scene   Mev/s     events  ns/event   Mev/s   memcpy  ns/line  real time  poses/s\n";

void PrintRow(const SpeedRow& row, std::ostream& out) {
  const std::string memcpy_ratio = row.memcpy_ratio ? absl::StrFormat("%.1f", *row.memcpy_ratio) : "-";
  const std::string ns_per_line = row.num_window_lines > 0 ? absl::StrFormat("%.0f", row.NsPerLine()) : "-";
  const std::string poses_per_s =
      row.num_poses > 0 ? absl::StrFormat("%.0f", static_cast<double>(row.num_poses) / row.seconds) : "-";
  out << absl::StrFormat("%-11s %-11s %5s  %6.1f %10d  %8.2f  %6.1f  %7s  %7s  %9.4f  %7s", row.part, row.what,
                         row.scene, row.rate_mev_per_s, row.num_events, row.NsPerEvent(), row.MevPerS(), memcpy_ratio,
                         ns_per_line, row.RealTimeRatio(), poses_per_s);
  if (row.lines_ratio.value_or(1.0) != 1.0) {
    out << absl::StrFormat("  %.0f times the lines cost %.2f times as much", *row.lines_ratio, *row.cost_ratio);
  }
  out << "\n";
  out.flush();
}

// What rows of both kinds have.
template <typename Row>
Json RowHead(const Row& row) {
  Json json;
  json["part"] = row.part;
  json["what"] = row.what;
  json["scene"] = row.scene;
  json["rate_mev_per_s"] = row.rate_mev_per_s;
  json["events"] = row.num_events;
  return json;
}

Json RowJson(const SpeedRow& row) {
  Json json = RowHead(row);
  if (row.num_bytes > 0) json["bytes"] = row.num_bytes;
  json["seconds"] = row.seconds;
  json["ns_per_event"] = row.NsPerEvent();
  json["mev_per_s"] = row.MevPerS();
  if (row.memcpy_ratio) json["memcpy_ratio"] = *row.memcpy_ratio;
  json["real_time_ratio"] = row.RealTimeRatio();
  json["sensor_seconds"] = row.sensor_seconds;
  if (row.num_lines > 0) json["lines"] = row.num_lines;
  if (row.num_windows > 0) {
    json["windows"] = row.num_windows;
    json["lines_per_window"] = static_cast<double>(row.num_window_lines) / static_cast<double>(row.num_windows);
    json["ns_per_line"] = row.NsPerLine();
  }
  if (row.lines_ratio) json["lines_ratio"] = *row.lines_ratio;
  if (row.cost_ratio) json["cost_ratio"] = *row.cost_ratio;
  if (row.num_poses > 0) {
    json["poses"] = row.num_poses;
    json["poses_per_s"] = static_cast<double>(row.num_poses) / row.seconds;
  }
  json["measure"] = row.memcpy_ratio ? "memcpy_ratio" : "real_time_ratio";
  return json;
}

// The names of the numbers, each as wide as its column.
void PrintHeader(const ServiceRow& row, std::ostream& out) {
  out << absl::StrFormat("\n%-11s %-11s %5s  %6s %10s", "part", "what", "scene", "Mev/s", "events");
  for (const NamedNumber& number : row.numbers) out << "  " << absl::StrFormat("%10s", number.name);
  out << "\n";
}

void PrintRow(const ServiceRow& row, std::ostream& out) {
  out << absl::StrFormat("%-11s %-11s %5s  %6.1f %10d", row.part, row.what, row.scene, row.rate_mev_per_s,
                         row.num_events);
  for (const NamedNumber& number : row.numbers) {
    const int width = std::max<int>(10, static_cast<int>(number.name.size()));
    out << "  " << absl::StrFormat("%*.*f", width, number.value < 1000.0 ? 3 : 0, number.value);
  }
  out << "\n";
  out.flush();
}

Json RowJson(const ServiceRow& row) {
  Json json = RowHead(row);
  for (const NamedNumber& number : row.numbers) json[number.name] = number.value;
  json["measure"] = row.measure;
  if (row.more_is_better) json["more_is_better"] = true;
  return json;
}

// Runs what is planned; the rows are printed as they come.
absl::Status Measure(const Plan& plan, CliContext& context, Json& rows) {
  ProgressLine progress(context);
  const auto on_progress = [&](double ratio, const std::string& text) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  %s", 100.0 * ratio, text));
    return !context.IsInterrupted();
  };
  if (!plan.speed.parts.empty()) {
    context.out << kSpeedHeader;
    const auto on_row = [&](const SpeedRow& row) {
      progress.Clear();
      PrintRow(row, context.out);
      rows.push_back(RowJson(row));
    };
    EVPOSE_RETURN_IF_ERROR(RunSpeedBench(plan.speed, on_row, on_progress));
  }
  if (plan.service.parts.empty()) return absl::OkStatus();
  std::string last_part;
  const auto on_row = [&](const ServiceRow& row) {
    progress.Clear();
    if (row.part != last_part) PrintHeader(row, context.out);
    last_part = row.part;
    PrintRow(row, context.out);
    rows.push_back(RowJson(row));
  };
  return RunServiceBench(plan.service, context, on_row, on_progress);
}

absl::Status RunSpeed(const SpeedArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const Plan plan, MakePlan(arguments));
  // What cannot be written is said before the work, not after it.
  std::optional<OutputFile> file;
  if (!arguments.json.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(file, OutputFile::Create(arguments.json));
  }
  Json rows = Json::array();
  EVPOSE_RETURN_IF_ERROR(Measure(plan, context, rows));
  if (!file) return absl::OkStatus();
  Json json;
  json["duration_s"] = 1e-6 * static_cast<double>(plan.speed.duration_us);
  json["repetitions"] = plan.speed.num_repetitions;
  json["rows"] = std::move(rows);
  EVPOSE_RETURN_IF_ERROR(file->Append(json.dump(2) + "\n"));
  return file->Commit();
}

std::string About() {
  std::string text =
      "One thread, its processor time, the least of the repetitions.\n"
      "  decode      bytes to events, in pieces of 256 KiB; memcpy: ratio to copying the same bytes, alternately\n"
      "  windows     events to windows\n"
      "  associate   events to the lines that they may be of; with 16 times the lines, too: each one cut into 16\n"
      "  estimate    associated events, at most 1200 of a window, to a pose; likewise\n"
      "  track       events to poses, from the true first pose; real time: processor time per sensor time\n"
      "  initialize  events to the first pose, of which nothing is known\n"
      "\nThrough gRPC on this machine; an evpose-server is started for it, and stopped, unless there is --server.\n"
      "  transport   chunks of 256 KiB to a server in this process that does nothing with them; memcpy: as above\n"
      "  path        EVT3 to poses, as fast as may be; ratio to the tracker alone in the same run, processor time of\n"
      "              both sides, seconds for 10^9 events\n"
      "  latency     at the sensor's pace in chunks of 1 ms: until a pose is here, from the end of the chunk that\n"
      "              completes its window, from the window's end, and of that what the server takes\n"
      "  sessions    1, 4, 16 and 64 at once: the server's processor time for one, and its ratio to one alone\n"
      "  memory      by how much the server grows, at most, while one session is fed, and then for each of 8 more at "
      "once\n"
      "\nScenes of the simulator, by their million events per second:\n";
  for (const SpeedScene& scene : SpeedScenes()) {
    absl::StrAppend(&text, absl::StrFormat("  %-4s %s\n", scene.name, scene.description));
  }
  return text;
}

}  // namespace

CommandRunner AddBenchSpeedCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<SpeedArguments>();
  app.add_option("--parts", arguments->parts, "Some of " + absl::StrJoin(AllParts(), ", "))
      ->delimiter(',')
      ->type_name("NAME,...");
  app.add_option("--duration", arguments->duration_s, "Seconds of each recording")
      ->check(CLI::Range(0.01, 10.0))
      ->capture_default_str();
  app.add_option("--repetitions", arguments->num_repetitions, "The least time of so many counts")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--json", arguments->json,
                 "The table as a file, for tests/bench/compare.py; written whole or not at all")
      ->type_name("FILE");
  arguments->server.AddTo(app, false);
  app.add_option("--server-pid", arguments->server_pid,
                 "Process of --server on this machine: its processor time is that of the server's side")
      ->type_name("PID")
      ->check(CLI::Range(1, 1 << 22))
      ->needs(app.get_option("--server"))
      ->group("The server");
  app.footer(absl::StrCat(About(), "\nExample:\n  evpose bench speed --parts decode --duration 0.1 --json speed.json"));
  return [arguments, &context] { return RunSpeed(*arguments, context); };
}

}  // namespace evpose::client
