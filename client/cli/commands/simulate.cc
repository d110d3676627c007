// SPDX-License-Identifier: Apache-2.0

// evpose simulate: writes a simulated recording with its true poses.
#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/progress.h"
#include "client/model_intake/model_intake.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/experiments/tracking/tracking_scenarios.h"
#include "core/geometry/undistortion_table.h"
#include "core/models/object_model.h"
#include "core/numerics/math.h"
#include "core/simulation/simulator.h"

namespace evpose::client {
namespace {

struct SimulateArguments {
  std::string object = "cube";
  std::string model;  // file; replaces the object
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

constexpr double kDurationS = 5.0;

absl::StatusOr<SimulationOptions> MakeScenario(const SimulateArguments& arguments) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<TrackingScenario> scenarios, FindTrackingScenarios({arguments.scenario}));
  const int64_t max_duration_us = std::llround(arguments.duration_s.value_or(0.0) * 1e6);
  SimulationOptions options =
      TrackingRun(scenarios.front(), arguments.seed, arguments.path_seed.value_or(arguments.seed), max_duration_us);
  options.t_begin_us = std::llround(arguments.start_s * 1e6);
  return options;
}

// The standard scene of the object or of the model.
absl::StatusOr<SimulationOptions> MakePreset(const SimulateArguments& arguments, const std::string& camera) {
  if (arguments.model.empty()) return SimulationPreset(arguments.object, camera, arguments.speed_scale);
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, arguments.reading.Load(arguments.model));
  return ModelSimulationPreset(std::make_shared<const ObjectModel>(std::move(model)), camera, arguments.speed_scale);
}

// The same with the camera of the option: one of the simulated ones, or that of a file.
absl::StatusOr<SimulationOptions> MakePresetWithCamera(const SimulateArguments& arguments) {
  const std::vector<std::string> names = SimulatedCameraNames();
  if (std::find(names.begin(), names.end(), arguments.camera) != names.end()) {
    return MakePreset(arguments, arguments.camera);
  }
  EVPOSE_ASSIGN_OR_RETURN(SimulationOptions options, MakePreset(arguments, names.front()));
  EVPOSE_ASSIGN_OR_RETURN(const CameraModel camera, LoadCameraModel(arguments.camera));
  absl::Status status = camera.CheckView();
  if (status.ok()) status = UndistortionTable::Create(camera).status();
  if (!status.ok()) return absl::InvalidArgumentError(absl::StrCat(arguments.camera, ": ", status.message()));
  UseCamera(camera, options);
  return options;
}

