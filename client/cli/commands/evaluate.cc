// SPDX-License-Identifier: Apache-2.0

// evpose evaluate: compares trajectories with the true one.
#include "core/evaluation/evaluate.h"

#include <cmath>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/commands/commands.h"
#include "client/cli/commands/evaluate_alignment.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/pose_reader.h"
#include "client/cli/common/table_cell.h"
#include "client/cli/console/wait_message.h"
#include "client/model_intake/model_intake.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/command_line/number_range.h"
#include "core/evaluation/consistency.h"
#include "core/evaluation/surface_distance.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/numerics/math.h"
#include "core/numerics/statistics.h"

namespace evpose::client {
namespace {

struct EvaluateArguments {
  std::string truth;
  std::vector<std::string> estimates;  // FILE or NAME=FILE
  std::string model;
  std::string camera;
  AlignmentArguments alignment;
  PoseFrameArguments frame;
  ModelReadingArguments reading;
  double max_gap_ms = 20.0;
  bool is_symmetric = false;
  bool is_json = false;
};

struct Row {
  std::string name;
  Evaluation evaluation;
  std::optional<Consistency> consistency;  // present for an estimate with covariances
  int nees_degrees_of_freedom = 6;
  size_t num_ambiguous = 0;  // AMBIGUOUS poses of a .csv or .jsonl file
  std::optional<HandEye> alignment;
  double distance_ratio = 1.0;               // of the estimate to the truth
  std::optional<double> surface_distance_m;  // with a model that has faces, and at least one pose
};

// A larger ratio of the distances of estimate and truth, or a smaller one than its inverse, is another unit.
constexpr double kOtherUnitRatio = 10.0;

// Splits "NAME=FILE"; the name of a FILE alone is the file.
std::pair<std::string, std::string> SplitLabel(const std::string& text) {
  const size_t equals = text.find('=');
  if (equals == std::string::npos) return {text, text};
  return {text.substr(0, equals), text.substr(equals + 1)};
}

// Compares the covariances with the errors; nullopt without covariances.
absl::StatusOr<std::optional<Consistency>> EvaluateConsistency(const Trajectory& truth, const ReadPoses& estimate,
                                                               const EvaluationOptions& options) {
  if (estimate.covariances.empty()) return std::nullopt;
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<TrajectoryError> errors,
                          TrajectoryErrors(truth, estimate.trajectory, options));
  std::vector<double> values;
  size_t next = 0;
  for (const TrajectoryError& error : errors) {
    while (estimate.trajectory[next].t_us != error.t_us) ++next;
    const Matrix6d& covariance = estimate.covariances[next];
    values.push_back(
        options.continuous_symmetry
            ? NormalisedErrorSquared(error.true_pose, error.estimated_pose, covariance, *options.continuous_symmetry)
            : NormalisedErrorSquared(error.true_pose, error.estimated_pose, covariance));
  }
  return SummariseConsistency(std::move(values), NumObservable(options.continuous_symmetry));
}

// Returns the mean distance over the poses; nullopt without poses.
absl::StatusOr<std::optional<double>> MeanSurfaceDistance(const Trajectory& truth, const Trajectory& estimate,
                                                          const SurfaceDistance& surface,
                                                          const EvaluationOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<TrajectoryError> errors, TrajectoryErrors(truth, estimate, options));
  if (errors.empty()) return std::nullopt;
  double sum_m = 0.0;
  for (const TrajectoryError& error : errors) sum_m += surface.Between(error.true_pose, error.estimated_pose);
  return sum_m / static_cast<double>(errors.size());
}

double MedianDistanceM(const Trajectory& trajectory) {
  std::vector<double> distances;
  for (const StampedPose& pose : trajectory) distances.push_back(pose.camera_from_object.translation_m.norm());
  return UpperMedian(distances);
}

// Returns the ratio of the object's median distances from the camera, estimate to truth; 1 without poses.
double DistanceRatio(const Trajectory& estimate, const Trajectory& truth) {
  if (estimate.empty() || truth.empty()) return 1.0;
  return MedianDistanceM(estimate) / MedianDistanceM(truth);
}

