// SPDX-License-Identifier: Apache-2.0

// evpose bench speed: time of decoding, of tracking, of the search for a first pose and of the path through a server on
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
#include "client/cli/console/progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/experiments/speed/speed_bench.h"

namespace evpose::client {
namespace {

struct SpeedArguments {
  std::vector<std::string> parts;
  double duration_s = 0.2;
  std::string out;
  ServiceBenchOptions service;  // without the parts and the duration
};

std::vector<std::string> AllParts() {
  std::vector<std::string> parts = SpeedParts();
  parts.insert(parts.end(), kServiceParts.begin(), kServiceParts.end());
  return parts;
}

struct Plan {
  SpeedBenchOptions speed;  // not run if it has no parts
  ServiceBenchOptions service;
};

// The parts that are run without --parts: all that can be measured with the server given.
std::vector<std::string> PartsByDefault(const SpeedArguments& arguments) {
  std::vector<std::string> parts = AllParts();
  if (arguments.service.server.address.empty()) return parts;
  parts.erase(std::remove(parts.begin(), parts.end(), "memory"), parts.end());
  if (arguments.service.server_pid == 0) parts.erase(std::remove(parts.begin(), parts.end(), "sessions"), parts.end());
  return parts;
}

absl::StatusOr<Plan> MakePlan(const SpeedArguments& arguments) {
  Plan plan = {.service = arguments.service};
  for (const std::string& part : arguments.parts.empty() ? PartsByDefault(arguments) : arguments.parts) {
    if (absl::c_linear_search(SpeedParts(), part)) {
      plan.speed.parts.push_back(part);
    } else if (absl::c_linear_search(kServiceParts, part)) {
      plan.service.parts.push_back(part);
    } else {
      return UsageError(
          absl::StrCat("--parts: no part is called \"", part, "\"; known are: ", absl::StrJoin(AllParts(), ", ")));
    }
  }
  plan.speed.duration_us = plan.service.duration_us = std::llround(1e6 * arguments.duration_s);
  plan.speed.num_repetitions = plan.service.num_repetitions;
  EVPOSE_RETURN_IF_ERROR(AsUsageError(plan.speed.Validate()));
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

// The fields that rows of both kinds have.
template <typename Row>
Json RowHead(const Row& row) {
  return {{"part", row.part},
          {"what", row.what},
          {"scene", row.scene},
          {"rate_mev_per_s", row.rate_mev_per_s},
          {"events", row.num_events}};
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

// Prints the names of the numbers, each as wide as its column.
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

// Runs the plan and prints each row when it is measured.
absl::Status Measure(const Plan& plan, CliContext& context, Json& rows) {
  ProgressLine progress(context);
  const auto num_parts = static_cast<double>(plan.speed.parts.size() + plan.service.parts.size());
  const double speed_share = static_cast<double>(plan.speed.parts.size()) / num_parts;
  double begin = 0.0, share = speed_share;  // of the present kind of parts, in the whole work
  const SpeedProgress on_progress = [&](double ratio, const std::string& text) {
    const double done = begin + share * ratio;
    progress.Show(done, absl::StrFormat("%3.0f %%  %s", 100.0 * done, text));
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
  begin = speed_share, share = 1.0 - speed_share;
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
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> file, OpenOutput(arguments.out));
  Json rows = Json::array();
  EVPOSE_RETURN_IF_ERROR(Measure(plan, context, rows));
  Json json = {{"duration_s", 1e-6 * static_cast<double>(plan.speed.duration_us)},
               {"repetitions", plan.speed.num_repetitions},
               {"rows", std::move(rows)}};
  return FinishOutput(file, json.dump(2) + "\n");
}

std::string About() {
  std::string text =
      "Processor time of one thread; the minimum over the repetitions.\n"
      "  decode      decode bytes to events, in pieces of 256 KiB; memcpy: ratio to copying the same bytes\n"
      "  windows     cut events into windows\n"
      "  associate   find the events near the predicted lines; also with each line cut into 16 pieces\n"
      "  estimate    estimate a pose from the associated events, at most 1200 per window; also with 16 pieces\n"
      "  track       events to poses, from the true first pose; real time: processor time per sensor time\n"
      "  initialize  events to the first pose, without prior knowledge\n"
      "\nThrough gRPC on this machine. Without --server, an evpose-server is started and stopped again.\n"
      "  transport   chunks of 256 KiB to a server in this process that discards them; memcpy: as above\n"
      "  path        EVT3 to poses, as fast as possible; ratio to the tracker alone in the same run; processor time "
      "of\n"
      "              both sides, seconds for 10^9 events\n"
      "  latency     in real time in chunks of 1 ms: until a pose arrives, from the end of the chunk that completes "
      "its\n"
      "              window, from the end of the window, and the part of it within the server\n"
      "  sessions    1, 4, 16 and 64 concurrent sessions: processor time of the server per session, and its ratio to\n"
      "              that of a single session\n"
      "  memory      growth of the server's memory, at its peak, by a first session, and per session by 8 more\n"
      "\nSimulated scenes, named by their million events per second:\n";
  for (const SpeedScene& scene : SpeedScenes()) {
    absl::StrAppend(&text, absl::StrFormat("  %-4s %s\n", scene.name, scene.description));
  }
  return text;
}

}  // namespace

CommandRunner AddBenchSpeedCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<SpeedArguments>();
  app.option_defaults()->group(kExperimentGroup);
  AddNames(app, "--parts", arguments->parts, "Run only these parts: " + absl::StrJoin(AllParts(), ", "));
  AddOption(app, "--duration", arguments->duration_s, "Length of each recording", NumberRange(0.01, 10.0))
      ->type_name("SECONDS");
  AddOption(app, "--repetitions", arguments->service.num_repetitions,
            "Number of repetitions; the shortest time is reported", NumberRange(1, 1000));
  AddOutputFile(app, "-o,--out", arguments->out,
                "JSON with the table, for tests/bench/compare.py; the file appears when it is complete")
      ->group(kOutputGroup);
  arguments->service.server.AddTo(app, false);
  app.add_option("--server-pid", arguments->service.server_pid,
                 "Process of --server on this machine, for the processor time of the server")
      ->type_name("PID")
      ->check(NumberRange(1, 1 << 22))
      ->needs(app.get_option("--server"))
      ->group(kConnectionGroup);
  app.footer(absl::StrCat(About(), "\nExample:\n  evpose bench speed --parts decode --duration 0.1 --out speed.json"));
  return [arguments, &context] { return RunSpeed(*arguments, context); };
}

}  // namespace evpose::client
