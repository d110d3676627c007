// SPDX-License-Identifier: Apache-2.0

// evpose simulate: writes a simulated recording with its true poses.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/console/progress.h"
#include "client/model_intake/model_intake.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/command_line/number_range.h"
#include "core/experiments/tracking/tracking_scenarios.h"
#include "core/geometry/undistortion_table.h"
#include "core/models/object_model.h"
#include "core/numerics/math.h"
#include "core/simulation/simulator.h"

namespace evpose::client {
namespace {

struct SimulateArguments {
  std::string object = "cube";
  std::string model;        // file; replaces the object
  double distance_m = 0.0;  // 0: that of the preset
  ModelReadingArguments reading;
  std::string camera = "evk4";
  std::string scenario;
  std::string out;
  std::string motion = "smooth";
  std::optional<double> duration_s;
  double view_angle_deg = 0.0;
  double speed_scale = 1.0;
  double start_s = 16.0;
  SensorOptions sensor;
  std::optional<double> threshold_off;
  SceneOptions scene;  // without the object and its motion
  std::optional<int> num_hot_pixels;
  double flood_mev_per_s = 0.0;
  uint64_t seed = 1;
  std::optional<uint64_t> path_seed;
  bool is_json = false;
};

constexpr std::pair<const char*, MotionProfile> kMotions[] = {{"smooth", MotionProfile::kSmooth},
                                                              {"rests", MotionProfile::kRests},
                                                              {"bursts", MotionProfile::kBursts},
                                                              {"half-out", MotionProfile::kHalfOut}};

constexpr double kDurationS = 5.0;  // as SimulationOptions::duration_us

absl::StatusOr<SimulationOptions> MakeScenario(const SimulateArguments& arguments) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<TrackingScenario> scenarios, FindTrackingScenarios({arguments.scenario}));
  const int64_t max_duration_us = std::llround(arguments.duration_s.value_or(0.0) * 1e6);
  SimulationOptions options =
      TrackingRun(scenarios.front(), arguments.seed, arguments.path_seed.value_or(arguments.seed), max_duration_us);
  options.t_begin_us = std::llround(arguments.start_s * 1e6);
  return options;
}

// Returns the standard scene of the object or of the model.
absl::StatusOr<SimulationOptions> MakePreset(const CliContext& context, const SimulateArguments& arguments,
                                             const std::string& camera) {
  if (arguments.model.empty()) return SimulationPreset(arguments.object, camera, arguments.speed_scale);
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, arguments.reading.Load(context, arguments.model));
  absl::StatusOr<SimulationOptions> options =
      ModelSimulationPreset(std::make_shared<const ObjectModel>(std::move(model)), camera, arguments.speed_scale);
  if (options.ok()) return options;
  return absl::Status(options.status().code(), absl::StrCat(arguments.model, ": ", options.status().message()));
}

// Returns the standard scene with the camera of the option: one of the simulated cameras, or that of a file.
absl::StatusOr<SimulationOptions> MakePresetWithCamera(const CliContext& context, const SimulateArguments& arguments) {
  const std::vector<std::string> names = SimulatedCameraNames();
  if (std::find(names.begin(), names.end(), arguments.camera) != names.end()) {
    return MakePreset(context, arguments, arguments.camera);
  }
  EVPOSE_ASSIGN_OR_RETURN(SimulationOptions options, MakePreset(context, arguments, names.front()));
  EVPOSE_ASSIGN_OR_RETURN(const CameraModel camera, LoadCameraModel(arguments.camera));
  absl::Status status = camera.CheckView();
  if (status.ok()) status = UndistortionTable::Create(camera).status();
  if (!status.ok()) return absl::InvalidArgumentError(absl::StrCat(arguments.camera, ": ", status.message()));
  UseCamera(camera, options);
  return options;
}

