// evpose replay: a recording through a server, and the poses that come back.
#include <algorithm>
#include <atomic>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/command.h"
#include "client/cli/pose_format.h"
#include "client/cli/replay_report.h"
#include "client/cli/session_progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/events/recording_reader.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "server/rpc/server.h"

namespace evpose::client {
namespace {

constexpr size_t kMaxModelBytes = size_t{64} << 20;  // what a server takes by default

struct ReplayArguments {
  std::string recording;
  std::string model;
  std::vector<std::string> objects;  // "ID=MODEL"
  std::string camera;
  std::string sensor;
  ServerArguments server;
  std::string rate = "max";
  std::string out;
  std::vector<std::string> init_poses;
  std::string estimator = "mixture";
  size_t chunk_bytes = 0;
  double metres_per_unit = 1.0;
  bool is_following = false;
  bool keeps_session = false;
  bool is_json = false;
};

Estimator EstimatorByName(const std::string& name) {
  for (const auto& [estimator, known] : kEstimatorNames) {
    if (name == known) return estimator;
  }
  return Estimator::kMixture;  // the parser takes no other name
}

// "max" or a positive factor.
absl::StatusOr<double> ParseRate(const std::string& text) {
  if (text == "max") return 0.0;
  double rate = 0.0;
  if (absl::SimpleAtod(text, &rate) && rate > 0.0 && rate <= 1e6) return rate;
  return UsageError(
      absl::StrCat("--rate: \"", text, "\" is neither max nor a factor above 0, 1 being the sensor's pace"));
}

// Everything that can be wrong before a server is asked.
struct InputObject {
  std::string id;
  std::string model_path;
  std::string model_bytes;
  UploadOptions upload;
  std::optional<RigidTransform> initial_pose;
};

struct Inputs {
  double rate = 0.0;
  std::vector<InputObject> objects;
  CameraModel camera;
  SensorProfile sensor;
  std::unique_ptr<RecordingReader> reader;
  std::optional<PoseFiles> poses;
};

// "ID=REST". INVALID_ARGUMENT (usage) otherwise.
absl::StatusOr<std::pair<std::string, std::string>> SplitId(const std::string& text, const std::string& option) {
  const size_t sign = text.find('=');
  if (sign == std::string::npos || sign == 0 || sign + 1 == text.size()) {
    return UsageError(absl::StrCat(option, ": \"", text, "\" is not ID=", option == "--object" ? "MODEL" : "POSE"));
  }
  return std::make_pair(text.substr(0, sign), text.substr(sign + 1));
}

// The objects' names and files, not read yet.
absl::StatusOr<std::vector<InputObject>> ParseObjects(const ReplayArguments& arguments) {
  std::vector<InputObject> objects;
  if (arguments.model.empty() == arguments.objects.empty()) {
    return UsageError("give --model MODEL, or --object ID=MODEL for each of several objects");
  }
  if (!arguments.model.empty()) {
    objects.push_back({TrackedObject().object_id, arguments.model, {}, {}, {}});
    return objects;
  }
  for (const std::string& text : arguments.objects) {
    EVPOSE_ASSIGN_OR_RETURN(const auto id_and_model, SplitId(text, "--object"));
    for (const InputObject& other : objects) {
      if (other.id == id_and_model.first) return UsageError(absl::StrCat("--object ", other.id, " is there twice"));
    }
    objects.push_back({id_and_model.first, id_and_model.second, {}, {}, {}});
  }
  return objects;
}

absl::Status ParseInitialPoses(const ReplayArguments& arguments, std::vector<InputObject>& objects) {
  for (const std::string& text : arguments.init_poses) {
    std::pair<std::string, std::string> id_and_pose = {objects[0].id, text};
    if (!arguments.objects.empty()) {
      EVPOSE_ASSIGN_OR_RETURN(id_and_pose, SplitId(text, "--init-pose"));
    }
    const auto object = std::find_if(objects.begin(), objects.end(),
                                     [&](const InputObject& each) { return each.id == id_and_pose.first; });
    if (object == objects.end()) return UsageError(absl::StrCat("--init-pose: no --object ", id_and_pose.first));
    if (object->initial_pose) return UsageError(absl::StrCat("--init-pose of ", object->id, " is there twice"));
    const absl::StatusOr<RigidTransform> pose = ParsePose(id_and_pose.second);
    if (!pose.ok()) return absl::InvalidArgumentError(absl::StrCat("--init-pose: ", pose.status().message()));
    object->initial_pose = *pose;
  }
  return absl::OkStatus();
}

absl::StatusOr<Inputs> ReadInputs(const ReplayArguments& arguments, std::function<bool()> is_stopped) {
  Inputs inputs;
  EVPOSE_ASSIGN_OR_RETURN(inputs.rate, ParseRate(arguments.rate));
  EVPOSE_ASSIGN_OR_RETURN(inputs.objects, ParseObjects(arguments));
  std::vector<std::string> ids;
  for (const InputObject& object : inputs.objects) ids.push_back(object.id);
  if (!arguments.out.empty()) {
    const absl::Status checked = PoseFiles::Check(arguments.out, ids);
    if (!checked.ok()) return UsageError(absl::StrCat("--out ", checked.message()));
  }
  EVPOSE_RETURN_IF_ERROR(ParseInitialPoses(arguments, inputs.objects));
  EVPOSE_ASSIGN_OR_RETURN(inputs.camera, LoadCameraModel(arguments.camera));
  if (!arguments.sensor.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(inputs.sensor, LoadSensorProfile(arguments.sensor));
  }
  for (InputObject& object : inputs.objects) {
    EVPOSE_ASSIGN_OR_RETURN(object.upload.format, ModelFormatFromPath(object.model_path));
    object.upload.metres_per_unit = arguments.metres_per_unit;
    EVPOSE_ASSIGN_OR_RETURN(object.model_bytes, ReadFile(object.model_path, kMaxModelBytes));
  }
  RecordingReaderOptions options;
  options.follow = arguments.is_following;
  options.stop = std::move(is_stopped);
  EVPOSE_ASSIGN_OR_RETURN(inputs.reader, RecordingReader::Open(arguments.recording, options));
  EVPOSE_RETURN_IF_ERROR(
      CheckCameraMatches(inputs.camera, arguments.camera, inputs.reader->header(), arguments.recording));
  if (!arguments.out.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(inputs.poses, PoseFiles::Create(arguments.out, ids));
  }
  return inputs;
}

// The server that was asked for, or one inside this process: the same calls either way.
struct ServerHandle {
  std::unique_ptr<server::Server> own;
  std::unique_ptr<Client> client;
};

absl::StatusOr<ServerHandle> ConnectOrStart(const ServerArguments& arguments) {
  ServerHandle handle;
  if (!arguments.address.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(handle.client, arguments.Connect());
    return handle;
  }
  server::ServerOptions options;
  options.listen_address.clear();
  EVPOSE_ASSIGN_OR_RETURN(handle.own, server::Server::Start(options));
  handle.client = Client::OverChannel(handle.own->InProcessChannel(), "server in this process");
  return handle;
}

absl::StatusOr<Session> UploadAndCreate(Client& client, const ReplayArguments& arguments, const Inputs& inputs,
                                        ReplayReport& report) {
  SessionConfig config;
  config.encoding = inputs.reader->header().encoding;
  config.camera = inputs.camera;
  config.estimator = EstimatorByName(arguments.estimator);
  config.sensor = inputs.sensor;
  std::vector<std::string> paths;
  for (const InputObject& input : inputs.objects) {
    const absl::Span<const uint8_t> bytes(reinterpret_cast<const uint8_t*>(input.model_bytes.data()),
                                          input.model_bytes.size());
    absl::StatusOr<ModelInfo> model = client.UploadModel(bytes, input.upload);
    if (!model.ok()) {
      return absl::Status(model.status().code(), absl::StrCat(input.model_path, ": ", model.status().message()));
    }
    report.models.push_back({input.id, model->notices, model->num_symmetries});
    paths.push_back(input.model_path);
    TrackedObject object;
    object.object_id = input.id;
    object.model = model->name;
    object.initial_camera_from_object = input.initial_pose;
    config.objects.push_back(std::move(object));
  }
  absl::StatusOr<Session> session = client.CreateSession(config);
  if (!session.ok()) {
    return absl::Status(session.status().code(),
                        absl::StrCat("no session for ", absl::StrJoin(paths, ", "), " seen by ", arguments.camera, ": ",
                                     session.status().message()));
  }
  return session;
}

ChunkerOptions MakeChunkerOptions(const ReplayArguments& arguments) {
  ChunkerOptions options;
  if (arguments.chunk_bytes == 0) return options;
  options.max_bytes = arguments.chunk_bytes;
  options.max_duration_us = int64_t{1} << 40;  // by size alone
  return options;
}

// Feeds the session; fills the report and the file of poses.
absl::Status TrackRecording(Client& client, const Session& session, const ReplayArguments& arguments, Inputs& inputs,
                            const TrackOptions& options, CliContext& context, ReplayReport& report) {
  Chunker chunker(*inputs.reader, MakeChunkerOptions(arguments));
  const auto source = [&]() -> absl::StatusOr<EventChunkBytes> {
    if (context.is_interrupted && context.is_interrupted()) return EventChunkBytes{};
    return chunker.Next();
  };
  SessionProgress progress(context, client, session.name, inputs.reader->data_size_bytes(), !arguments.is_json);
  TrackCallbacks callbacks;
  callbacks.on_pose = [&](const Pose& pose) {
    if (inputs.poses) inputs.poses->Write(pose);
  };
  callbacks.on_notice = [&report](const Notice& notice) { report.Add(notice); };
  callbacks.on_progress = [&progress](const TrackProgress& value) { progress.Update(value); };
  const absl::Time begin = SystemClock().Now();
  const absl::StatusOr<TrackSummary> summary = client.Track(session, source, callbacks, options);
  progress.Stop();
  if (!summary.ok()) return summary.status();
  report.summary = *summary;
  report.wall_time = SystemClock().Now() - begin;
  report.truncated_bytes = chunker.truncated_bytes();
  report.is_interrupted = context.is_interrupted && context.is_interrupted();
  return inputs.poses ? inputs.poses->Commit() : absl::OkStatus();
}

absl::Status RunReplay(const ReplayArguments& arguments, CliContext& context) {
  TrackOptions options;
  options.clock = context.clock;
  const auto is_stopped = [&context, stop = options.stop.get_token()] {
    return stop.stop_requested() || (context.is_interrupted && context.is_interrupted());
  };
  EVPOSE_ASSIGN_OR_RETURN(Inputs inputs, ReadInputs(arguments, is_stopped));
  options.rate = inputs.rate;
  EVPOSE_ASSIGN_OR_RETURN(const ServerHandle server, ConnectOrStart(arguments.server));
  ReplayReport report;
  EVPOSE_ASSIGN_OR_RETURN(const Session session, UploadAndCreate(*server.client, arguments, inputs, report));
  report.recording = arguments.recording;
  report.session = arguments.keeps_session ? session.name : "";
  report.out = arguments.out;
  report.header = inputs.reader->header();
  const absl::Status status = TrackRecording(*server.client, session, arguments, inputs, options, context, report);
  // Its slot is free again at once. A server that does not answer any more has said so already.
  if (!arguments.keeps_session) server.client->DeleteSession(session.name).IgnoreError();
  EVPOSE_RETURN_IF_ERROR(status);
  if (arguments.is_json) {
    context.out << report.ToJson().dump(2, ' ', false, Json::error_handler_t::replace) << "\n";
  } else {
    report.Print(context.out);
  }
  return absl::OkStatus();
}

void AddOptions(CLI::App& app, ReplayArguments& arguments) {
  std::vector<std::string> estimators;
  for (const auto& [estimator, name] : kEstimatorNames) estimators.emplace_back(name);
  app.add_option("recording", arguments.recording, "Prophesee RAW or DAT file; - for standard input")->required();
  app.add_option("--model", arguments.model, "Object: OBJ, PLY or STL");
  app.add_option("--object", arguments.objects, "One of several objects, with a name of its own; once for each")
      ->type_name("ID=MODEL")
      ->allow_extra_args(false);
  app.add_option("--camera", arguments.camera, "Camera: ROS camera_info YAML")->required();
  app.add_option("--sensor", arguments.sensor,
                 "Profile of the sensor, as evpose calibrate writes it; by default an EVK4's");
  app.add_option("--scale", arguments.metres_per_unit, "Metres per unit of the model file")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--init-pose", arguments.init_poses,
                 "Pose at the first event, camera_from_object; without it the pose is found from the events. With "
                 "--object: \"ID=tx ...\", once for each object that has one")
      ->type_name("\"tx ty tz qx qy qz qw\"")
      ->allow_extra_args(false);
  app.add_option(
      "-o,--out", arguments.out,
      "Poses: .tum, .csv or .jsonl; written whole or not at all. {object} in the name: one file for each, of "
      "that ID");
  app.add_option("--rate", arguments.rate, "max, or a factor of the sensor's own pace")
      ->type_name("max|1|X")
      ->capture_default_str();
  app.add_option("--estimator", arguments.estimator,
                 "mixture; to compare with, the published static ones, corrected or as their code was released, and a "
                 "filter")
      ->check(CLI::IsMember(estimators))
      ->capture_default_str();
  app.add_option("--chunk-bytes", arguments.chunk_bytes,
                 "Send pieces of this size; by default 1 ms of sensor time or 256 KiB, whichever comes first")
      ->check(CLI::Range(size_t{8}, size_t{64} << 20))
      ->check(
          [](const std::string& text) {
            size_t bytes = 0;
            return absl::SimpleAtoi(text, &bytes) && bytes % 8 == 0 ? "" : "must be a multiple of 8, the longest word";
          },
          "multiple of 8");
  app.add_flag("--follow", arguments.is_following, "Keep reading as the file grows, until interrupted");
  arguments.server.AddTo(app, false);
  app.add_flag("--keep-session", arguments.keeps_session,
               "Leave the session on the server: its poses can be read again");
  app.add_flag("--json", arguments.is_json, "One JSON object on standard output");
}

}  // namespace

CommandRunner AddReplayCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<ReplayArguments>();
  AddOptions(app, *arguments);
  app.footer(
      "Without --server it serves itself, inside the process. Times are those of the sensor's clock. While the object\n"
      "is not found yet, or lost, no pose is written. An object that maps onto itself is given the pose that is\n"
      "nearest to no rotation when it is found, and the nearest to the last one from then on. An interrupt ends the\n"
      "stream cleanly: what was tracked is written. Latencies are from the server's receipt of a chunk to its pose:\n"
      "with --rate max those of a full queue, with --rate 1 those of a camera.\n"
      "Several objects: --object left=cube.obj --object right=book.obj --out poses-{object}.tum\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out cube/poses.tum");
  return [arguments, &context] { return RunReplay(*arguments, context); };
}

}  // namespace evpose::client
