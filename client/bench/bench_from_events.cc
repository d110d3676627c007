// SPDX-License-Identifier: Apache-2.0
#include "client/bench/bench_from_events.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/common/table_cell.h"
#include "client/cli/console/progress.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/experiments/first_pose/event_trials.h"
#include "core/numerics/statistics.h"
#include "core/simulation/simulator.h"

namespace evpose::client {
namespace {

// The object is out of view for this long: far longer than a track survives without support.
constexpr int64_t kAbsenceUs = 1'000'000;
// A return counts as in time if the object is tracked again from this much of events.
constexpr int64_t kReturnBudgetUs = 100'000;

struct ObjectResult {
  std::string object;
  std::vector<EventTrial> trials;
  EventTrialSummary summary;
  std::vector<ReturnTrial> returns;
};

// Sorted times until the object is tracked again, milliseconds; infinity if it is not.
std::vector<double> ReturnTimesMs(const ObjectResult& result) {
  std::vector<double> times_ms;
  for (const ReturnTrial& trial : result.returns) {
    times_ms.push_back(trial.tracked_us < 0 ? std::numeric_limits<double>::infinity()
                                            : static_cast<double>(trial.tracked_us) * 1e-3);
  }
  std::sort(times_ms.begin(), times_ms.end());
  return times_ms;
}

int NumBackInTime(const ObjectResult& result) {
  return static_cast<int>(std::count_if(result.returns.begin(), result.returns.end(), [](const ReturnTrial& trial) {
    return trial.tracked_us >= 0 && trial.tracked_us <= kReturnBudgetUs;
  }));
}

// Longest time of wrong poses, after starts and after returns.
double LongestWrongMs(const ObjectResult& result) {
  int64_t longest_us = result.summary.longest_wrong_us;
  for (const ReturnTrial& trial : result.returns) longest_us = std::max(longest_us, trial.wrong_us);
  return static_cast<double>(longest_us) * 1e-3;
}

absl::StatusOr<ObjectResult> RunObject(const FromEventsArguments& arguments, const std::string& name, uint64_t seed,
                                       CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const SimulatedObject object, ParseSimulatedObject(name));
  ProgressLine progress(context);
  const auto go_on = [&](const std::string& what, double ratio) {
    progress.Show(ratio, absl::StrFormat("%s: %s %3.0f %%", name, what, 100.0 * ratio));
    return !context.IsInterrupted();
  };
  ObjectResult result;
  result.object = name;
  EventTrialOptions options = arguments.trial;
  options.object = object;
  options.recording_us = std::llround(arguments.duration_s * 1e6);
  options.seed = seed;
  EVPOSE_ASSIGN_OR_RETURN(result.trials, RunEventTrials(options, [&](double ratio) { return go_on("starts", ratio); }));
  result.summary = Summarize(result.trials);
  for (int i = 0; i < arguments.num_returns; ++i) {
    const auto on_progress = [&](double ratio) { return go_on("returns", (i + ratio) / arguments.num_returns); };
    EventTrialOptions again = options;
    again.seed = seed + static_cast<uint64_t>(i);
    EVPOSE_ASSIGN_OR_RETURN(const ReturnTrial trial, RunReturnTrial(again, kAbsenceUs, on_progress));
    result.returns.push_back(trial);
  }
  return result;
}

constexpr char kFromEventsHeader[] =
    "                                                 first pose  reprojection    longest  back in 100 ms  after a "
    "second's absence\n"
    "object      detector  starts  right %  wrong  none  median ms   px of right   wrong ms   of returns     median ms "
    "  worst ms\n";

void PrintResult(const ObjectResult& result, const std::string& detector, std::ostream& out) {
  const EventTrialSummary& summary = result.summary;
  std::vector<double> times_ms = ReturnTimesMs(result);
  const double worst_ms = times_ms.empty() ? std::nan("") : times_ms.back();
  const double median_ms = times_ms.empty() ? std::nan("") : UpperMedian(times_ms);
  out << absl::StrFormat("%-11s %-8s  %6d  %7.1f  %5d  %4d %10s %13s %10.1f %12s %13s %10s\n", result.object, detector,
                         summary.num_starts, 100.0 * summary.num_right / summary.num_starts, summary.num_wrong,
                         summary.num_none, Cell(summary.first_pose_median_ms, 1), Cell(summary.reprojection_mean_px, 2),
                         LongestWrongMs(result), absl::StrCat(NumBackInTime(result), "/", result.returns.size()),
                         Cell(median_ms, 1), Cell(worst_ms, 1));
  out.flush();
}

// null if there is none.
Json TimeJson(int64_t t_us) { return t_us < 0 ? Json() : Json(t_us); }

Json ResultJson(const ObjectResult& result, const std::string& detector) {
  const EventTrialSummary& summary = result.summary;
  Json json = {{"object", result.object},
               {"detector", detector},
               {"starts", summary.num_starts},
               {"right", summary.num_right},
               {"wrong", summary.num_wrong},
               {"none", summary.num_none},
               {"right_ratio", static_cast<double>(summary.num_right) / summary.num_starts},
               {"first_pose_median_ms", summary.first_pose_median_ms},
               {"reprojection_mean_right_px", summary.reprojection_mean_px},
               {"longest_wrong_ms", LongestWrongMs(result)},
               {"failures", Json::array()}};
  for (const EventTrial& trial : result.trials) {
    if (trial.is_right_in_time() && trial.wrong_us == 0) continue;
    json["failures"].push_back({{"start_us", trial.t_start_us},
                                {"first_pose_us", TimeJson(trial.t_first_pose_us)},
                                {"is_first_right", trial.is_first_right},
                                {"wrong_us", trial.wrong_us},
                                {"attempts", trial.attempts}});
  }
  json["returns"] = Json::array();
  for (const ReturnTrial& trial : result.returns) {
    json["returns"].push_back({{"seed", trial.seed},
                               {"was_tracked", trial.was_tracked},
                               {"tracked_us", TimeJson(trial.tracked_us)},
                               {"lingering_us", trial.lingering_us},
                               {"wrong_us", trial.wrong_us}});
  }
  return json;
}

}  // namespace

