// evpose bench speed: how long decoding, tracking and the search for a first pose take on this machine.
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/bench.h"
#include "client/cli/progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/experiments/speed_bench.h"

namespace evpose::client {
namespace {

struct SpeedArguments {
  std::vector<std::string> parts;
  double duration_s = 0.2;
  int num_repetitions = 7;
  std::string json;
};

absl::StatusOr<SpeedBenchOptions> MakeOptions(const SpeedArguments& arguments) {
  SpeedBenchOptions options;
  options.parts = arguments.parts;
  options.duration_us = std::llround(1e6 * arguments.duration_s);
  options.num_repetitions = arguments.num_repetitions;
  if (const absl::Status status = options.Validate(); !status.ok()) return UsageError(std::string(status.message()));
  return options;
}

constexpr char kHeader[] =
    "part        what        scene   Mev/s     events  ns/event   Mev/s   memcpy  real time  poses/s\n";

void PrintRow(const SpeedRow& row, std::ostream& out) {
  const std::string memcpy_ratio = row.memcpy_ratio ? absl::StrFormat("%.1f", *row.memcpy_ratio) : "-";
  const std::string poses_per_s =
      row.num_poses > 0 ? absl::StrFormat("%.0f", static_cast<double>(row.num_poses) / row.seconds) : "-";
  out << absl::StrFormat("%-11s %-11s %5s  %6.1f %10d  %8.2f  %6.1f  %7s  %9.4f  %7s\n", row.part, row.what, row.scene,
                         row.rate_mev_per_s, row.num_events, row.NsPerEvent(), row.MevPerS(), memcpy_ratio,
                         row.RealTimeRatio(), poses_per_s);
  out.flush();
}

Json RowJson(const SpeedRow& row) {
  Json json;
  json["part"] = row.part;
  json["what"] = row.what;
  json["scene"] = row.scene;
  json["rate_mev_per_s"] = row.rate_mev_per_s;
  json["events"] = row.num_events;
  if (row.num_bytes > 0) json["bytes"] = row.num_bytes;
  json["seconds"] = row.seconds;
  json["ns_per_event"] = row.NsPerEvent();
  json["mev_per_s"] = row.MevPerS();
  if (row.memcpy_ratio) json["memcpy_ratio"] = *row.memcpy_ratio;
  json["real_time_ratio"] = row.RealTimeRatio();
  json["sensor_seconds"] = row.sensor_seconds;
  if (row.num_lines > 0) json["lines"] = row.num_lines;
  if (row.num_poses > 0) {
    json["poses"] = row.num_poses;
    json["poses_per_s"] = static_cast<double>(row.num_poses) / row.seconds;
  }
  return json;
}

absl::Status RunSpeed(const SpeedArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const SpeedBenchOptions options, MakeOptions(arguments));
  // What cannot be written is said before the work, not after it.
  std::optional<OutputFile> file;
  if (!arguments.json.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(file, OutputFile::Create(arguments.json));
  }
  ProgressLine progress(context);
  Json rows = Json::array();
  context.out << kHeader;
  const auto on_row = [&](const SpeedRow& row) {
    progress.Clear();
    PrintRow(row, context.out);
    rows.push_back(RowJson(row));
  };
  const auto on_progress = [&](double ratio, const std::string& text) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  %s", 100.0 * ratio, text));
    return !context.IsInterrupted();
  };
  EVPOSE_RETURN_IF_ERROR(RunSpeedBench(options, on_row, on_progress));
  if (!file) return absl::OkStatus();
  Json json;
  json["duration_s"] = 1e-6 * static_cast<double>(options.duration_us);
  json["repetitions"] = options.num_repetitions;
  json["rows"] = std::move(rows);
  EVPOSE_RETURN_IF_ERROR(file->Append(json.dump(2) + "\n"));
  return file->Commit();
}

std::string About() {
  std::string text =
      "One thread, its processor time, the least of the repetitions.\n"
      "  decode      bytes to events, in pieces of 256 KiB; memcpy: ratio to copying the same bytes, alternately\n"
      "  windows     events to windows\n"
      "  track       events to poses, from the true first pose; real time: processor time per sensor time\n"
      "  initialize  events to the first pose, of which nothing is known\n"
      "\nScenes of the simulator, by their million events per second:\n";
  for (const SpeedScene& scene : SpeedScenes()) {
    absl::StrAppend(&text, absl::StrFormat("  %-4s %s\n", scene.name, scene.description));
  }
  return text;
}

}  // namespace

CommandRunner AddBenchSpeedCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<SpeedArguments>();
  app.add_option("--parts", arguments->parts, "Some of " + absl::StrJoin(SpeedParts(), ", "))
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
  app.footer(absl::StrCat(About(), "\nExample:\n  evpose bench speed --parts decode --duration 0.1 --json speed.json"));
  return [arguments, &context] { return RunSpeed(*arguments, context); };
}

}  // namespace evpose::client
