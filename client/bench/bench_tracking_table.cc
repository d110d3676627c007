// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/bench/bench_tracking_output.h"
#include "client/cli/common/table_cell.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

std::string PerCent(double ratio, int decimals) { return Cell(100.0 * ratio, decimals); }

std::vector<std::string> RowCells(const TrackingBenchRow& row) {
  const TrackingScore& s = row.summary.overall;
  const Evaluation& e = s.evaluation;
  const Consistency& nees = row.summary.consistency;
  return {row.estimator,
          absl::StrCat(s.losses),
          PerCent(e.coverage_ratio, 2),
          Cell(s.first_pose_ms, 1),
          Cell(1e3 * e.position_rmse_m, 2),
          Cell(1e3 * e.position_mean_m, 2),
          Cell(1e3 * e.position_median_m, 2),
          Cell(1e3 * e.position_std_m, 2),
          PerCent(e.position_rmse_of_depth, 3),
          PerCent(row.summary.worst.position_rmse_of_depth, 3),
          Cell(kDegreesPerRadian * e.rotation_mean_rad, 3),
          Cell(kDegreesPerRadian * e.rotation_median_rad, 3),
          Cell(kDegreesPerRadian * e.rotation_p95_rad, 3),
          Cell(kDegreesPerRadian * e.rotation_max_rad, 2),
          Cell(e.pose_rate_hz, 0),
          PerCent(s.full_rate_ratio, 1),
          Cell(nees.median, 1),
          absl::StrCat(Cell(nees.p5, 1), "-", Cell(nees.p95, 0)),
          PerCent(nees.inside_95_ratio, 1),
          Cell(1e3 * s.wrong_tracking_s, 0),
          Cell(1e3 * s.longest_wrong_tracking_s, 0),
          Cell(1e3 * s.right_untracked_s, 0),
          Cell(s.compute_ratio, 2)};
}

std::string Bound(const TargetCheck& check) {
  const auto number = [](double value) { return absl::StrFormat("%.4g", value); };
  const std::string unit = check.unit.empty() ? "" : absl::StrCat(" ", check.unit);
  if (!std::isfinite(check.high) || (check.unit == "%" && check.high == 100.0)) {
    return absl::StrCat(number(check.low), unit, " or more");
  }
  if (check.low > 0.0) return absl::StrCat(number(check.low), " to ", number(check.high), unit);
  return absl::StrCat(check.high > 0.0 ? "at most " : "", number(check.high), unit);
}

void PrintTargetChecks(const TrackingBenchRow& row, std::ostream& out) {
  std::vector<std::string> met;
  for (const TargetCheck& check : row.target_checks) {
    if (check.is_met()) {
      met.push_back(check.name);
      continue;
    }
    out << absl::StrFormat("  %s: MISSED %s: %s, target %s\n", row.estimator, check.name, Cell(check.value, 3),
                           Bound(check));
  }
  if (!met.empty()) out << absl::StrFormat("  %s: met %s\n", row.estimator, absl::StrJoin(met, ", "));
}

std::string WorstText(const TrackingBenchBlock& block, int num_paths) {
  std::vector<std::string> texts;
  for (const TrackingBenchRow& row : block.rows) {
    const int run = row.summary.worst_run;
    texts.push_back(absl::StrFormat("%s: seed %d, path %d", row.estimator, 1 + run / num_paths, 1 + run % num_paths));
  }
  return absl::StrJoin(texts, "; ");
}

}  // namespace

const char kTrackingTableHelp[] =
    "Every estimator gets the same events. The mixture estimator (evpose) gets no first pose and recovers\n"
    "after a loss; published estimators get the true first pose and do not recover. Errors are relative to the truth,\n"
    "without alignment, modulo the object's symmetries: means over the runs; worst: of the worst run.\n"
    "  losses      number of times that a pose within 5 % of the depth and 10 deg was followed by a worse one, or by "
    "none\n"
    "              for 20 ms, while the object was in view; or of losses that the tracker reported, if there are more\n"
    "  cover       share of the time, from the first event on, with a pose within these bounds\n"
    "  1st ms      sensor time until the first such pose\n"
    "  RMSE ...    of the position; also in % of the depth\n"
    "  kHz         share of the 10 ms intervals with more than 0.3 Mev/s in which poses come at 1 kHz\n"
    "  NEES        normalised estimation error squared of the published covariance: median, and 5 and 95 % quantiles;\n"
    "              of a consistent covariance 5.3, and 1.6 to 12.6\n"
    "  inside      share of the poses with the true pose inside the 95 % ellipsoid of their covariance, %\n"
    "  wrong       time in ms for which TRACKING was reported while the pose was not good: total, and longest\n"
    "  unsure      time in ms for which a good pose was reported as DEGRADED\n"
    "  CPU         processor time per sensor time\n"
    "The targets of the mixture estimator follow each scenario: bounds of the means, and twice the bounds for the "
    "worst\n"
    "run.\n";

void PrintTrackingBlock(const TrackingBenchBlock& block, int num_paths, std::ostream& out) {
  const CameraModel& camera = block.scenario.simulation.camera;
  const int num_runs = block.rows.empty() ? 0 : block.rows.front().summary.num_runs;
  out << absl::StrFormat("%s: %s; %dx%d, %d x %.3g s, %.2f Mev/s\n", block.scenario.name, block.scenario.description,
                         camera.width_px, camera.height_px, num_runs, 1e-6 * static_cast<double>(block.duration_us),
                         1e-6 * block.mean_event_rate_hz);
  std::vector<std::vector<std::string>> lines = {
      {"", "", "cover", "first", "RMSE", "mean", "median", "std",   "RMSE %", "worst",  "rot", "",
       "", "", "rate",  "kHz",   "NEES", "5 to", "inside", "wrong", "at",     "unsure", ""},
      {"",    "losses", "%",  "ms", "mm",     "mm",   "mm",   "mm", "depth", "%",  "mean", "median",
       "p95", "max",    "Hz", "%",  "median", "95 %", "95 %", "ms", "once",  "ms", "CPU"}};
  for (const TrackingBenchRow& row : block.rows) lines.push_back(RowCells(row));
  PrintTable(lines, "  ", out);
  for (const TrackingBenchRow& row : block.rows) PrintTargetChecks(row, out);
  if (num_runs > 1) out << "  worst runs: " << WorstText(block, num_paths) << "\n";
  out << "\n";
  out.flush();
}

}  // namespace evpose::client