void FromEventsArguments::AddTo(CLI::App& app, CLI::Option* from_events) {
  app.option_defaults()->group("Experiment with --from-events");
  const auto add = [&](const char* name, auto& value, const char* description) {
    return app.add_option(name, value, description)->needs(from_events)->capture_default_str();
  };
  add("--starts", trial.num_starts, "Number of starts of the tracker in the recording of each object")
      ->check(NumberRange(1, 100'000));
  add("--duration", duration_s, "Length of each recording")->check(NumberRange(0.25, 1800.0))->type_name("SECONDS");
  add("--noise", trial.noise_ratio, "Share of all events that are noise")
      ->check(NumberRange(0.0, 0.9))
      ->type_name("RATIO");
  add("--speed", trial.speed_scale, "Factor on the speed of the motion")
      ->check(NumberRange(0.01, 100.0))
      ->type_name("FACTOR");
  add("--camera", trial.camera, "Sensor and lens")->check(CLI::IsMember(SimulatedCameraNames()));
  add("--detector", trial.detector,
      "Lines from events: space-time planes as in the source paper, or LSD on an event image")
      ->check(CLI::IsMember(LineDetectorNames()));
  add("--returns", num_returns,
      "Number of recordings in which the object leaves for a second and returns at another place")
      ->check(NumberRange(0, 10'000));
}

absl::Status RunFromEvents(const FromEventsArguments& arguments, const std::vector<std::string>& objects, uint64_t seed,
                           bool is_json, CliContext& context) {
  const std::vector<std::string> names = objects.empty() ? SimulatedObjectNames() : objects;
  for (const std::string& name : names) {
    const absl::StatusOr<SimulatedObject> object = ParseSimulatedObject(name);
    EVPOSE_RETURN_IF_ERROR(AsUsageError(object.status(), "--objects: "));
  }
  Json json = {{"camera", arguments.trial.camera},
               {"detector", arguments.trial.detector},
               {"duration_s", arguments.duration_s},
               {"noise_ratio", arguments.trial.noise_ratio},
               {"speed", arguments.trial.speed_scale},
               {"seed", seed},
               {"rows", Json::array()}};
  if (!is_json) context.out << kFromEventsHeader << std::flush;
  for (const std::string& name : names) {
    EVPOSE_ASSIGN_OR_RETURN(const ObjectResult result, RunObject(arguments, name, seed, context));
    if (is_json) {
      json["rows"].push_back(ResultJson(result, arguments.trial.detector));
    } else {
      PrintResult(result, arguments.trial.detector, context.out);
    }
  }
  if (is_json) context.out << json.dump(2) << "\n";
  return absl::OkStatus();
}

}  // namespace evpose::client
