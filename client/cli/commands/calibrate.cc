// SPDX-License-Identifier: Apache-2.0

// evpose calibrate: estimates a camera from recordings of a known object, and the profile of a sensor from recordings
// with known or tracked poses.
#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/calibrate_hand_eye.h"
#include "client/cli/commands/calibration_picture.h"
#include "client/cli/commands/camera_report.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/pose_reader.h"
#include "client/cli/common/recording_input.h"
#include "client/cli/console/progress.h"
#include "client/containers/open_recording.h"
#include "client/model_intake/model_intake.h"
#include "core/base/counted.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/calibration/camera_calibration.h"
#include "core/calibration/sensor_calibration.h"
#include "core/calibration/tracked_recording.h"
#include "core/camera_files/camera_file.h"
#include "core/command_line/number_range.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/recordings/event_reader.h"
#include "core/recordings/recording_reader.h"

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
  std::string camera_out;
  std::string coverage;
  double fov_deg = 0.0;
  double focal_mm = 0.0;
  double pixel_um = 4.86;
  evpose::LensModel lens = evpose::LensModel::kBrown;
  ModelReadingArguments reading;
  HandEyeArguments hand_eye;
  bool is_json = false;

  bool IsCameraWanted() const { return cameras.empty(); }
};

// Returns the file for the i-th recording: the i-th value, or the only one, which then applies to all recordings.
const std::string& Of(const std::vector<std::string>& values, size_t i) {
  return values.size() == 1 ? values.front() : values[i];
}

// --model and --camera take all files that follow them. If no recording stands before them, the first of these files is
// the value of the option, and the others are the recordings, as in `--camera FILE --model FILE RECORDINGS`.
void TakeRecordings(CalibrateArguments& arguments) {
  if (!arguments.recordings.empty()) return;
  for (std::vector<std::string>* values : {&arguments.models, &arguments.cameras}) {
    if (values->size() < 2) continue;
    arguments.recordings.assign(values->begin() + 1, values->end());
    values->resize(1);
    return;
  }
}

absl::Status CheckCounts(const CalibrateArguments& arguments) {
  const size_t wanted = arguments.recordings.size();
  if (!arguments.truths.empty() && arguments.truths.size() != wanted) {
    return UsageError(absl::StrFormat("--truth has %s for %s: give one for each, in their order",
                                      Counted(arguments.truths.size(), "file"), Counted(wanted, "recording")));
  }
  for (const auto& [option, count] :
       {std::pair{"--model", arguments.models.size()}, {"--camera", arguments.cameras.size()}}) {
    const bool is_missing_camera = count == 0 && arguments.IsCameraWanted();
    if (count == 1 || count == wanted || is_missing_camera) continue;
    return UsageError(absl::StrFormat("%s has %s for %s: give one for all, or one for each in their order", option,
                                      Counted(count, "file"), Counted(wanted, "recording")));
  }
  return absl::OkStatus();
}

// Checks which options may be given together. With --camera only the profile is estimated.
absl::Status CheckMode(const CalibrateArguments& arguments) {
  if (arguments.models.empty()) return UsageError("--model is required, except with --hand-eye");
  EVPOSE_RETURN_IF_ERROR(CheckCounts(arguments));
  if (arguments.truths.empty() &&
      std::find(arguments.recordings.begin(), arguments.recordings.end(), "-") != arguments.recordings.end()) {
    return UsageError("without --truth a recording is read several times: give a file instead of standard input");
  }
  if (!arguments.IsCameraWanted()) {
    for (const auto& [option, is_given] : {std::pair{"--camera-out", !arguments.camera_out.empty()},
                                           {"--coverage", !arguments.coverage.empty()},
                                           {"--fov", arguments.fov_deg > 0.0},
                                           {"--focal-mm", arguments.focal_mm > 0.0}}) {
      if (is_given) return UsageError(absl::StrCat(option, " is for a calibration of the camera: without --camera"));
    }
    if (arguments.out.empty()) return UsageError("-o is required: the file for the profile of the sensor");
    return absl::OkStatus();
  }
  if (arguments.camera_out.empty()) {
    return UsageError("without --camera the camera is estimated: give --camera-out, the file for it, or --camera");
  }
  if (arguments.models.size() != 1) {
    return UsageError("a calibration of the camera needs one --model, that of all recordings");
  }
  if (arguments.out.empty() && !arguments.picture.empty()) {
    return UsageError("--picture shows the profile, which needs -o");
  }
  return absl::OkStatus();
}

