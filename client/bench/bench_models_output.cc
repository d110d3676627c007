// SPDX-License-Identifier: Apache-2.0
#include "client/bench/bench_models_output.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/common/table_cell.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

constexpr char kHeader[] =
    "                            prep.    size  triang-                         ele-  sym-            % of depth  rot. "
    "deg    wrong  weak       \n"
    "model                          ms      mm      les  lines curves regions  ments  metry   kept    RMSE  worst  "
    "median  p95     ms     %   CPU  worst seed\n";

const char* OutcomeName(ModelOutcome outcome) {
  switch (outcome) {
    case ModelOutcome::kKept:
      return "kept";
    case ModelOutcome::kWeak:
      return "weak";
    case ModelOutcome::kLost:
      return "lost";
  }
  return "";
}

Json RunJson(const ModelRun& run) {
  return {{"seed", run.seed},
          {"outcome", OutcomeName(run.outcome)},
          {"events_per_s", run.events_per_s},
          {"position_rmse_of_depth", run.position_rmse_of_depth},
          {"rotation_median_deg", kDegreesPerRadian * run.rotation_median_rad},
          {"rotation_p95_deg", kDegreesPerRadian * run.rotation_p95_rad},
          {"longest_wrong_tracking_s", run.longest_wrong_s},
          {"longest_weak_wrong_tracking_s", run.longest_weak_wrong_s},
          {"weak_ratio", run.weak_ratio},
          {"compute_ratio", run.compute_ratio}};
}

Json RowJson(const ModelBenchRow& row) {
  Json json = {{"model", row.model.name}, {"file", row.model.path}};
  if (!row.error.empty()) {
    json["error"] = row.error;
    return json;
  }
  json["preparation_s"] = row.preparation_s;
  json["diameter_m"] = row.diameter_m;
  json["triangles"] = row.triangles;
  json["lines"] = row.lines;
  json["curves"] = row.curves;
  json["regions"] = row.regions;
  json["symmetry"] = row.symmetry;
  json["mean_elements"] = row.mean_elements;
  json["kept"] = row.num_kept;
  json["weak"] = row.num_weak;
  json["worst_seed"] = row.summary.seed;
  json["summary"] = RunJson(row.summary);
  json["runs"] = Json::array();
  for (const ModelRun& run : row.runs) json["runs"].push_back(RunJson(run));
  return json;
}

// "0.312 (torus-coarse)": the largest value, with its model.
std::string Worst(const std::vector<ModelBenchRow>& rows, double factor, int decimals, double ModelRun::*member) {
  double worst = -1.0;
  std::string name;
  for (const ModelBenchRow& row : rows) {
    if (row.num_kept != static_cast<int>(row.runs.size()) || !(row.summary.*member > worst)) continue;
    worst = row.summary.*member;
    name = row.model.name;
  }
  return name.empty() ? "-" : absl::StrCat(Cell(factor * worst, decimals), " (", name, ")");
}

}  // namespace

const char kModelsTableHelp[] =
    "Each model is tracked from its true pose at the start, on simulated recordings of the smooth surface through the\n"
    "reference of models.json, or through the model, with 5 % noise; the background is plain for odd seeds and\n"
    "textured for even ones. A lost object is not searched for. Errors are those of all poses, modulo the symmetries\n"
    "of the model: means over the seeds.\n"
    "  prep.     processor time from the file to the model\n"
    "  elements  visible lines and elements of edges and contours, mean over the first recording\n"
    "  symmetry  number of rotations, axis or sphere\n"
    "  kept      recordings in which all poses to the end were within 5 % of the depth and 10 deg; +w: further ones "
    "in\n"
    "            which, before the loss, a direction that is no symmetry was known worse than 12 px at the outline\n"
    "  worst     position RMSE of the worst seed\n"
    "  wrong     longest time for which TRACKING was reported while the pose was not within these bounds, except\n"
    "            where a direction was known worse than 12 px; of the worst seed\n"
    "  weak      share of the poses with such a direction; they are left out of the errors\n"
    "  CPU       processor time per sensor time, of the worst seed\n";

void PrintModelsHeader(std::ostream& out) { out << kHeader; }

void PrintModelsRow(const ModelBenchRow& row, std::ostream& out) {
  if (!row.error.empty()) {
    out << absl::StrFormat("%-24s  not prepared: %s\n", row.model.name, row.error);
    out.flush();
    return;
  }
  const ModelRun& mean = row.summary;
  const std::string kept =
      absl::StrCat(row.num_kept, "/", row.runs.size(), row.num_weak > 0 ? absl::StrCat("+", row.num_weak, "w") : "");
  out << absl::StrFormat(
      "%-24s %9.1f %7.1f %8d %6d %6d %7d %6.0f %6s %6s %7s %6s %7s %5s %6.0f %5.1f %5.2f %6d\n", row.model.name,
      1e3 * row.preparation_s, 1e3 * row.diameter_m, row.triangles, row.lines, row.curves, row.regions,
      row.mean_elements, row.symmetry, kept, Cell(100.0 * mean.position_rmse_of_depth, 3),
      Cell(100.0 * row.runs[row.worst_run].position_rmse_of_depth, 3),
      Cell(kDegreesPerRadian * mean.rotation_median_rad, 3), Cell(kDegreesPerRadian * mean.rotation_p95_rad, 2),
      1e3 * mean.longest_wrong_s, 100.0 * mean.weak_ratio, mean.compute_ratio, mean.seed);
  out.flush();
}

void PrintModelsSummary(const std::vector<ModelBenchRow>& rows, std::ostream& out) {
  size_t runs = 0, kept = 0, weak = 0, models = 0;
  for (const ModelBenchRow& row : rows) {
    runs += row.runs.size();
    kept += row.num_kept;
    weak += row.num_weak;
    models += row.error.empty() && row.num_kept + row.num_weak == static_cast<int>(row.runs.size()) ? 1 : 0;
  }
  const auto longest = std::max_element(rows.begin(), rows.end(), [](const auto& a, const auto& b) {
    return a.summary.longest_wrong_s < b.summary.longest_wrong_s;
  });
  const auto slowest = std::max_element(rows.begin(), rows.end(), [](const auto& a, const auto& b) {
    return a.summary.compute_ratio < b.summary.compute_ratio;
  });
  out << absl::StrFormat(
      "\n%d of %d models kept in all recordings (%d of %d recordings, and %d with a weak direction)\n", models,
      rows.size(), kept, runs, weak);
  out << absl::StrFormat("worst of the kept models: position %s %% of depth, rotation median %s, p95 %s deg\n",
                         Worst(rows, 100.0, 3, &ModelRun::position_rmse_of_depth),
                         Worst(rows, kDegreesPerRadian, 3, &ModelRun::rotation_median_rad),
                         Worst(rows, kDegreesPerRadian, 2, &ModelRun::rotation_p95_rad));
  if (rows.empty()) return;
  out << absl::StrFormat("longest time wrong while TRACKING %.0f ms (%s); processor time %.2f (%s)\n",
                         1e3 * longest->summary.longest_wrong_s, longest->model.name, slowest->summary.compute_ratio,
                         slowest->model.name);
}

Json ModelsJson(const std::vector<ModelBenchRow>& rows, const ModelBenchOptions& options) {
  Json json = {{"seeds", options.num_seeds},
               {"duration_s", 1e-6 * static_cast<double>(options.duration_us)},
               {"camera", options.camera},
               {"scene", ModelBenchSceneName(options.scene)},
               {"models", Json::array()}};
  for (const ModelBenchRow& row : rows) json["models"].push_back(RowJson(row));
  return json;
}

}  // namespace evpose::client