absl::StatusOr<SimulationOptions> MakeOptions(const CliContext& context, const SimulateArguments& arguments) {
  if (!arguments.scenario.empty()) return MakeScenario(arguments);
  EVPOSE_ASSIGN_OR_RETURN(SimulationOptions options, MakePresetWithCamera(context, arguments));
  options.scene.motion.view_angle_rad = arguments.view_angle_deg / kDegreesPerRadian;
  options.duration_us = std::llround(arguments.duration_s.value_or(kDurationS) * 1e6);
  options.t_begin_us = std::llround(arguments.start_s * 1e6);
  options.seed = arguments.seed;
  options.path_seed = arguments.path_seed;
  options.sensor = arguments.sensor;
  options.sensor.threshold_off = arguments.threshold_off.value_or(options.sensor.threshold_on);
  if (arguments.num_hot_pixels) {
    const double num_pixels = 1.0 * options.camera.width_px * options.camera.height_px;
    options.sensor.hot_pixel_ratio = std::min(1.0, *arguments.num_hot_pixels / num_pixels);
  }
  options.sensor.flood_hz = 1e6 * arguments.flood_mev_per_s;
  options.scene.shows_front = arguments.scene.shows_front;
  if (arguments.distance_m > 0.0) {
    // The speed in the image remains the same.
    options.scene.motion.speed_m_per_s *= arguments.distance_m / options.scene.motion.depth_m;
    options.scene.motion.depth_m = arguments.distance_m;
  }
  options.scene.lens_blur_px = arguments.scene.lens_blur_px;
  const double diffuse_ratio = options.scene.light.diffuse_ratio;
  options.scene.light = arguments.scene.light;
  options.scene.light.diffuse_ratio = diffuse_ratio;
  options.scene.background = arguments.scene.background;
  options.scene.occluder = arguments.scene.occluder;
  if (options.scene.occluder.follows_object) {
    options.scene.occluder.is_present = true;
    options.scene.occluder.swing_ratio = kFollowingSwingRatio;
  }
  for (const auto& [name, profile] : kMotions) {
    if (arguments.motion == name) options.scene.motion.profile = profile;
  }
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  return options;
}

void PrintReport(const SimulateArguments& arguments, const SimulationReport& report, double duration_s,
                 std::ostream& out) {
  const double events = static_cast<double>(report.events);
  out << arguments.out << ": recording.raw, truth.tum, model.obj, camera.yaml, simulation.txt\n";
  out << absl::StrFormat(
      "events %d (%.2f Mev/s)  noise %.1f %%  fastest point %.0f px/s\n", report.events, events * 1e-6 / duration_s,
      events > 0.0 ? 100.0 * static_cast<double>(report.noise_events) / events : 0.0, report.max_speed_px_per_s);
}

// Checks that the simulation replaces no input, and no files that are not of an earlier simulation.
absl::Status CheckDirectory(const SimulateArguments& arguments) {
  const std::filesystem::path directory(arguments.out);
  std::vector<NamedFile> outputs;
  for (const char* const name : kSimulationFiles) outputs.push_back({"--out", (directory / name).string()});
  EVPOSE_RETURN_IF_ERROR(
      CheckNothingIsOverwritten({{"--model", arguments.model}, {"--camera", arguments.camera}}, outputs));
  std::error_code error;
  if (std::filesystem::exists(directory / kSimulationNote, error)) return absl::OkStatus();
  for (const NamedFile& file : outputs) {
    if (!std::filesystem::exists(file.path, error)) continue;
    return absl::FailedPreconditionError(absl::StrCat(file.path, " exists, and without ", kSimulationNote,
                                                      " beside it this may be no file of an earlier simulation: ",
                                                      "give --out another directory, or remove the file"));
  }
  return absl::OkStatus();
}

absl::Status RunSimulate(const SimulateArguments& arguments, CliContext& context) {
  EVPOSE_RETURN_IF_ERROR(CheckDirectory(arguments));
  EVPOSE_ASSIGN_OR_RETURN(const SimulationOptions options, MakeOptions(context, arguments));
  ProgressLine progress(context);
  const auto on_progress = [&progress](double ratio) {
    progress.Show(ratio, absl::StrFormat("simulated %3.0f %%", 100.0 * ratio));
  };
  const absl::StatusOr<SimulationReport> report =
      SimulateToDirectory(options, arguments.out, on_progress, context.is_interrupted);
  progress.Clear();
  if (!report.ok()) return report.status();
  const std::vector<std::string> notices =
      options.scene.model != nullptr ? options.scene.model->notices : std::vector<std::string>();
  const Json json = {{"directory", arguments.out},
                     {"model_notices", notices},
                     {"events", report->events},
                     {"noise_events", report->noise_events},
                     {"rendered_frames", report->rendered_frames},
                     {"max_speed_px_per_s", report->max_speed_px_per_s}};
  return PrintResult(context, arguments.is_json, json, [&](std::ostream& out) {
    for (const std::string& notice : notices) out << "model: " << notice << "\n";
    PrintReport(arguments, *report, static_cast<double>(options.duration_us) * 1e-6, out);
  });
}