// An error of the comparison with an aligned truth, with what is wrong with the alignment.
absl::Status WithAlignment(const absl::Status& status, const std::optional<HandEye>& alignment) {
  if (!alignment) return status;
  if (!alignment->explains_motion) return absl::FailedPreconditionError(absl::StrJoin(alignment->warnings, "; "));
  return absl::Status(status.code(), absl::StrFormat("%s; the times of the truth are those of its file minus the time "
                                                     "offset of %.6f s",
                                                     std::string(status.message()), alignment->time_offset_s));
}

absl::StatusOr<std::vector<Row>> EvaluateAll(const EvaluateArguments& arguments, const CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const PoseFrame frame, arguments.frame.Read(context.err));
  // The alignment finds out in which frame the truth is.
  const std::optional<PoseFrame> truth_frame = arguments.alignment.is_rigid() ? std::nullopt : std::optional(frame);
  EVPOSE_ASSIGN_OR_RETURN(const Trajectory truth, ReadTruePoses(arguments.truth, truth_frame));
  std::optional<ObjectModel> model;
  std::optional<CameraModel> camera;
  if (!arguments.model.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(model, arguments.reading.LoadSilently(arguments.model));
    EVPOSE_ASSIGN_OR_RETURN(camera, LoadCameraModel(arguments.camera));
  }
  EvaluationOptions options;
  options.max_gap_us = std::llround(arguments.max_gap_ms * 1e3);
  if (arguments.is_symmetric) {
    options.symmetries = model->symmetries;
    options.continuous_symmetry = model->continuous_symmetry;
  }
  std::optional<SurfaceDistance> surface;
  const auto error = [&arguments](const std::string& path, const absl::Status& status) {
    return absl::Status(status.code(), absl::StrCat(path, " against ", arguments.truth, ": ", status.message()));
  };
  if (model && !model->triangles.empty()) surface.emplace(*model);
  std::vector<Row> rows;
  for (const std::string& text : arguments.estimates) {
    const auto [name, path] = SplitLabel(text);
    EVPOSE_ASSIGN_OR_RETURN(const ReadPoses estimate, ReadCameraPoses(path, frame));
    // An estimate without poses cannot be aligned, but has a row in the table.
    absl::StatusOr<std::optional<HandEye>> alignment = std::nullopt;
    if (!estimate.trajectory.empty()) alignment = arguments.alignment.Solve(truth, estimate.trajectory);
    if (IsUsageError(alignment.status())) return alignment.status();
    if (!alignment.ok()) return error(path, alignment.status());
    const Trajectory aligned = *alignment ? (*alignment)->Aligned(truth) : truth;
    absl::StatusOr<Evaluation> evaluation = Evaluate(aligned, estimate.trajectory, options, model ? &*model : nullptr,
                                                     camera ? &*camera : nullptr, estimate.ambiguous_us);
    if (!evaluation.ok()) return error(path, WithAlignment(evaluation.status(), *alignment));
    EVPOSE_ASSIGN_OR_RETURN(const std::optional<Consistency> consistency,
                            EvaluateConsistency(aligned, estimate, options));
    Row& row = rows.emplace_back(Row{name,
                                     *evaluation,
                                     consistency,
                                     NumObservable(options.continuous_symmetry),
                                     estimate.ambiguous_us.size(),
                                     *alignment,
                                     DistanceRatio(estimate.trajectory, aligned),
                                     {}});
    if (!surface) continue;
    EVPOSE_ASSIGN_OR_RETURN(row.surface_distance_m,
                            MeanSurfaceDistance(aligned, estimate.trajectory, *surface, options));
  }
  return rows;
}

Json RowJson(const Row& row) {
  const Evaluation& e = row.evaluation;
  // Without poses the errors are null.
  Json json = {{"name", row.name},
               {"poses", e.num_poses},
               {"coverage_ratio", e.coverage_ratio},
               {"ambiguous_ratio", e.ambiguous_ratio},
               {"position_rmse_m", e.position_rmse_m},
               {"position_mean_m", e.position_mean_m},
               {"position_median_m", e.position_median_m},
               {"position_std_m", e.position_std_m},
               {"position_rmse_of_depth", e.position_rmse_of_depth},
               {"rotation_mean_deg", e.rotation_mean_rad * kDegreesPerRadian},
               {"rotation_median_deg", e.rotation_median_rad * kDegreesPerRadian},
               {"rotation_p95_deg", e.rotation_p95_rad * kDegreesPerRadian},
               {"rotation_max_deg", e.rotation_max_rad * kDegreesPerRadian},
               {"reprojection_mean_px", e.reprojection_mean_px ? Json(*e.reprojection_mean_px) : Json(nullptr)},
               {"surface_distance_mean_m", row.surface_distance_m ? Json(*row.surface_distance_m) : Json(nullptr)},
               {"losses", e.losses},
               {"pose_rate_hz", e.pose_rate_hz}};
  if (!row.consistency) return json;
  json["nees_degrees_of_freedom"] = row.nees_degrees_of_freedom;
  json["nees_median"] = row.consistency->median;
  json["nees_p5"] = row.consistency->p5;
  json["nees_p95"] = row.consistency->p95;
  json["nees_inside_95_ratio"] = row.consistency->inside_95_ratio;
  json["poses_without_covariance"] = row.consistency->num_without;
  return json;
}