absl::StatusOr<SimulationOptions> MakeOptions(const SimulateArguments& arguments) {
  if (!arguments.scenario.empty()) return MakeScenario(arguments);
  EVPOSE_ASSIGN_OR_RETURN(SimulationOptions options, MakePresetWithCamera(arguments));
  options.scene.motion.view_angle_rad = arguments.view_angle_deg / kDegreesPerRadian;
  options.duration_us = std::llround(arguments.duration_s.value_or(kDurationS) * 1e6);
  options.t_begin_us = std::llround(arguments.start_s * 1e6);
  options.seed = arguments.seed;
  options.path_seed = arguments.path_seed;
  options.sensor = arguments.sensor;
  options.sensor.threshold_off = options.sensor.threshold_on;
  if (arguments.num_hot_pixels) {
    const double num_pixels = 1.0 * options.camera.width_px * options.camera.height_px;
    options.sensor.hot_pixel_ratio = std::min(1.0, *arguments.num_hot_pixels / num_pixels);
  }
  options.sensor.flood_hz = 1e6 * arguments.flood_mev_per_s;
  options.scene.lens_blur_px = arguments.scene.lens_blur_px;
  const double diffuse_ratio = options.scene.light.diffuse_ratio;
  options.scene.light = arguments.scene.light;
  options.scene.light.diffuse_ratio = diffuse_ratio;
  options.scene.background = arguments.scene.background;
  options.scene.occluder = arguments.scene.occluder;
  if (options.scene.occluder.follows_object) {
    options.scene.occluder.is_present = true;
    // Amplitude of the motion: a third of the width of the standard objects.
    options.scene.occluder.swing_ratio = 0.06;
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
  out << arguments.out << ": recording.raw, truth.tum, model.obj, camera.yaml\n";
  out << absl::StrFormat(
      "events %d (%.2f Mev/s)  noise %.1f %%  fastest point %.0f px/s\n", report.events, events * 1e-6 / duration_s,
      events > 0.0 ? 100.0 * static_cast<double>(report.noise_events) / events : 0.0, report.max_speed_px_per_s);
}

absl::Status RunSimulate(const SimulateArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const SimulationOptions options, MakeOptions(arguments));
  ProgressLine progress(context);
  const auto on_progress = [&progress](double ratio) {
    progress.Show(ratio, absl::StrFormat("simulated %3.0f %%", 100.0 * ratio));
  };
  const absl::StatusOr<SimulationReport> report =
      SimulateToDirectory(options, arguments.out, on_progress, context.is_interrupted);
  progress.Clear();
  if (!report.ok()) return report.status();
  const Json json = {{"directory", arguments.out},
                     {"events", report->events},
                     {"noise_events", report->noise_events},
                     {"rendered_frames", report->rendered_frames},
                     {"max_speed_px_per_s", report->max_speed_px_per_s}};
  return PrintResult(context, arguments.is_json, json, [&](std::ostream& out) {
    PrintReport(arguments, *report, static_cast<double>(options.duration_us) * 1e-6, out);
  });
}

void AddNoiseOptions(CLI::App& app, SimulateArguments& arguments) {
  AddOption(app, "--noise", arguments.sensor.noise_ratio, "Share of all events that are noise", CLI::Range(0.0, 0.9));
  app.add_option("--background-activity", arguments.sensor.shot_noise_hz,
                 "Noise rate of a pixel in the dark, hertz; a pixel that sees white has a quarter of it")
      ->check(CLI::Range(0.0, 1000.0))
      ->default_str("0.03");
  app.add_option("--hot-pixels", arguments.num_hot_pixels, "Number of hot pixels, which emit 200 events per second")
      ->check(CLI::Range(0, 1'000'000))
      ->default_str("1 of 100000");
  AddOption(app, "--flood", arguments.flood_mev_per_s,
            "Rate of additional random events during 50 ms of every second, Mev/s", CLI::Range(0.0, 100.0));
}

void AddModelOptions(CLI::App& app, SimulateArguments& arguments, CLI::Option* object) {
  CLI::Option* model = AddFile(app, "--model", arguments.model,
                               absl::StrCat("Model file (", kModelFormats,
                                            ") to simulate instead of --object, seen at a size of about 300 pixels "
                                            "from a random side, which --path-seed determines"))
                           ->excludes(object);
  arguments.reading.AddTo(app, model);
}