void AddSceneOptions(CLI::App& app, SimulateArguments& arguments) {
  app.option_defaults()->group("Scene");
  std::vector<std::string> scenarios;
  for (const TrackingScenario& scenario : TrackingScenarios()) scenarios.push_back(scenario.name);
  app.add_option("--scenario", arguments.scenario,
                 "A complete scene of evpose bench tracking instead of the options of scene, disturbances and sensor; "
                 "--duration shortens it")
      ->check(CLI::IsMember(scenarios));
  CLI::Option* const object =
      AddOption(app, "--object", arguments.object, "Simulated object", CLI::IsMember(SimulatedObjectNames()));
  CLI::Option* const model = AddFile(app, "--model", arguments.model,
                                     absl::StrCat("Model of the object instead of --object (", kModelFormats,
                                                  "), seen at a size of about 300 pixels from a random side. What is "
                                                  "rendered is the surface that evpose understands from the file, as "
                                                  "the tracker uses it: repaired, and smooth where facets approximate "
                                                  "a curved surface (with --surface as-is the facets)"))
                                 ->excludes(object);
  arguments.reading.AddTo(app, model);
  for (const char* const name : {"--scale", "--crease-angle", "--surface"}) app.get_option(name)->group("Scene");
  app.add_flag(
         "--front", arguments.scene.shows_front,
         "Point the z axis of the model to the camera and its y axis upwards on average, instead of a random side")
      ->needs(model);
  app.add_option("--distance", arguments.distance_m,
                 "Mean distance of the model from the camera. Default: 3.4 times its diameter")
      ->type_name("METRES")
      ->check(NumberRange(0.01, 1e4))
      ->needs(model);
  app.add_option("--camera", arguments.camera,
                 absl::StrCat("Sensor and lens: ", absl::StrJoin(SimulatedCameraNames(), ", "),
                              ", or a file that evpose camera reads"))
      ->type_name("NAME|FILE")
      ->capture_default_str();
  AddOption(app, "--view-angle", arguments.view_angle_deg,
            "Angle from the optical axis to the middle of the path, to the right; for wide lenses",
            NumberRange(-80.0, 80.0))
      ->type_name("DEGREES");
}

void AddMotionOptions(CLI::App& app, SimulateArguments& arguments) {
  app.option_defaults()->group("Motion and time");
  std::vector<std::string> motions;
  for (const auto& [name, profile] : kMotions) motions.emplace_back(name);
  AddOption(app, "--motion", arguments.motion,
            "Continuous motion, motion with rests, bursts at four times the speed, or motion half out of view and back",
            CLI::IsMember(motions));
  AddOption(app, "--speed", arguments.speed_scale, "Factor on the speed of the motion", NumberRange(0.0, 100.0))
      ->type_name("FACTOR");
  app.add_option("--duration", arguments.duration_s, "Length of the recording")
      ->type_name("SECONDS")
      ->check(NumberRange(0.001, 1800.0))
      ->default_str("5");
  AddOption(app, "--start", arguments.start_s, "Time of the first event on the sensor's clock", NumberRange(0.0, 16.7))
      ->type_name("SECONDS");
  app.add_option("--seed", arguments.seed, "Seed of all random numbers; the same seed gives identical files")
      ->check(WholeNumber())
      ->capture_default_str();
  app.add_option("--path-seed", arguments.path_seed, "Seed of the motion alone. Default: that of --seed")
      ->check(WholeNumber());
}

