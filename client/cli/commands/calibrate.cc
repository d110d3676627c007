// SPDX-License-Identifier: Apache-2.0

// evpose calibrate: estimates the profile of a sensor from recordings with known poses.
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/calibration_picture.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/progress.h"
#include "client/model_intake/model_intake.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/calibration/sensor_calibration.h"
#include "core/camera_files/camera_file.h"
#include "core/events/event_reader.h"
#include "core/events/recording_reader.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"

namespace evpose::client {
namespace {

// Size of the pieces that are read; progress is displayed after each piece.
constexpr size_t kCalibratePieceBytes = 1 << 20;

struct CalibrateArguments {
  std::vector<std::string> recordings;
  std::vector<std::string> truths;
  std::vector<std::string> models;
  std::vector<std::string> cameras;
  std::string start;
  std::string name;
  std::string out;
  std::string picture;
  ModelReadingArguments reading;
  bool is_json = false;
};

// Returns the i-th file, or the only one, which then is that of all recordings.
const std::string& Of(const std::vector<std::string>& values, size_t i) {
  return values.size() == 1 ? values.front() : values[i];
}

absl::Status CheckCounts(const CalibrateArguments& arguments) {
  const size_t wanted = arguments.recordings.size();
  if (arguments.truths.size() != wanted) {
    return UsageError(absl::StrFormat("--truth is given %d times for %d recordings: one for each, in their order",
                                      arguments.truths.size(), wanted));
  }
  for (const auto& [option, count] :
       {std::pair{"--model", arguments.models.size()}, {"--camera", arguments.cameras.size()}}) {
    if (count == 1 || count == wanted) continue;
    return UsageError(absl::StrFormat("%s is given %d times for %d recordings: once, or one for each in their order",
                                      option, count, wanted));
  }
  return absl::OkStatus();
}

struct CalibrationInput {
  std::unique_ptr<RecordingReader> reader;
  std::unique_ptr<EdgePassageCollector> collector;
};

absl::StatusOr<CalibrationInput> OpenInput(const CalibrateArguments& arguments, size_t i) {
  CalibrationInput input;
  EVPOSE_ASSIGN_OR_RETURN(const CameraModel camera, LoadCameraModel(Of(arguments.cameras, i)));
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, arguments.reading.Load(Of(arguments.models, i)));
  EVPOSE_ASSIGN_OR_RETURN(Trajectory truth, ReadTumTrajectory(arguments.truths[i]));
  if (truth.size() < 2)
    return absl::InvalidArgumentError(absl::StrCat(arguments.truths[i], ": has fewer than two poses"));
  EVPOSE_ASSIGN_OR_RETURN(input.reader, RecordingReader::Open(arguments.recordings[i]));
  EVPOSE_RETURN_IF_ERROR(
      CheckCameraMatches(camera, Of(arguments.cameras, i), input.reader->header(), arguments.recordings[i]));
  EVPOSE_ASSIGN_OR_RETURN(input.collector, EdgePassageCollector::Create(std::make_shared<ObjectModel>(std::move(model)),
                                                                        camera, std::move(truth)));
  return input;
}

absl::StatusOr<std::vector<EdgePassage>> CollectPassages(const CalibrateArguments& arguments, size_t i,
                                                         CalibrationInput& input, ProgressLine& progress) {
  EVPOSE_ASSIGN_OR_RETURN(EventReader events,
                          EventReader::Make(*input.reader, {.max_piece_bytes = kCalibratePieceBytes}));
  std::optional<int64_t> first_us;
  int64_t last_us = 0;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (!has_piece) break;
    const auto& piece = events.decoded().events;
    if (piece.empty()) continue;
    if (!first_us) first_us = piece.front().t_us;
    last_us = piece.back().t_us;
    input.collector->AddEvents(piece);
    progress.Show(static_cast<double>(i) / static_cast<double>(arguments.recordings.size()),
                  absl::StrFormat("%s: %.1f s read", arguments.recordings[i], (last_us - *first_us) * 1e-6));
  }
  std::vector<EdgePassage> passages = input.collector->Finish();
  if (input.collector->num_events_with_truth() == 0) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "%s has no events at the times of %s: its events are of %.6f to %.6f s; are both on the sensor's clock?",
        arguments.recordings[i], arguments.truths[i], first_us.value_or(0) * 1e-6, last_us * 1e-6));
  }
  return passages;
}

Json Constant(double value, double error, bool is_fitted) {
  return {{"value", value}, {"standard_error", is_fitted ? Json(error) : Json(nullptr)}};
}

Json CalibrationJson(const SensorCalibration& fit) {
  return {{"name", fit.profile.name},
          {"pixel_noise_px", Constant(fit.profile.pixel_noise_px, fit.pixel_noise_error_px, true)},
          {"blur_px", Constant(fit.profile.blur_px, fit.blur_error_px, true)},
          {"contrast_threshold", Constant(fit.profile.contrast_threshold, fit.contrast_threshold_error, true)},
          {"refractory_us", Constant(fit.profile.refractory_us, fit.refractory_error_us, fit.are_times_fitted)},
          {"latency_us", Constant(fit.profile.latency_us, fit.latency_error_us, fit.are_times_fitted)},
          {"typical_contrast", fit.typical_contrast},
          {"edge_shift_px", fit.edge_shift_px},
          {"lag_px", fit.lag_px},
          {"passages", fit.num_passages},
          {"edges", fit.num_groups},
          {"events", std::llround(fit.num_events)},
          {"speed_p10_px_per_s", fit.slowest_px_per_s},
          {"speed_p90_px_per_s", fit.fastest_px_per_s},
          {"uncorrected_rms_px", fit.uncorrected_rms_px},
          {"start_rms_px", fit.initial_rms_px},
          {"fitted_rms_px", fit.fitted_rms_px},
          {"warnings", fit.warnings}};
}