void AddOptions(CLI::App& app, SimulateArguments& arguments) {
  std::vector<std::string> motions;
  for (const auto& [name, profile] : kMotions) motions.emplace_back(name);
  app.add_option("-o,--out", arguments.out, "Directory for the files; it is created if it does not exist")->required();
  std::vector<std::string> scenarios;
  for (const TrackingScenario& scenario : TrackingScenarios()) scenarios.push_back(scenario.name);
  app.add_option("--scenario", arguments.scenario,
                 "A complete scene of `evpose bench tracking`; --duration shortens it")
      ->check(CLI::IsMember(scenarios));
  CLI::Option* object =
      AddOption(app, "--object", arguments.object, "The simulated object", CLI::IsMember(SimulatedObjectNames()));
  AddModelOptions(app, arguments, object);
  app.add_option("--camera", arguments.camera,
                 absl::StrCat("The sensor and its lens: ", absl::StrJoin(SimulatedCameraNames(), " or "),
                              ", or the file of a camera (evpose camera --help)"))
      ->capture_default_str();
  AddOption(app, "--view-angle", arguments.view_angle_deg,
            "Degrees between the optical axis and the middle of the path, to the right; for wide lenses",
            CLI::Range(-80.0, 80.0));
  app.add_option("--duration", arguments.duration_s, "Seconds")->check(CLI::Range(0.001, 1800.0))->default_str("5");
  AddOption(app, "--speed", arguments.speed_scale, "Factor on the speed of the motion", CLI::Range(0.0, 100.0));
  AddOption(
      app, "--motion", arguments.motion,
      "Continuous motion, motion with pauses, bursts at four times the speed, or motion half out of view and back",
      CLI::IsMember(motions));
  AddOption(app, "--flicker", arguments.scene.light.flicker_depth, "Depth of the light's 100 Hz flicker, 0 to 0.8",
            CLI::Range(0.0, 0.8));
  AddOption(app, "--light-change", arguments.scene.light.change_ratio,
            "The light oscillates between 1 and 1 / this factor", CLI::Range(1.0, 10.0));
  CLI::Option* occluder =
      app.add_flag("--occluder", arguments.scene.occluder.is_present, "A bar that oscillates in front of the object");
  app.add_flag("--occluder-on-object", arguments.scene.occluder.follows_object,
               "A bar that moves with the object and always hides a part of it")
      ->excludes(occluder);
  app.add_flag("--moving-edge", arguments.scene.background.has_moving_edge,
               "A straight edge that moves behind the object");
  app.add_flag("--textured-background", arguments.scene.background.is_textured,
               "Background of rectangles of several shades");
  AddNoiseOptions(app, arguments);
  AddOption(app, "--threshold", arguments.sensor.threshold_on, "Contrast threshold, natural logarithm of light",
            CLI::Range(0.01, 5.0));
  AddOption(app, "--bandwidth", arguments.sensor.bandwidth_hz, "Bandwidth of the photoreceptor, hertz; 0: infinite",
            CLI::Range(0.0, 1e6));
  AddOption(app, "--refractory", arguments.sensor.refractory_us,
            "Refractory time of a pixel after an event, microseconds", CLI::Range(0.0, 1e5));
  AddOption(app, "--lens-blur", arguments.scene.lens_blur_px, "Standard deviation of the lens's point spread, pixels",
            CLI::Range(0.0, 2.0));
  AddOption(app, "--start", arguments.start_s, "Start time on the sensor's clock, seconds", CLI::Range(0.0, 16.7));
  app.add_option("--seed", arguments.seed, "Seed of all random numbers; the same seed gives identical files")
      ->capture_default_str();
  app.add_option("--path-seed", arguments.path_seed, "Seed of the motion alone; default: --seed");
  app.add_flag("--json", arguments.is_json, "One JSON object on standard output");
}

}  // namespace

CommandRunner AddSimulateCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<SimulateArguments>();
  AddOptions(app, *arguments);
  for (const char* name : {"--object",      "--model",
                           "--camera",      "--view-angle",
                           "--speed",       "--motion",
                           "--noise",       "--background-activity",
                           "--hot-pixels",  "--flood",
                           "--flicker",     "--light-change",
                           "--occluder",    "--occluder-on-object",
                           "--moving-edge", "--textured-background",
                           "--threshold",   "--bandwidth",
                           "--refractory",  "--lens-blur"}) {
    app.get_option("--scenario")->excludes(app.get_option(name));
  }
  app.footer(
      "Writes recording.raw (EVT3, as an EVK4 does), truth.tum, model.obj and camera.yaml.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --noise 0.1 --out cube\n"
      "  evpose simulate --model cube/model.obj --camera vga --duration 0.1 --textured-background --out part");
  return [arguments, &context] { return RunSimulate(*arguments, context); };
}

}  // namespace evpose::client
