// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <numbers>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bench/bench_tracking_output.h"
#include "core/evaluation/consistency.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

// The numbers of a run or of all runs, in the order of the columns of the CSV file.
std::vector<std::pair<const char*, double>> Numbers(const TrackingScore& score, const Consistency& consistency) {
  const Evaluation& e = score.evaluation;
  return {{"poses", static_cast<double>(e.num_poses)},
          {"losses", static_cast<double>(score.losses)},
          {"coverage_ratio", e.coverage_ratio},
          {"first_pose_ms", score.first_pose_ms},
          {"position_rmse_m", e.position_rmse_m},
          {"position_mean_m", e.position_mean_m},
          {"position_median_m", e.position_median_m},
          {"position_std_m", e.position_std_m},
          {"position_rmse_of_depth", e.position_rmse_of_depth},
          {"rotation_mean_deg", kDegreesPerRadian * e.rotation_mean_rad},
          {"rotation_median_deg", kDegreesPerRadian * e.rotation_median_rad},
          {"rotation_p95_deg", kDegreesPerRadian * e.rotation_p95_rad},
          {"rotation_max_deg", kDegreesPerRadian * e.rotation_max_rad},
          {"pose_rate_hz", e.pose_rate_hz},
          {"full_rate_ratio", score.full_rate_ratio},
          {"nees_median", consistency.median},
          {"nees_p5", consistency.p5},
          {"nees_p95", consistency.p95},
          {"nees_inside_95_ratio", consistency.inside_95_ratio},
          {"wrong_tracking_s", score.wrong_tracking_s},
          {"longest_wrong_tracking_s", score.longest_wrong_tracking_s},
          {"right_untracked_s", score.right_untracked_s},
          {"compute_ratio", score.compute_ratio}};
}

Json SeedAndPath(int run, int num_paths) { return {{"seed", 1 + run / num_paths}, {"path", 1 + run % num_paths}}; }

Json RunsJson(const TrackingBenchRow& row, int num_paths) {
  Json runs = Json::array();
  for (size_t i = 0; i < row.scores.size(); ++i) {
    Json run = SeedAndPath(static_cast<int>(i), num_paths);
    for (const auto& [name, value] : Numbers(row.scores[i], SummariseConsistency(row.scores[i].nees)))
      run[name] = value;
    runs.push_back(std::move(run));
  }
  return runs;
}

// Infinite numbers and NaN are null in the text of a JSON object.
Json SummaryJson(const TrackingSummary& s) {
  Json json;
  json["runs"] = s.num_runs;
  for (const auto& [name, value] : Numbers(s.overall, s.consistency)) json[name] = value;
  json.erase("poses");
  json["losses"] = s.overall.losses;
  json["worst"] = {{"position_rmse_of_depth", s.worst.position_rmse_of_depth},
                   {"rotation_median_deg", kDegreesPerRadian * s.worst.rotation_median_rad},
                   {"rotation_p95_deg", kDegreesPerRadian * s.worst.rotation_p95_rad},
                   {"coverage_ratio", s.worst.coverage_ratio}};
  return json;
}

Json TargetsJson(const TrackingTargets& targets) {
  return {{"position_rmse_of_depth", targets.position_rmse_of_depth},
          {"rotation_median_deg", targets.rotation_median_deg},
          {"rotation_p95_deg", targets.rotation_p95_deg},
          {"nees_median", kNeesMedian},
          {"nees_median_low", targets.nees_median_low},
          {"nees_median_high", targets.nees_median_high},
          {"nees_inside_95_ratio_low", targets.inside_95_ratio_low},
          {"nees_inside_95_ratio_high", targets.inside_95_ratio_high},
          {"coverage_ratio", targets.coverage_ratio},
          {"losses", targets.losses}};
}

Json TargetChecksJson(const std::vector<TargetCheck>& checks) {
  Json json = Json::array();
  for (const TargetCheck& check : checks) {
    json.push_back({{"name", check.name},
                    {"value", check.value},
                    {"low", check.low},
                    {"high", check.high},
                    {"unit", check.unit},
                    {"is_met", check.is_met()}});
  }
  return json;
}

}  // namespace

std::string TrackingCsv(const std::vector<TrackingBenchBlock>& blocks, int num_paths) {
  std::string text = "scenario,estimator,seed,path";
  for (const auto& [name, value] : Numbers({}, {})) absl::StrAppend(&text, ",", name);
  text += "\n";
  for (const TrackingBenchBlock& block : blocks) {
    for (const TrackingBenchRow& row : block.rows) {
      for (size_t i = 0; i < row.scores.size(); ++i) {
        absl::StrAppendFormat(&text, "%s,%s,%d,%d", row.scenario, row.estimator, 1 + static_cast<int>(i) / num_paths,
                              1 + static_cast<int>(i) % num_paths);
        for (const auto& [name, value] : Numbers(row.scores[i], SummariseConsistency(row.scores[i].nees))) {
          absl::StrAppend(&text, ",", std::isfinite(value) ? absl::StrFormat("%.9g", value) : "");
        }
        text += "\n";
      }
    }
  }
  return text;
}

Json TrackingJson(const std::vector<TrackingBenchBlock>& blocks, const TrackingBenchOptions& options) {
  Json json = {{"seeds", options.num_seeds}, {"paths", options.num_paths}, {"scenarios", Json::array()}};
  for (const TrackingBenchBlock& block : blocks) {
    Json scenario = {{"scenario", block.scenario.name},
                     {"description", block.scenario.description},
                     {"duration_s", 1e-6 * static_cast<double>(block.duration_us)},
                     {"mean_event_rate_hz", block.mean_event_rate_hz},
                     {"targets", TargetsJson(block.scenario.targets)},
                     {"estimators", Json::array()}};
    for (const TrackingBenchRow& row : block.rows) {
      scenario["estimators"].push_back({{"name", row.estimator},
                                        {"summary", SummaryJson(row.summary)},
                                        {"worst_run", SeedAndPath(row.summary.worst_run, options.num_paths)},
                                        {"targets", TargetChecksJson(row.target_checks)},
                                        {"runs", RunsJson(row, options.num_paths)}});
    }
    json["scenarios"].push_back(std::move(scenario));
  }
  return json;
}

}  // namespace evpose::client