void AddDisturbances(CLI::App& app, SimulateArguments& arguments) {
  app.option_defaults()->group("Disturbances");
  AddOption(app, "--noise", arguments.sensor.noise_ratio, "Share of all events that are noise", NumberRange(0.0, 0.9))
      ->type_name("RATIO");
  app.add_option("--background-activity", arguments.sensor.shot_noise_hz,
                 "Noise rate of a pixel in the dark; a pixel that sees white has a quarter of it")
      ->type_name("HZ")
      ->check(NumberRange(0.0, 1000.0))
      ->default_str("0.03");
  app.add_option("--hot-pixels", arguments.num_hot_pixels, "Number of hot pixels, which emit 200 events per second")
      ->check(NumberRange(0, 1'000'000))
      ->default_str("1 of 100000");
  AddOption(app, "--flood", arguments.flood_mev_per_s,
            "Rate of additional random events during 50 ms of every second, millions of events per second",
            NumberRange(0.0, 100.0))
      ->type_name("MEV/S");
  AddOption(app, "--flicker", arguments.scene.light.flicker_depth, "Depth of the light's flicker at 100 Hz",
            NumberRange(0.0, 0.8))
      ->type_name("RATIO");
  AddOption(app, "--light-change", arguments.scene.light.change_ratio,
            "Factor by which the light slowly becomes weaker and stronger", NumberRange(1.0, 10.0))
      ->type_name("FACTOR");
  CLI::Option* const occluder =
      app.add_flag("--occluder", arguments.scene.occluder.is_present, "A bar that oscillates in front of the object");
  app.add_flag("--occluder-on-object", arguments.scene.occluder.follows_object,
               "A bar that moves with the object and always hides a part of it")
      ->excludes(occluder);
  app.add_flag("--moving-edge", arguments.scene.background.has_moving_edge,
               "A straight edge that moves behind the object");
  CLI::Option* const textured = app.add_flag("--textured-background", arguments.scene.background.is_textured,
                                             "A background of rectangles of several shades");
  AddOption(app, "--background-rectangles", arguments.scene.background.texture_rectangles,
            "Number of the rectangles of --textured-background", NumberRange(1, 10'000))
      ->needs(textured);
  AddOption(
      app, "--background-speed", arguments.scene.background.texture_speed_px_per_s,
      "Mean speed in the image of the rectangles of --textured-background, as of the surroundings of a camera that "
      "is turned to and fro",
      NumberRange(0.0, 1e5))
      ->type_name("PIXELS/S")
      ->needs(textured);
}

void AddSensorOptions(CLI::App& app, SimulateArguments& arguments) {
  app.option_defaults()->group("Sensor");
  AddOption(app, "--threshold", arguments.sensor.threshold_on,
            "Contrast threshold, as a difference of natural logarithms of light", NumberRange(0.01, 5.0))
      ->type_name("RATIO");
  app.add_option("--threshold-off", arguments.threshold_off,
                 "Contrast threshold of OFF events. Default: that of --threshold")
      ->type_name("RATIO")
      ->check(NumberRange(0.01, 5.0));
  AddOption(app, "--bandwidth", arguments.sensor.bandwidth_hz, "Bandwidth of the photoreceptor; 0: infinite",
            NumberRange(0.0, 1e6))
      ->type_name("HZ");
  AddOption(app, "--refractory", arguments.sensor.refractory_us, "Refractory time of a pixel after an event",
            NumberRange(0.0, 1e5))
      ->type_name("MICROSECONDS");
  AddOption(app, "--lens-blur", arguments.scene.lens_blur_px, "Standard deviation of the lens's point spread",
            NumberRange(0.0, 2.0))
      ->type_name("PIXELS");
}

void AddOptions(CLI::App& app, SimulateArguments& arguments) {
  app.add_option(
         "-o,--out", arguments.out,
         "Directory for the files; it is made if it does not exist. Files of an earlier simulation there are replaced")
      ->type_name("DIR")
      ->required()
      ->check(NotEmpty())
      ->group(kOutputGroup);
  AddJson(app, arguments.is_json);
  AddSceneOptions(app, arguments);
  AddMotionOptions(app, arguments);
  AddDisturbances(app, arguments);
  AddSensorOptions(app, arguments);
}

}  // namespace

CommandRunner AddSimulateCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<SimulateArguments>();
  AddOptions(app, *arguments);
  for (const char* name : {"--object",
                           "--model",
                           "--camera",
                           "--view-angle",
                           "--speed",
                           "--motion",
                           "--noise",
                           "--background-activity",
                           "--hot-pixels",
                           "--flood",
                           "--flicker",
                           "--light-change",
                           "--occluder",
                           "--occluder-on-object",
                           "--moving-edge",
                           "--textured-background",
                           "--background-rectangles",
                           "--background-speed",
                           "--threshold",
                           "--threshold-off",
                           "--bandwidth",
                           "--refractory",
                           "--lens-blur"}) {
    app.get_option("--scenario")->excludes(app.get_option(name));
  }
  app.footer(
      "Writes recording.raw (EVT3, as an EVK4 does), truth.tum, model.obj, camera.yaml and simulation.txt, which has "
      "the options.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --noise 0.1 --out cube\n"
      "  evpose simulate --model cube/model.obj --camera vga --duration 0.1 --textured-background --out part");
  return [arguments, &context] { return RunSimulate(*arguments, context); };
}

}  // namespace evpose::client
