// SPDX-License-Identifier: Apache-2.0
#include "client/bench/bench_tracking_charts.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <numbers>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr size_t kPoints = 1200;           // of a curve: more than the picture has pixels
constexpr int64_t kLongestGapUs = 20'000;  // a curve is broken where there is no pose for longer

// A coordinate of a pose in the branch of the first true pose: of symmetric objects the estimate may be in another.
using Coordinate = std::function<double(const RigidTransform& pose)>;

struct Curve {
  std::vector<double> x;
  std::vector<double> y;
};

double Seconds(int64_t t_us, int64_t begin_us) { return 1e-6 * static_cast<double>(t_us - begin_us); }

// The largest value of each of kPoints stretches of time; broken at gaps.
Curve Largest(const std::vector<TrajectoryError>& errors, int64_t begin_us, int64_t end_us,
              const std::function<double(size_t index)>& value) {
  Curve curve;
  const int64_t stretch_us = std::max<int64_t>(1, (end_us - begin_us) / static_cast<int64_t>(kPoints));
  int64_t stretch = -1;
  for (size_t i = 0; i < errors.size(); ++i) {
    if (i > 0 && errors[i].t_us - errors[i - 1].t_us > kLongestGapUs) {
      curve.x.push_back(Seconds(errors[i].t_us, begin_us));
      curve.y.push_back(kNan);
      stretch = -1;
    }
    const int64_t now = (errors[i].t_us - begin_us) / stretch_us;
    if (now != stretch) {
      curve.x.push_back(Seconds(errors[i].t_us, begin_us));
      curve.y.push_back(value(i));
      stretch = now;
    } else {
      curve.y.back() = std::max(curve.y.back(), value(i));
    }
  }
  return curve;
}

Curve TruthCurve(const Trajectory& truth, const Coordinate& coordinate) {
  Curve curve;
  const size_t step = 1 + truth.size() / kPoints;
  for (size_t i = 0; i < truth.size(); i += step) {
    curve.x.push_back(Seconds(truth[i].t_us, truth.front().t_us));
    curve.y.push_back(coordinate(truth[i].camera_from_object));
  }
  return curve;
}

Curve EstimateCurve(const Trajectory& truth, const std::vector<TrajectoryError>& errors, const Coordinate& coordinate) {
  Curve curve;
  const size_t step = 1 + errors.size() / kPoints;
  int64_t last_us = 0;
  for (size_t i = 0; i < errors.size(); i += step) {
    const TrajectoryError& error = errors[i];
    const absl::StatusOr<RigidTransform> true_pose = Interpolate(truth, error.t_us);
    if (!true_pose.ok()) continue;
    curve.x.push_back(Seconds(error.t_us, truth.front().t_us));
    const bool is_after_gap = i > 0 && error.t_us - last_us > kLongestGapUs + 1000 * static_cast<int64_t>(step);
    const RigidTransform pose = error.estimated_pose * error.true_pose.Inverse() * *true_pose;
    curve.y.push_back(is_after_gap ? kNan : coordinate(pose));
    last_us = error.t_us;
  }
  return curve;
}

ChartSeries MakeSeries(const std::string& name, Curve curve, int color) {
  ChartSeries series;
  series.name = name;
  series.x = std::move(curve.x);
  series.y = std::move(curve.y);
  series.color = color;
  return series;
}

constexpr int kTruthColor = 7;

ChartPanel CoordinatePanel(const TrackingBenchBlock& block, const std::string& title, const std::string& label,
                           const Coordinate& coordinate) {
  ChartPanel panel;
  panel.title = title;
  panel.x_axis.label = "time, s";
  panel.y_axis.label = label;
  for (size_t i = 0; i < block.rows.size(); ++i) {
    const std::vector<TrajectoryError>& errors = block.rows[i].scores.front().errors;
    panel.series.push_back(
        MakeSeries(block.rows[i].estimator, EstimateCurve(block.truth, errors, coordinate), static_cast<int>(i)));
  }
  // Over the others, which show through its gaps.
  ChartSeries truth = MakeSeries("truth", TruthCurve(block.truth, coordinate), kTruthColor);
  truth.is_dashed = true;
  panel.series.push_back(std::move(truth));
  return panel;
}