struct CalibrationInput {
  std::unique_ptr<RecordingReader> reader;
  std::unique_ptr<EdgePassageCollector> collector;
  std::string truth_name;
};

// Returns the true poses of a file, or else the poses of the tracker, which reads `recording`.
absl::StatusOr<Trajectory> PosesOf(const CalibrateArguments& arguments, size_t i, RecordingReader& recording,
                                   const CameraModel& camera, const std::shared_ptr<const ObjectModel>& model,
                                   const SensorProfile& sensor, ProgressLine& progress) {
  if (!arguments.truths.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(Trajectory truth, ReadTruePoses(arguments.truths[i]));
    if (truth.size() >= 2) return truth;
    return absl::InvalidArgumentError(absl::StrCat(arguments.truths[i], ": has fewer than two poses"));
  }
  EVPOSE_ASSIGN_OR_RETURN(Trajectory tracked,
                          TrackRecording(recording, model, camera, {.sensor = sensor}, [&](double seconds) {
                            progress.Show(static_cast<double>(i) / static_cast<double>(arguments.recordings.size()),
                                          absl::StrFormat("%s: %.1f s tracked", arguments.recordings[i], seconds));
                          }));
  if (tracked.size() >= 2) return tracked;
  return absl::FailedPreconditionError(absl::StrCat(
      arguments.recordings[i], ": the object was not tracked; try evpose replay with this camera and model"));
}

absl::StatusOr<CalibrationInput> OpenInput(const CliContext& context, const CalibrateArguments& arguments, size_t i,
                                           const std::optional<CameraModel>& estimated, const SensorProfile& sensor,
                                           ProgressLine& progress) {
  CalibrationInput input;
  CameraModel camera;
  if (estimated) {
    camera = *estimated;
  } else {
    EVPOSE_ASSIGN_OR_RETURN(camera, LoadCameraModel(Of(arguments.cameras, i)));
  }
  progress.Clear();
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel loaded, arguments.reading.Load(context, Of(arguments.models, i)));
  const auto model = std::make_shared<const ObjectModel>(std::move(loaded));
  const auto open = [&] {
    return OpenSeenBy(camera, estimated ? arguments.camera_out : Of(arguments.cameras, i), arguments.recordings[i]);
  };
  EVPOSE_ASSIGN_OR_RETURN(input.reader, open());
  EVPOSE_ASSIGN_OR_RETURN(Trajectory poses, PosesOf(arguments, i, *input.reader, camera, model, sensor, progress));
  if (arguments.truths.empty()) {
    input.truth_name = "the tracked poses";
    // The recording is opened again, because the tracker has read it to its end.
    EVPOSE_ASSIGN_OR_RETURN(input.reader, open());
  } else {
    input.truth_name = arguments.truths[i];
  }
  EVPOSE_ASSIGN_OR_RETURN(input.collector, EdgePassageCollector::Create(model, camera, std::move(poses)));
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
        arguments.recordings[i], input.truth_name, first_us.value_or(0) * 1e-6, last_us * 1e-6));
  }
  return passages;
}

bool IsLatencyFitted(const SensorCalibration& fit) { return fit.fitted_times != FittedTimes::kNone; }
bool IsRefractoryFitted(const SensorCalibration& fit) { return fit.fitted_times == FittedTimes::kBoth; }

Json Constant(double value, double error, bool is_fitted) {
  return {{"value", value}, {"standard_error", is_fitted ? Json(error) : Json(nullptr)}};
}