std::vector<std::string> RowCells(const Row& row) {
  const Evaluation& e = row.evaluation;
  return {row.name,
          absl::StrCat(e.num_poses),
          Cell(100.0 * e.coverage_ratio, 1),
          Cell(100.0 * e.ambiguous_ratio, 1),
          Cell(1e3 * e.position_rmse_m, 3),
          Cell(1e3 * e.position_mean_m, 3),
          Cell(1e3 * e.position_median_m, 3),
          Cell(1e3 * e.position_std_m, 3),
          Cell(100.0 * e.position_rmse_of_depth, 3),
          Cell(kDegreesPerRadian * e.rotation_mean_rad, 3),
          Cell(kDegreesPerRadian * e.rotation_median_rad, 3),
          Cell(kDegreesPerRadian * e.rotation_p95_rad, 3),
          Cell(kDegreesPerRadian * e.rotation_max_rad, 3),
          e.reprojection_mean_px ? Cell(*e.reprojection_mean_px, 2) : "-",
          row.surface_distance_m ? Cell(1e3 * *row.surface_distance_m, 3) : "-",
          absl::StrCat(e.losses),
          Cell(e.pose_rate_hz, 1),
          row.consistency ? Cell(row.consistency->median, 1) : "-",
          row.consistency ? absl::StrCat(Cell(row.consistency->p5, 1), "-", Cell(row.consistency->p95, 1)) : "-"};
}

void PrintRows(const std::vector<Row>& rows, std::ostream& out) {
  std::vector<std::vector<std::string>> lines = {
      {"", "", "cover", "ambig", "position", "", "", "", "RMSE", "rotation", "", "", "", "reproj", "surface", "",
       "rate", "NEES", "5 to"},
      {"estimate", "poses", "%", "%", "RMSE mm", "mean", "median", "std", "% depth", "mean deg", "median", "p95", "max",
       "px", "mm", "losses", "Hz", "median", "95 %"}};
  for (const Row& row : rows) lines.push_back(RowCells(row));
  PrintTable(lines, "", out);
}

// Returns an error if an estimate has no poses. Prints a warning if the error of an estimate exceeds the distance
// between the object and the camera, or if its distances seem to be in another unit.
absl::Status CheckPlausible(const std::vector<Row>& rows, CliContext& context) {
  std::vector<std::string> empty;
  for (const Row& row : rows) {
    if (row.evaluation.num_poses == 0) {
      empty.push_back(absl::StrCat(row.name, row.num_ambiguous > 0 ? " (with AMBIGUOUS poses only)" : ""));
    }
    if (row.distance_ratio > kOtherUnitRatio || row.distance_ratio < 1.0 / kOtherUnitRatio) {
      context.err << absl::StrFormat(
          "evpose evaluate: %s: its object is %.3g times as far from the camera as that of the truth; are both in "
          "metres?\n",
          row.name, row.distance_ratio);
      continue;
    }
    if (!(row.evaluation.position_rmse_of_depth > 1.0)) continue;
    context.err << absl::StrFormat(
        "evpose evaluate: %s: the RMSE of its positions is %.3g times the distance of the object; are they of this "
        "object and recording, camera_from_object, in metres?\n",
        row.name, row.evaluation.position_rmse_of_depth);
  }
  if (empty.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(absl::StrJoin(empty, ", "), ": has no pose to compare"));
}