void PrintCalibration(const SensorCalibration& fit, std::ostream& out) {
  out << absl::StrFormat("%d passages of %d edges and directions, %.0f events, %.0f to %.0f px/s\n", fit.num_passages,
                         fit.num_groups, fit.num_events, fit.slowest_px_per_s, fit.fastest_px_per_s);
  const auto line = [&out](const char* name, double value, double error, int digits, bool is_fitted) {
    out << absl::StrFormat("%-20s %*.*f", name, 9, digits, value)
        << (is_fitted ? absl::StrFormat(" +- %.*f\n", digits, error) : std::string("  not fitted\n"));
  };
  line("blur_px", fit.profile.blur_px, fit.blur_error_px, 3, true);
  line("contrast_threshold", fit.profile.contrast_threshold, fit.contrast_threshold_error, 3, true);
  line("refractory_us", fit.profile.refractory_us, fit.refractory_error_us, 0, fit.are_times_fitted);
  line("latency_us", fit.profile.latency_us, fit.latency_error_us, 0, fit.are_times_fitted);
  line("pixel_noise_px", fit.profile.pixel_noise_px, fit.pixel_noise_error_px, 3, true);
  out << absl::StrFormat("an edge of log contrast %.2f: shift to its darker side %.3f px, lag %.3f px\n",
                         fit.typical_contrast, fit.edge_shift_px, fit.lag_px);
  out << absl::StrFormat(
      "residuals, rms: %.3f px uncorrected, %.3f px by the profile at the start, %.3f px by this one\n",
      fit.uncorrected_rms_px, fit.initial_rms_px, fit.fitted_rms_px);
}

absl::Status RunCalibrate(const CalibrateArguments& arguments, CliContext& context) {
  EVPOSE_RETURN_IF_ERROR(CheckCounts(arguments));
  SensorCalibrationOptions options;
  if (!arguments.start.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(options.initial, LoadSensorProfile(arguments.start));
  }
  std::vector<CalibrationInput> inputs;
  for (size_t i = 0; i < arguments.recordings.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(CalibrationInput input, OpenInput(arguments, i));
    inputs.push_back(std::move(input));
  }
  EVPOSE_ASSIGN_OR_RETURN(OutputFile profile_file, OutputFile::Create(arguments.out));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> picture, OpenOutput(arguments.picture));
  ProgressLine progress(context);
  std::vector<CalibrationRecording> recordings;
  for (size_t i = 0; i < inputs.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(std::vector<EdgePassage> passages, CollectPassages(arguments, i, inputs[i], progress));
    recordings.push_back({arguments.recordings[i], std::move(passages)});
    inputs[i] = {};
  }
  progress.Clear();
  EVPOSE_ASSIGN_OR_RETURN(SensorCalibration calibration, CalibrateSensor(recordings, options));
  if (!arguments.name.empty()) calibration.profile.name = arguments.name;
  if (picture) {
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<uint8_t> png, DrawCalibration(calibration, recordings));
    EVPOSE_RETURN_IF_ERROR(FinishOutput(picture, {reinterpret_cast<const char*>(png.data()), png.size()}));
  }
  EVPOSE_RETURN_IF_ERROR(profile_file.Append(SensorProfileToYaml(calibration.profile)));
  EVPOSE_RETURN_IF_ERROR(profile_file.Commit());
  for (const std::string& warning : calibration.warnings) context.err << "evpose calibrate: " << warning << "\n";
  return PrintResult(context, arguments.is_json, CalibrationJson(calibration),
                     [&calibration](std::ostream& out) { PrintCalibration(calibration, out); });
}

}  // namespace

CommandRunner AddCalibrateCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<CalibrateArguments>();
  app.add_option("recordings", arguments->recordings, "Prophesee RAW or DAT files of one sensor and lens")->required();
  app.add_option("--truth", arguments->truths, "Known poses, TUM, on the sensor's clock; one for each recording")
      ->required();
  app.add_option("--model", arguments->models, absl::StrCat("Object: ", kModelFormats, "; one for all or one for each"))
      ->required();
  app.add_option("--camera", arguments->cameras, absl::StrCat(kCameraFiles, "; one for all or one for each"))
      ->required();
  arguments->reading.AddTo(app);
  app.add_option(
      "--start", arguments->start,
      "Initial profile; its value is kept for each constant that the recordings do not determine. Default: an EVK4");
  app.add_option("--name", arguments->name, "Name of the sensor in the profile");
  app.add_option("-o,--out", arguments->out,
                 "Profile for evpose replay --sensor, YAML; the file appears only when it is complete")
      ->required();
  AddPicture(app, "--picture", arguments->picture,
             "Draw the residuals by speed and by event density, before and after the fit: .png");
  app.add_flag("--json", arguments->is_json, "One JSON object on standard output");
  app.footer(
      "The object should move back and forth, slowly and fast, and have edges of several contrasts. An offset between\n"
      "the clocks of the truth and of the sensor is indistinguishable from latency. Evaluate the profile on "
      "recordings\n"
      "to which it was not fitted.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --duration 2 --motion bursts -o cube\n"
      "  evpose calibrate cube/recording.raw --truth cube/truth.tum --model cube/model.obj --camera cube/camera.yaml "
      "\\\n"
      "      -o sensor.yaml --picture residuals.png");
  return [arguments, &context] { return RunCalibrate(*arguments, context); };
}

}  // namespace evpose::client