Json CalibrationJson(const SensorCalibration& fit) {
  return {{"name", fit.profile.name},
          {"pixel_noise_px", Constant(fit.profile.pixel_noise_px, fit.pixel_noise_error_px, true)},
          {"blur_px", Constant(fit.profile.blur_px, fit.blur_error_px, true)},
          {"contrast_threshold", Constant(fit.profile.contrast_threshold, fit.contrast_threshold_error, true)},
          {"refractory_us", Constant(fit.profile.refractory_us, fit.refractory_error_us, IsRefractoryFitted(fit))},
          {"latency_us", Constant(fit.profile.latency_us, fit.latency_error_us, IsLatencyFitted(fit))},
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
  line("refractory_us", fit.profile.refractory_us, fit.refractory_error_us, 0, IsRefractoryFitted(fit));
  line("latency_us", fit.profile.latency_us, fit.latency_error_us, 0, IsLatencyFitted(fit));
  line("pixel_noise_px", fit.profile.pixel_noise_px, fit.pixel_noise_error_px, 3, true);
  out << absl::StrFormat("an edge of log contrast %.2f: shift to its darker side %.3f px, lag %.3f px\n",
                         fit.typical_contrast, fit.edge_shift_px, fit.lag_px);
  out << absl::StrFormat(
      "residuals, rms: %.3f px uncorrected, %.3f px by the profile at the start, %.3f px by this one\n",
      fit.uncorrected_rms_px, fit.initial_rms_px, fit.fitted_rms_px);
}

struct ProfileResult {
  SensorCalibration calibration;
  std::vector<CalibrationRecording> recordings;
};

// Fits the profile with the cameras of the files, or with the estimated one.
absl::StatusOr<ProfileResult> FitProfile(const CliContext& context, const CalibrateArguments& arguments,
                                         const std::optional<CameraModel>& estimated, const SensorProfile& start,
                                         ProgressLine& progress) {
  SensorCalibrationOptions options;
  options.initial = start;
  options.has_independent_poses = !arguments.truths.empty();
  ProfileResult result;
  for (size_t i = 0; i < arguments.recordings.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(CalibrationInput input, OpenInput(context, arguments, i, estimated, start, progress));
    EVPOSE_ASSIGN_OR_RETURN(std::vector<EdgePassage> passages, CollectPassages(arguments, i, input, progress));
    result.recordings.push_back({arguments.recordings[i], std::move(passages)});
  }
  EVPOSE_ASSIGN_OR_RETURN(result.calibration, CalibrateSensor(result.recordings, options));
  if (!arguments.name.empty()) result.calibration.profile.name = arguments.name;
  return result;
}

// Returns the size of the sensor, which the headers of all recordings must state alike.
absl::StatusOr<SensorGeometry> CommonGeometry(const std::vector<std::string>& recordings) {
  std::optional<SensorGeometry> common;
  for (const std::string& recording : recordings) {
    EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> reader, OpenRecording(recording));
    const SensorGeometry geometry = reader->header().geometry;
    if (!reader->header().geometry_is_known) {
      return absl::FailedPreconditionError(
          absl::StrCat(recording,
                       ": its header does not state the size of the sensor, which a calibration needs; "
                       "convert it with `evpose convert --size WIDTHxHEIGHT`"));
    }
    if (common && geometry != *common) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "%s is of a sensor of %d x %d pixels, %s of one of %d x %d: calibrate one camera at a time", recordings[0],
          common->width_px, common->height_px, recording, geometry.width_px, geometry.height_px));
    }
    common = geometry;
  }
  return *common;
}

absl::StatusOr<CameraCalibration> EstimateCamera(const CliContext& context, const CalibrateArguments& arguments,
                                                 const SensorProfile& start, ProgressLine& progress) {
  EVPOSE_ASSIGN_OR_RETURN(const SensorGeometry geometry, CommonGeometry(arguments.recordings));
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, arguments.reading.Load(context, arguments.models.front()));
  CameraCalibrationOptions options;
  options.sensor = start;
  options.lens_model = arguments.lens;
  if (arguments.fov_deg > 0.0) {
    const double half_rad = 0.5 * arguments.fov_deg * std::numbers::pi / 180.0;
    const bool is_fisheye = arguments.lens == evpose::LensModel::kFisheye;
    options.focal_px = 0.5 * geometry.width_px / (is_fisheye ? half_rad : std::tan(half_rad));
  } else if (arguments.focal_mm > 0.0) {
    options.focal_px = 1e3 * arguments.focal_mm / arguments.pixel_um;
  }
  const auto open = [&geometry](const std::string& path) { return OpenRecording(path, {.geometry = geometry}); };
  return CalibrateCamera(arguments.recordings, open, std::make_shared<const ObjectModel>(std::move(model)), geometry,
                         options, [&progress](double ratio, const std::string& step) { progress.Show(ratio, step); });
}

absl::Status WriteProfile(const ProfileResult& profile, std::optional<OutputFile>& file,
                          std::optional<OutputFile>& picture) {
  if (picture) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string png, DrawCalibration(profile.calibration, profile.recordings));
    EVPOSE_RETURN_IF_ERROR(FinishOutput(picture, png));
  }
  return FinishOutput(file, SensorProfileToYaml(profile.calibration.profile));
}

