// SPDX-License-Identifier: Apache-2.0

// evpose doctor: checks a recording, a live camera or a server for what goes wrong most often, and packs and replays
// bundles.
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/commands.h"
#include "client/cli/commands/doctor_bundle.h"
#include "client/cli/commands/doctor_recording.h"
#include "client/cli/commands/doctor_report.h"
#include "client/cli/commands/doctor_server.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/recording_input.h"
#include "client/diagnosis/recording_slice.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/command_line/number_range.h"
#include "core/diagnosis/object_checks.h"
#include "core/geometry/trajectory.h"

namespace evpose::client {
namespace {

constexpr char kBundleGroup[] = "Bundle";

struct DoctorArguments {
  DoctorRecording recording;
  std::string model;
  std::string camera;
  ModelReadingArguments reading;
  ServerArguments server;
  std::string bundle;
  std::string sensor;
  std::string initial_pose;
  std::string replay;
  bool is_json = false;
};

// The inputs of the checks beside the recording. They are read before the recording, which may take minutes.
struct DoctorInputs {
  std::optional<CameraModel> camera;
  std::optional<ObjectModel> model;
  std::optional<ModelUpload> upload;  // for a bundle and for a server
  SensorProfile sensor;
};

absl::Status CheckDoctorUsage(const DoctorArguments& arguments) {
  const bool has_recording = !arguments.recording.path.empty();
  if (!has_recording && arguments.server.address.empty() && arguments.replay.empty()) {
    return UsageError("give a RECORDING, --server HOST:PORT, or --replay FILE");
  }
  if (has_recording && !arguments.model.empty() && arguments.camera.empty()) {
    return UsageError("--model: give --camera, too: the distance of the object follows from both");
  }
  if (arguments.recording.is_pipe() && arguments.recording.start_s > 0.0) {
    return UsageError("--start: standard input has no beginning to count from");
  }
  if (arguments.bundle.empty()) return absl::OkStatus();
  if (arguments.recording.is_pipe()) {
    return UsageError("--bundle: standard input cannot be read twice: write it to a file first");
  }
  return arguments.initial_pose.empty() ? absl::OkStatus()
                                        : AsUsageError(ParsePose(arguments.initial_pose).status(), "--init-pose: ");
}

absl::StatusOr<DoctorInputs> ReadInputs(const DoctorArguments& arguments, const CliContext& context) {
  DoctorInputs inputs;
  if (!arguments.camera.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(inputs.camera, LoadCameraModel(arguments.camera));
  }
  if (!arguments.sensor.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(inputs.sensor, LoadSensorProfile(arguments.sensor));
  }
  if (arguments.model.empty()) return inputs;
  EVPOSE_ASSIGN_OR_RETURN(inputs.model, arguments.reading.Load(context, arguments.model));
  if (!arguments.bundle.empty() || !arguments.server.address.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(inputs.upload, arguments.reading.ReadForUpload(context, arguments.model));
  }
  return inputs;
}

// Appends the findings of the recording. Returns the bytes per second of its events in the busiest tenth of its time.
absl::StatusOr<double> ExamineRecording(const DoctorArguments& arguments, const DoctorInputs& inputs,
                                        CliContext& context, DoctorReport& report) {
  RecordingExamination examination(arguments.recording, context);
  EVPOSE_RETURN_IF_ERROR(examination.Read(inputs.camera));
  examination.Report(inputs.camera, report);
  if (inputs.model && inputs.camera) {
    report.findings.push_back(CheckScale(inputs.model->diameter_m, arguments.reading.metres_per_unit, *inputs.camera,
                                         examination.extent_px(), examination.options()));
    for (const std::string& notice : inputs.model->notices) report.subjects.push_back("model: " + notice);
  } else {
    report.findings.push_back(NotChecked("model-scale", "--model and --camera were not given"));
  }
  return examination.busy_bytes_per_s();
}

absl::StatusOr<RecordingSlice> SliceOfRecording(const DoctorArguments& arguments, const DoctorInputs& inputs,
                                                const CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(
      const std::unique_ptr<RecordingReader> reader,
      OpenSeenBy(*inputs.camera, arguments.camera, arguments.recording.path, {.stop = context.is_interrupted}));
  absl::StatusOr<RecordingSlice> slice =
      ReadSlice(*reader, {.start_s = arguments.recording.start_s, .duration_s = arguments.recording.duration_s});
  if (slice.ok()) return slice;
  return absl::Status(slice.status().code(), absl::StrCat(arguments.recording.path, ": ", slice.status().message()));
}

// Writes the bundle: the part of the recording, everything else that its poses are computed from, the poses and the
// report. Appends a subject to the report that states what the bundle contains.
absl::Status PackBundle(const DoctorArguments& arguments, const DoctorInputs& inputs, const CliContext& context,
                        DoctorReport& report) {
  EVPOSE_ASSIGN_OR_RETURN(RecordingSlice slice, SliceOfRecording(arguments, inputs, context));
  Bundle bundle;
  bundle.version = ThisBuild();
  bundle.recording = std::move(slice.file);
  bundle.model = inputs.upload->bytes;
  bundle.upload = inputs.upload->options;
  bundle.upload.file_name.clear();
  bundle.camera = *inputs.camera;
  bundle.sensor = inputs.sensor;
  bundle.initial_pose = arguments.initial_pose;
  // The bundle contains only the findings of the report: its subjects name files of this machine.
  bundle.report = DoctorReport{{}, report.findings}.ToJson().dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
  EVPOSE_ASSIGN_OR_RETURN(bundle.poses, TrackBundle(bundle, arguments.bundle, context));
  EVPOSE_RETURN_IF_ERROR(WriteBundle(arguments.bundle, bundle));
  const auto num_poses = static_cast<uint64_t>(std::count(bundle.poses.begin(), bundle.poses.end(), '\n'));
  std::string subject =
      absl::StrFormat("%s: bundle of %.3f to %.3f s, %.1f MB of events, %s", arguments.bundle,
                      1e-6 * static_cast<double>(slice.begin_us), 1e-6 * static_cast<double>(slice.end_us),
                      1e-6 * static_cast<double>(slice.data_bytes), Counted(num_poses, "pose"));
  if (slice.is_cut) {
    absl::StrAppend(&subject,
                    "; a bundle contains at most 60 s and 34 MB of events, and the rest is left out: --start ",
                    "and --duration choose another part");
  }
  report.subjects.push_back(std::move(subject));
  return absl::OkStatus();
}

absl::Status RunDoctor(const DoctorArguments& arguments, CliContext& context) {
  EVPOSE_RETURN_IF_ERROR(CheckDoctorUsage(arguments));
  if (!arguments.replay.empty()) return ReplayBundle(arguments.replay, arguments.is_json, context);
  EVPOSE_ASSIGN_OR_RETURN(const DoctorInputs inputs, ReadInputs(arguments, context));
  DoctorReport report;
  ServerNeeds needs;
  if (!arguments.recording.path.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(needs.bytes_per_s, ExamineRecording(arguments, inputs, context, report));
  }
  if (inputs.upload) needs.model_bytes = inputs.upload->bytes.size();
  if (!arguments.bundle.empty()) EVPOSE_RETURN_IF_ERROR(PackBundle(arguments, inputs, context, report));
  if (!arguments.server.address.empty()) {
    EVPOSE_RETURN_IF_ERROR(ExamineServers(arguments.server, needs, context, report));
  }
  EVPOSE_RETURN_IF_ERROR(
      PrintResult(context, arguments.is_json, report.ToJson(), [&report](std::ostream& out) { report.Print(out); }));
  const std::string problems = report.Names(Verdict::kProblem);
  if (problems.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("problems were found: ", problems));
}

void AddDoctorInputs(CLI::App& app, DoctorArguments& arguments) {
  app.option_defaults()->group(kInputGroup);
  CLI::Option* recording =
      AddFile(app, "recording", arguments.recording.path, absl::StrCat("Recording: ", kRecordingFormats));
  CLI::Option* model =
      AddFile(app, "--model", arguments.model,
              "Model of the object, whose size is compared with the events, and with the limit of --server");
  CLI::Option* camera = AddFile(app, "--camera", arguments.camera, kCameraFiles);
  arguments.reading.AddTo(app, model);
  CLI::Option* start = AddOption(app, "--start", arguments.recording.start_s,
                                 "Time after the first event at which the examination begins", NumberRange(0.0, 1e9))
                           ->type_name("SECONDS");
  CLI::Option* duration = app.add_option("--duration", arguments.recording.duration_s,
                                         "Time that is examined. Default: the rest of a file, 5 s of a pipe")
                              ->type_name("SECONDS")
                              ->check(AboveZero());
  for (CLI::Option* const option : {camera, start, duration}) option->needs(recording);
  arguments.server.AddTo(app, /*is_required=*/false);
}

void AddBundleOptions(CLI::App& app, DoctorArguments& arguments) {
  app.option_defaults()->group(kBundleGroup);
  CLI::Option* bundle =
      AddOutputFile(app, "--bundle", arguments.bundle,
                    "Archive (tar) to write, of the part of the recording from --start on, the model, the camera, the "
                    "options, the version, and the poses that this program computes from them");
  for (const char* name : {"recording", "--model", "--camera"}) bundle->needs(app.get_option(name));
  bundle->excludes(app.get_option("--server"));
  AddFile(app, "--sensor", arguments.sensor,
          "Profile of the sensor, as evpose calibrate writes it, for the poses. Default: that of an EVK4")
      ->needs(bundle);
  app.add_option("--init-pose", arguments.initial_pose,
                 "Pose camera_from_object at the first event of the bundle, \"tx ty tz qx qy qz qw\"; without it, the "
                 "object is searched for")
      ->type_name("POSE")
      ->needs(bundle);
  CLI::Option* replay = AddFile(app, "--replay", arguments.replay,
                                "Archive of --bundle: computes its poses again and compares them with those in it");
  for (const char* name : {"recording", "--model", "--camera", "--server", "--bundle"}) {
    replay->excludes(app.get_option(name));
  }
}

}  // namespace

CommandRunner AddDoctorCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<DoctorArguments>();
  AddDoctorInputs(app, *arguments);
  AddBundleOptions(app, *arguments);
  AddJson(app, arguments->is_json);
  app.footer(
      "Usage:\n  RECORDING\n  --server HOST:PORT [RECORDING]\n  --replay FILE\n\n"
      "Checks decoding, clock, event rate, motion, noise, hot and dead pixels, flicker, polarities and focus of a "
      "recording, or of a live camera whose RAW data come through a pipe (-), and the sizes of camera and model. Each "
      "check is ok, advice, a problem, or was not made, with the measured quantity, its limit, the places and the "
      "remedy.\n\n"
      "With --server, it checks whether the server can be reached, with TLS and the token, and serves; its version, "
      "sessions, limits and clock; the round trip; and the rate of the connection, by uploads of at most 16 MB that "
      "the server discards, against the events of the RECORDING if there is one.\n\n"
      "A bundle has at most 60 s and 34 MB of events. It contains no tokens, names of files or names of machines. Its "
      "poses are the same to the bit on every machine with the same version; --replay says whether they are, and "
      "otherwise where they differ first, and by how much.\n\n"
      "Exit status:\n"
      "  0  No problem was found, or the poses of --replay are identical\n"
      "  1  A problem was found, the poses differ, or an input cannot be read\n"
      "  2  Wrong usage\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose doctor cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --bundle cube/bundle.tar\n"
      "  evpose doctor --replay cube/bundle.tar");
  return [arguments, &context] { return RunDoctor(*arguments, context); };
}

}  // namespace evpose::client