absl::Status RunEvaluate(const EvaluateArguments& arguments, CliContext& context) {
  if (arguments.model.empty() != arguments.camera.empty()) {
    return UsageError("--model and --camera go together: both are needed for the reprojection error");
  }
  if (arguments.is_symmetric && arguments.model.empty()) {
    return UsageError("--symmetric needs --model and --camera: the symmetries are the model's");
  }
  std::optional<WaitMessage> message = WaitMessage::ForWork(context, "comparing with " + arguments.truth);
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<Row> rows, EvaluateAll(arguments, context));
  message.reset();
  Json json = {{"truth", arguments.truth}, {"estimates", Json::array()}};
  for (const Row& row : rows) {
    json["estimates"].push_back(RowJson(row));
    json["estimates"].back()["alignment"] = AlignmentJson(arguments.alignment, row.alignment);
  }
  EVPOSE_RETURN_IF_ERROR(PrintResult(context, arguments.is_json, json, [&](std::ostream& out) {
    PrintRows(rows, out);
    for (const Row& row : rows) {
      if (row.alignment) PrintAlignment(arguments.alignment, row.name, *row.alignment, out);
    }
  }));
  return CheckPlausible(rows, context);
}

}  // namespace

CommandRunner AddEvaluateCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<EvaluateArguments>();
  app.option_defaults()->group(kInputGroup);
  AddFile(app, "--truth", arguments->truth, "True poses, TUM")->required();
  app.add_option("--estimate", arguments->estimates,
                 "Estimated poses, TUM, CSV or JSON lines; to be repeated for further rows of the table")
      ->type_name("[NAME=]FILE")
      ->required()
      ->take_all();
  CLI::Option* const model = AddFile(app, "--model", arguments->model,
                                     absl::StrCat("Model of the object, for the reprojection error: ", kModelFormats));
  AddFile(app, "--camera", arguments->camera, absl::StrCat(kCameraFiles, ", for the reprojection error"));
  arguments->reading.AddTo(app, model);
  arguments->frame.AddForReading(app);
  arguments->alignment.AddTo(app);
  app.option_defaults()->group("Comparison");
  AddOption(app, "--max-gap-ms", arguments->max_gap_ms, "Longest time for which a pose counts towards the coverage",
            NumberRange(0.001, 1e6))
      ->type_name("MILLISECONDS");
  app.add_flag("--symmetric", arguments->is_symmetric,
               "Compare with the nearest true pose among those that the symmetries of the model make equivalent");
  AddJson(app, arguments->is_json);
  app.footer(
      "Columns of the table:\n"
      "  cover    share of the truth's duration with a pose within 5 % of the depth and 10 deg of the truth\n"
      "  ambig    share with AMBIGUOUS poses of a .csv or .jsonl file (TUM has none), which count as neither\n"
      "           tracked nor lost and are left out of the errors\n"
      "  reproj   mean distance in the image of the ends of the model's lines from their true places\n"
      "  surface  mean distance of the object's surface from that at the true pose (ADD-S): 0 for all poses that look\n"
      "           the same, whatever the symmetry\n"
      "  losses   how often a period that counts as covered has ended\n"
      "  NEES     normalised estimation error squared of a CSV with covariances; a consistent covariance of 6 degrees\n"
      "           of freedom has a median of 5.3, and quantiles at 5 % and 95 % of 1.6 and 12.6\n\n"
      "Poses are compared in the frame of the camera, without alignment; --world-from-camera converts files of "
      "poses in another frame, whose name they state. --align rigid is for a truth in another "
      "frame, such as that of a motion capture system or of a robot, of the object or of the camera: it removes every "
      "constant error of the camera's pose and of the model's frame, and --time-offset auto every constant latency; "
      "errors that vary in time are not removed. A wrong scale also remains.\n\n"
      "With --symmetric, a model with an axis of symmetry has 5 degrees of freedom (median 4.4), a sphere 3 (2.4); "
      "their positions are those of the symmetry's centre, their rotation errors the angles between the axes.\n\n"
      "Exit status:\n"
      "  0  Success\n"
      "  1  Failure, or an estimate without poses, whose row is printed as \"-\"\n"
      "  2  Wrong usage\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out cube/poses.tum\n"
      "  evpose evaluate --truth cube/truth.tum --estimate evpose=cube/poses.tum --model cube/model.obj "
      "--camera cube/camera.yaml --symmetric");
  return [arguments, &context] { return RunEvaluate(*arguments, context); };
}

}  // namespace evpose::client