absl::Status WriteCamera(const CameraCalibration& camera, std::optional<OutputFile>& file,
                         std::optional<OutputFile>& coverage) {
  if (coverage) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string png, DrawCoverage(camera));
    EVPOSE_RETURN_IF_ERROR(FinishOutput(coverage, png));
  }
  return FinishOutput(file, CameraModelToYaml(camera.camera));
}

void PrintWarnings(const std::vector<std::string>& warnings, CliContext& context) {
  for (const std::string& warning : warnings) context.err << "evpose calibrate: warning: " << warning << "\n";
}

// Adds to the error of a profile that the camera is written already.
absl::Status AfterTheCamera(const absl::Status& error, const std::string& camera_out) {
  return absl::Status(error.code(), absl::StrCat(error.message(), "; the camera is estimated and written to ",
                                                 camera_out, ", only the profile is not"));
}

absl::Status RunCalibrate(const CalibrateArguments& arguments, CliContext& context) {
  if (arguments.recordings.empty()) return UsageError("give RECORDINGS, which is required");
  if (!arguments.hand_eye.reference.empty()) {
    if (arguments.recordings.size() != 1) return UsageError("--hand-eye: give one file of evpose's poses");
    if (arguments.out.empty()) return UsageError("-o is required: the file for the pose of the camera");
    return RunHandEye(arguments.hand_eye, arguments.recordings.front(), arguments.out, arguments.is_json, context);
  }
  EVPOSE_RETURN_IF_ERROR(CheckMode(arguments));
  SensorProfile start;
  if (!arguments.start.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(start, LoadSensorProfile(arguments.start));
  }
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> profile_file, OpenOutput(arguments.out));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> picture, OpenOutput(arguments.picture));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> camera_file, OpenOutput(arguments.camera_out));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> coverage, OpenOutput(arguments.coverage));
  ProgressLine progress(context);
  std::optional<CameraCalibration> camera;
  if (arguments.IsCameraWanted()) {
    EVPOSE_ASSIGN_OR_RETURN(camera, EstimateCamera(context, arguments, start, progress));
    EVPOSE_RETURN_IF_ERROR(WriteCamera(*camera, camera_file, coverage));
    progress.Clear();
    PrintWarnings(camera->warnings, context);
  }
  std::optional<ProfileResult> profile;
  if (profile_file) {
    const std::optional<CameraModel> estimated = camera ? std::optional<CameraModel>(camera->camera) : std::nullopt;
    absl::StatusOr<ProfileResult> fitted = FitProfile(context, arguments, estimated, start, progress);
    if (!fitted.ok() && camera) return AfterTheCamera(fitted.status(), arguments.camera_out);
    EVPOSE_ASSIGN_OR_RETURN(profile, std::move(fitted));
    EVPOSE_RETURN_IF_ERROR(WriteProfile(*profile, profile_file, picture));
    progress.Clear();
    PrintWarnings(profile->calibration.warnings, context);
  }
  Json json = profile ? CalibrationJson(profile->calibration) : Json::object();
  if (camera) json["camera"] = CameraCalibrationJson(*camera);
  return PrintResult(context, arguments.is_json, json, [&](std::ostream& out) {
    if (camera) PrintCameraCalibration(*camera, out);
    if (profile) PrintCalibration(profile->calibration, out);
    for (const std::string& path : {arguments.camera_out, arguments.coverage, arguments.out, arguments.picture}) {
      if (!path.empty()) out << "written: " << path << "\n";
    }
  });
}