ChartPanel ErrorPanel(const TrackingBenchBlock& block, const std::string& title, const std::string& label,
                      const std::function<double(const TrackingScore& score, size_t index)>& value, double target) {
  ChartPanel panel;
  panel.title = title;
  panel.x_axis.label = "time, s";
  panel.y_axis.label = label;
  panel.y_axis.is_logarithmic = true;
  panel.y_axis.min = 1e-3 * target;
  const int64_t begin_us = block.truth.front().t_us;
  const int64_t end_us = block.truth.back().t_us;
  for (size_t i = 0; i < block.rows.size(); ++i) {
    const TrackingScore& score = block.rows[i].scores.front();
    Curve curve = Largest(score.errors, begin_us, end_us, [&](size_t index) { return value(score, index); });
    panel.series.push_back(MakeSeries(block.rows[i].estimator, std::move(curve), static_cast<int>(i)));
  }
  ChartSeries bound = MakeSeries("target", {{0.0, Seconds(end_us, begin_us)}, {target, target}}, kTruthColor);
  bound.is_dashed = true;
  panel.series.push_back(std::move(bound));
  return panel;
}

ChartPage ScenarioPage(const TrackingBenchBlock& block) {
  ChartPage page;
  page.title = absl::StrCat(block.scenario.name, ": ", block.scenario.description, "; seed 1, path 1");
  page.num_columns = 3;
  page.panel_height_px = 280;
  constexpr const char* kAxes = "xyz";
  for (int axis = 0; axis < 3; ++axis) {
    page.panels.push_back(CoordinatePanel(block, absl::StrFormat("Position, %c", kAxes[axis]), "m",
                                          [axis](const RigidTransform& pose) { return pose.translation_m[axis]; }));
  }
  const Eigen::Matrix3d first = block.truth.front().camera_from_object.rotation;
  for (int axis = 0; axis < 3; ++axis) {
    page.panels.push_back(CoordinatePanel(block, absl::StrFormat("Rotation since the beginning, about %c", kAxes[axis]),
                                          "deg", [axis, first](const RigidTransform& pose) {
                                            return kDegreesPerRadian * LogSo3(pose.rotation * first.transpose())[axis];
                                          }));
  }
  const TrackingTargets& targets = block.scenario.targets;
  page.panels.push_back(ErrorPanel(
      block, "Position error", "% of depth",
      [](const TrackingScore& score, size_t i) { return 100.0 * score.errors[i].position_of_depth; },
      100.0 * targets.position_rmse_of_depth));
  page.panels.push_back(ErrorPanel(
      block, "Rotation error", "deg",
      [](const TrackingScore& score, size_t i) { return kDegreesPerRadian * score.errors[i].rotation_rad; },
      targets.rotation_p95_deg));
  page.panels.push_back(ErrorPanel(
      block, "NEES of the published covariance", "", [](const TrackingScore& score, size_t i) { return score.nees[i]; },
      kNeesMedian));
  return page;
}

struct SummaryFigure {
  const char* title;
  const char* label;
  double (*value)(const TrackingSummary& summary);
  double (*target)(const TrackingTargets& targets);
  bool is_logarithmic;
};
constexpr SummaryFigure kSummaryFigures[] = {
    {"Position, RMSE", "% of depth", [](const TrackingSummary& s) { return 100.0 * s.position_rmse_of_depth; },
     [](const TrackingTargets& t) { return 100.0 * t.position_rmse_of_depth; }, true},
    {"Rotation, median", "deg", [](const TrackingSummary& s) { return s.rotation_median_deg; },
     [](const TrackingTargets& t) { return t.rotation_median_deg; }, true},
    {"Rotation, 95th percentile", "deg", [](const TrackingSummary& s) { return s.rotation_p95_deg; },
     [](const TrackingTargets& t) { return t.rotation_p95_deg; }, true},
    {"NEES, median", "", [](const TrackingSummary& s) { return s.consistency.median; },
     [](const TrackingTargets&) { return kNeesMedian; }, true},
    {"Time without a good pose", "%", [](const TrackingSummary& s) { return 100.0 * (1.0 - s.coverage_ratio); },
     [](const TrackingTargets& t) { return 100.0 * (1.0 - t.coverage_ratio); }, true},
    {"Losses", "", [](const TrackingSummary& s) { return static_cast<double>(s.losses); },
     [](const TrackingTargets& t) { return static_cast<double>(t.losses); }, false},
};

