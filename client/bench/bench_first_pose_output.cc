// SPDX-License-Identifier: Apache-2.0
#include "client/bench/bench_first_pose_output.h"

#include <algorithm>
#include <array>
#include <limits>
#include <string>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/cli/common/table_cell.h"
#include "core/numerics/math.h"
#include "core/numerics/statistics.h"

namespace evpose::client {
namespace {

constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();

struct FirstPoseFigures {
  int found = 0;
  int wrong = 0;            // starts with a wrong pose while TRACKING
  double time_ms = 0.0;     // median sensor time from the motion to the first right pose
  double compute_ms = 0.0;  // median processor time until it
  double longest_wrong_ms = 0.0;
  int num_poses = 0;       // with a state in which a pose is reported
  int num_ambiguous = 0;   // of these
  int best_right = 0;      // number of searches whose best pose is right
  int any_right = 0;       // number of searches that return a right pose
  int with_motion = 0;     // number of searches before which the object moved enough
  double search_ms = 0.0;  // median processor time
  double worst_search_ms = 0.0;
};

FirstPoseFigures FiguresOf(const FirstPoseBenchRow& row) {
  FirstPoseFigures figures;
  std::vector<double> times_ms, computes_ms, searches_ms;
  for (const FirstPoseStart& start : row.starts) {
    figures.found += start.is_found() ? 1 : 0;
    figures.wrong += start.wrong_at_us >= 0 ? 1 : 0;
    figures.longest_wrong_ms = std::max(figures.longest_wrong_ms, 1e-3 * static_cast<double>(start.longest_wrong_us));
    figures.num_poses += start.states.tracking + start.states.degraded + start.states.ambiguous;
    figures.num_ambiguous += start.states.ambiguous;
    if (start.right_us < 0) continue;
    times_ms.push_back(1e-3 * static_cast<double>(start.right_us - std::max<int64_t>(0, start.moved_us)));
    computes_ms.push_back(1e3 * start.compute_s);
  }
  for (const SearchTrial& trial : row.trials) {
    figures.with_motion += trial.has_moved ? 1 : 0;
    figures.best_right += trial.rank == 0 ? 1 : 0;
    figures.any_right += trial.rank >= 0 ? 1 : 0;
    if (trial.has_moved) searches_ms.push_back(1e3 * trial.compute_s);
    figures.worst_search_ms = std::max(figures.worst_search_ms, 1e3 * trial.compute_s);
  }
  figures.time_ms = UpperMedianOr(times_ms, kNoNumber);
  figures.compute_ms = UpperMedianOr(computes_ms, kNoNumber);
  figures.search_ms = UpperMedianOr(searches_ms, kNoNumber);
  return figures;
}

// Share of the poses that were AMBIGUOUS, %.
double AmbiguousPercent(int num_ambiguous, int num_poses) {
  return num_poses > 0 ? 100.0 * num_ambiguous / num_poses : kNoNumber;
}

Json StatesJson(const ReportedStates& states) {
  return {{"tracking", states.tracking},
          {"tracking_right", states.tracking_right},
          {"degraded", states.degraded},
          {"degraded_right", states.degraded_right},
          {"ambiguous", states.ambiguous},
          {"ambiguous_right", states.ambiguous_right},
          {"ambiguous_among", states.ambiguous_among}};
}

Json ExplanationJson(const StartExplanation& explanation) {
  return {{"cause", StartCauseName(explanation.cause)},
          {"turn_sigmas", explanation.turn_sigmas},
          {"given_right_us", explanation.given_right_us},
          {"ranks", explanation.ranks},
          {"proposed_ranks", explanation.proposed_ranks}};
}

}  // namespace

const char kFirstPoseTableHelp[] =
    "With --first-pose, trackers are started without a prior at times that are distributed evenly over each recording\n"
    "(--starts, --watch), and a single search by contours runs on the events up to the end of each start's time.\n"
    "  views     views of the model that are compared with the events; prep.: processor time to prepare them\n"
    "  found     starts with a right pose (2 deg, 2 % of the depth, modulo symmetries) reported as TRACKING within\n"
    "            300 ms, counted from the time at which the image of the object has moved by 2 px\n"
    "  time      median of this time; CPU: median processor time until then\n"
    "  wrong     starts in which a wrong pose was reported as TRACKING, and the longest time\n"
    "  ambig     share of all poses that were reported as AMBIGUOUS, %\n"
    "  search    searches whose best pose, and any of whose poses, is within 6 deg and 3 % of the depth of the true\n"
    "            one, of those with enough motion; median and longest processor time of a search\n";

void PrintFirstPoseHeader(std::ostream& out) {
  out << "                               prep.           time    CPU      wrong    ambig    search          ms        "
         "\n"
         "model                    views    ms    found    ms     ms   starts    ms    % best any  of  median "
         "longest\n";
}

void PrintFirstPoseRow(const FirstPoseBenchRow& row, std::ostream& out) {
  if (!row.error.empty()) {
    out << absl::StrFormat("%-24s  not prepared: %s\n", row.model.name, row.error);
    out.flush();
    return;
  }
  const FirstPoseFigures figures = FiguresOf(row);
  out << absl::StrFormat("%-24s %5d %5.0f %4d/%-3d %6s %6s %8d %5.0f %4s %4d %3d %3d %7s %7.0f\n", row.model.name,
                         row.num_views, 1e3 * row.preparation_s, figures.found, row.starts.size(),
                         Cell(figures.time_ms, 1), Cell(figures.compute_ms, 0), figures.wrong, figures.longest_wrong_ms,
                         Cell(AmbiguousPercent(figures.num_ambiguous, figures.num_poses), 0), figures.best_right,
                         figures.any_right, figures.with_motion, Cell(figures.search_ms, 0), figures.worst_search_ms);
  out.flush();
}

void PrintFirstPoseSummary(const std::vector<FirstPoseBenchRow>& rows, std::ostream& out) {
  int found = 0, starts = 0, wrong = 0, num_poses = 0, num_ambiguous = 0;
  double longest_ms = 0.0;
  std::string name = "-";
  for (const FirstPoseBenchRow& row : rows) {
    const FirstPoseFigures figures = FiguresOf(row);
    found += figures.found;
    starts += static_cast<int>(row.starts.size());
    wrong += figures.wrong;
    num_poses += figures.num_poses;
    num_ambiguous += figures.num_ambiguous;
    if (figures.longest_wrong_ms <= longest_ms) continue;
    longest_ms = figures.longest_wrong_ms;
    name = row.model.name;
  }
  out << absl::StrFormat(
      "\nfound in %d of %d starts; wrong while TRACKING in %d, for at most %.0f ms (%s); %s %% of the poses "
      "AMBIGUOUS\n",
      found, starts, wrong, longest_ms, name, Cell(AmbiguousPercent(num_ambiguous, num_poses), 0));
}

const char kStartCauseHelp[] =
    "With --explain a second table counts the starts by the first of these causes that applies:\n"
    "  not moved       the image of the object never moves by 2 px\n"
    "  turn not shown  the events do not prefer the true poses of a nearly round object to those that are turned "
    "about\n"
    "                  its axis: a keyway or a handle is hidden or has too few events\n"
    "  not supported   a tracker that is given the true pose is not TRACKING within this time, either\n"
    "  not ranked      searches do not return the right pose, even if it is proposed to them\n"
    "  not proposed    they return it only if it is proposed: no view near it was aligned\n"
    "  undecided       they return it, but it competes with other poses until the end\n"
    "  not confirmed   they return it, but it is DEGRADED, rejected or too late\n";

void PrintStartCauses(const std::vector<FirstPoseBenchRow>& rows, std::ostream& out) {
  out << absl::StrFormat("\n%-24s", "starts by cause");
  for (int i = 0; i < kNumStartCauses; ++i) {
    out << absl::StrFormat(" %14s", StartCauseName(static_cast<StartCause>(i)));
  }
  out << "\n";
  for (const FirstPoseBenchRow& row : rows) {
    std::array<int, kNumStartCauses> counts{};
    for (const FirstPoseStart& start : row.starts) ++counts[static_cast<size_t>(start.explanation.cause)];
    out << absl::StrFormat("%-24s", row.model.name);
    for (const int count : counts) out << absl::StrFormat(" %14d", count);
    out << "\n";
  }
}

Json FirstPoseJson(const std::vector<FirstPoseBenchRow>& rows, const FirstPoseBenchOptions& options) {
  Json json = {{"seeds", options.bench.num_seeds},
               {"starts", options.num_starts},
               {"watch_s", 1e-6 * static_cast<double>(options.watch_us)},
               {"camera", options.bench.camera},
               {"scene", ModelBenchSceneName(options.bench.scene)},
               {"shown", options.shown ? Json(options.shown->name) : Json(nullptr)},
               {"models", Json::array()}};
  for (const FirstPoseBenchRow& row : rows) {
    Json model = {{"model", row.model.name},  {"file", row.model.path},
                  {"error", row.error},       {"preparation_s", row.preparation_s},
                  {"views", row.num_views},   {"starts", Json::array()},
                  {"searches", Json::array()}};
    for (const FirstPoseStart& start : row.starts) {
      model["starts"].push_back({{"t_start_us", start.t_start_us},
                                 {"moved_us", start.moved_us},
                                 {"right_us", start.right_us},
                                 {"longest_wrong_us", start.longest_wrong_us},
                                 {"wrong_at_us", start.wrong_at_us},
                                 {"wrong_rotation_deg", kDegreesPerRadian * start.wrong.rotation_rad},
                                 {"wrong_translation_ratio", start.wrong.translation_ratio},
                                 {"searches", start.searches},
                                 {"compute_s", start.compute_s},
                                 {"poses", StatesJson(start.states)}});
      if (options.explains) model["starts"].back()["explanation"] = ExplanationJson(start.explanation);
    }
    for (const SearchTrial& trial : row.trials) {
      Json scores = Json::array();
      for (const AlignmentScore& score : trial.scores) {
        scores.push_back({{"hit_ratio", score.hit_ratio}, {"explained_ratio", score.explained_ratio}});
      }
      model["searches"].push_back({{"t_us", trial.t_us},
                                   {"has_moved", trial.has_moved},
                                   {"poses", trial.num_poses},
                                   {"rank", trial.rank},
                                   {"scores", std::move(scores)},
                                   {"best_rotation_deg", kDegreesPerRadian * trial.best_rotation_rad},
                                   {"compute_s", trial.compute_s}});
    }
    json["models"].push_back(std::move(model));
  }
  return json;
}

}  // namespace evpose::client