void AddCameraOptions(CLI::App& app, CalibrateArguments& arguments) {
  app.option_defaults()->group("Estimation of the camera");
  std::vector<std::pair<std::string, evpose::LensModel>> lenses;
  for (const evpose::LensModel lens :
       {evpose::LensModel::kBrown, evpose::LensModel::kRational, evpose::LensModel::kFisheye}) {
    lenses.emplace_back(LensModelName(lens), lens);
  }
  AddOutputFile(app, "--camera-out", arguments.camera_out,
                "Estimated camera, YAML of ROS camera_info; the file appears when it is complete");
  AddPicture(app, "--coverage", arguments.coverage,
             "Picture (.png) of where the object was seen, and of the uncertainty of the projection");
  app.add_option("--lens", arguments.lens,
                 "Model of the lens: brown (5 coefficients), rational (8, for wide lenses) or fisheye")
      ->excludes(app.get_option("--camera"))
      ->transform(CLI::Transformer(lenses))
      ->default_str("brown");
  CLI::Option* fov = app.add_option("--fov", arguments.fov_deg,
                                    "First guess of the horizontal field of view; an error of 20 % does no harm. "
                                    "Default: several are tried")
                         ->type_name("DEGREES")
                         ->check(NumberRange(1.0, 160.0));
  CLI::Option* focal = app.add_option("--focal-mm", arguments.focal_mm, "First guess of the focal length")
                           ->type_name("MILLIMETRES")
                           ->check(NumberRange(0.1, 1000.0))
                           ->excludes(fov);
  AddOption(app, "--pixel-um", arguments.pixel_um, "Width of a pixel. The default is that of an EVK4",
            NumberRange(0.5, 100.0))
      ->type_name("MICROMETRES")
      ->needs(focal);
}

void AddProfileOptions(CLI::App& app, CalibrateArguments& arguments) {
  app.option_defaults()->group("Estimation of the sensor's profile");
  AddOutputFile(
      app, "-o,--out", arguments.out,
      "Profile for evpose replay --sensor, YAML; with --hand-eye, the pose of the camera. The file appears when it "
      "is complete");
  AddFile(app, "--sensor", arguments.start,
          "Profile at the start, which is kept where the recordings determine nothing. Default: that of an EVK4");
  app.add_option("--name", arguments.name, "Name of the sensor in the profile")
      ->type_name("NAME")
      ->needs(app.get_option("--out"));
  AddPicture(app, "--picture", arguments.picture,
             "Picture (.png) of the residuals by speed and by event density, before and after the fit");
}

}  // namespace

CommandRunner AddCalibrateCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<CalibrateArguments>();
  app.option_defaults()->group(kInputGroup);
  app.add_option("recordings", arguments->recordings,
                 absl::StrCat("Recordings of one sensor and lens: ", kRecordingFormats))
      ->type_name("FILE");
  app.add_option("--model", arguments->models,
                 absl::StrCat("Model of the object, one for all recordings or one for each: ", kModelFormats))
      ->type_name("FILE");
  app.add_option(
         "--camera", arguments->cameras,
         absl::StrCat(kCameraFiles, "; one for all recordings or one for each. Without it, the camera is estimated"))
      ->type_name("FILE");
  app.add_option("--truth", arguments->truths,
                 "True poses on the sensor's clock, TUM, for each recording. Without them, the object is tracked")
      ->type_name("FILE")
      ->needs("--camera");
  arguments->reading.AddTo(app);
  AddJson(app, arguments->is_json);
  AddCameraOptions(app, *arguments);
  AddProfileOptions(app, *arguments);
  arguments->hand_eye.AddTo(app);
  app.footer(
      "Usage:\n  RECORDINGS... --model FILE --camera-out FILE\n  RECORDINGS... --model FILE --camera FILE --out FILE\n"
      "  POSES --hand-eye FILE --out FILE\n\n"
      "Without --camera, the camera is estimated from recordings of a moving object with straight edges, best the "
      "sheet of evpose target. Tilt it to all sides, and bring it into all parts of the image, near and far. The "
      "result is as good as the standard errors and the difference of the halves state; small residuals do not show "
      "that the result is accurate.\n\n"
      "With --camera, the profile alone is estimated. The object should move back and forth, slowly and fast, and have "
      "edges of several contrasts. An offset between the clocks of the truth and of the sensor cannot be distinguished "
      "from latency. Evaluate a profile on recordings to which it was not fitted.\n\n"
      "With --hand-eye, the pose of the camera on a robot or beside it is estimated from the poses of evpose and those "
      "of the robot. Turn about two axes at least, with changes of speed for the time offset.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --duration 2 --motion bursts --out cube\n"
      "  evpose calibrate cube/recording.raw --truth cube/truth.tum --model cube/model.obj --camera cube/camera.yaml "
      "--out sensor.yaml --picture residuals.png");
  return [arguments, &context] {
    TakeRecordings(*arguments);
    return RunCalibrate(*arguments, context);
  };
}

}  // namespace evpose::client