// The scenarios stand one below the other, the first at the top: their names are too long to stand side by side.
ChartPanel SummaryPanel(const std::vector<TrackingBenchBlock>& blocks, const SummaryFigure& figure) {
  ChartPanel panel;
  panel.title = figure.title;
  panel.x_axis.label = figure.label;
  panel.x_axis.is_logarithmic = figure.is_logarithmic;
  const auto place = [&](size_t block) { return static_cast<double>(blocks.size() - 1 - block); };
  ChartSeries target;
  target.name = "target";
  target.color = kTruthColor;
  target.is_dashed = true;
  for (size_t b = 0; b < blocks.size(); ++b) {
    for (const double side : {0.4, -0.4}) {
      target.x.push_back(figure.target(blocks[b].scenario.targets));
      target.y.push_back(place(b) + side);
    }
    target.x.push_back(kNan);
    target.y.push_back(place(b));
  }
  for (auto block = blocks.rbegin(); block != blocks.rend(); ++block) {
    panel.y_axis.names.push_back(block->scenario.name);
  }
  const size_t num_rows = blocks.front().rows.size();
  for (size_t r = 0; r < num_rows; ++r) {
    ChartSeries series;
    series.name = blocks.front().rows[r].estimator;
    series.style = ChartStyle::kPoints;
    series.color = static_cast<int>(r);
    for (size_t b = 0; b < blocks.size(); ++b) {
      series.x.push_back(figure.value(blocks[b].rows[r].summary));
      series.y.push_back(place(b));
    }
    panel.series.push_back(std::move(series));
  }
  panel.series.push_back(std::move(target));
  return panel;
}

}  // namespace

absl::StatusOr<TrackingCharts> TrackingCharts::Create(const std::string& directory) {
  std::error_code error;
  std::filesystem::create_directories(directory, error);
  if (error) {
    return absl::UnavailableError(absl::StrCat(directory, ": cannot make this directory: ", error.message()));
  }
  TrackingCharts charts(directory);
  // Says now what is missing, not after the work.
  EVPOSE_RETURN_IF_ERROR(ChartFile::Create((std::filesystem::path(directory) / "summary.png").string()).status());
  return charts;
}

absl::Status TrackingCharts::WritePage(const std::string& name, const ChartPage& page) const {
  EVPOSE_ASSIGN_OR_RETURN(ChartFile file,
                          ChartFile::Create((std::filesystem::path(directory_) / (name + ".png")).string()));
  return file.Write(page);
}

absl::Status TrackingCharts::Write(const TrackingBenchBlock& block) const {
  return WritePage(block.scenario.name, ScenarioPage(block));
}

absl::Status TrackingCharts::WriteSummary(const std::vector<TrackingBenchBlock>& blocks) const {
  if (blocks.empty()) return absl::OkStatus();
  ChartPage page;
  const TrackingSummary& summary = blocks.front().rows.front().summary;
  page.title = absl::StrFormat("Tracking: means of %d run%s", summary.num_runs, summary.num_runs == 1 ? "" : "s");
  page.num_columns = 3;
  page.panel_width_px = 560;
  page.panel_height_px = 110 + 20 * static_cast<int>(blocks.size());
  for (const SummaryFigure& figure : kSummaryFigures) page.panels.push_back(SummaryPanel(blocks, figure));
  return WritePage("summary", page);
}

}  // namespace evpose::client
