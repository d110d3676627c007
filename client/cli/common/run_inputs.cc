// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/run_inputs.h"

#include <algorithm>
#include <functional>
#include <optional>
#include <stop_token>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/common/recording_input.h"
#include "client/cli/console/stop_on_interrupt.h"
#include "client/cli/console/wait_message.h"
#include "client/lib/messages/core_types.h"
#include "client/lib/messages/status_details.h"
#include "client/model_intake/model_intake.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/command_line/number_range.h"
#include "core/events/first_time_word.h"
#include "core/geometry/trajectory.h"

namespace evpose::client {
namespace {

// The names of the estimators that servers offer.
std::vector<std::string> OfferedEstimators() {
  std::vector<std::string> names;
  for (const auto& [estimator, name] : kEstimatorNames) {
    if (FromCore(estimator)) names.emplace_back(name);
  }
  return names;
}

// Returns the error for an estimator that exists, but is not offered by servers; used as CLI::Option::check().
std::string CheckIsOffered(const std::string& text) {
  for (const auto& [estimator, name] : kEstimatorNames) {
    if (text != name || FromCore(estimator)) continue;
    return absl::StrCat(text, " is not offered by servers: `evpose bench tracking` runs it");
  }
  return "";
}

absl::StatusOr<PoseEstimator> EstimatorByName(const std::string& text) {
  for (const auto& [estimator, name] : kEstimatorNames) {
    const std::optional<PoseEstimator> offered = FromCore(estimator);
    if (text == name && offered) return *offered;
  }
  return UsageError(absl::StrCat("--estimator ", text, ": there is no such estimator"));
}

// "ID=REST". INVALID_ARGUMENT (usage) otherwise.
absl::StatusOr<std::pair<std::string, std::string>> SplitId(const std::string& text, const std::string& option) {
  const size_t sign = text.find('=');
  if (sign == std::string::npos || sign == 0 || sign + 1 == text.size()) {
    return UsageError(absl::StrCat(option, ": \"", text, "\" is not ID=", option == "--object" ? "MODEL" : "POSE"));
  }
  return std::make_pair(text.substr(0, sign), text.substr(sign + 1));
}

// The objects' names and files, not read yet.
absl::StatusOr<std::vector<InputObject>> ParseObjects(const RunArguments& arguments) {
  EVPOSE_ASSIGN_OR_RETURN(const auto ids_and_models, ParseObjectModels(arguments.model, arguments.objects));
  std::vector<InputObject> objects;
  for (const auto& [id, model] : ids_and_models) objects.push_back({id, model, {}, {}});
  return objects;
}

// Parses "POSE" of the only object, or "ID=POSE" with --object.
absl::StatusOr<PoseReset> ParseObjectPose(const RunArguments& arguments, const std::vector<InputObject>& objects,
                                          const std::string& text, const std::string& option) {
  std::pair<std::string, std::string> id_and_pose = {objects[0].id, text};
  if (!arguments.objects.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(id_and_pose, SplitId(text, option));
  }
  const auto& [id, pose_text] = id_and_pose;
  const auto has_id = [&id = id](const InputObject& object) { return object.id == id; };
  if (std::none_of(objects.begin(), objects.end(), has_id)) {
    return UsageError(absl::StrCat(option, ": no --object ", id));
  }
  const absl::StatusOr<RigidTransform> pose = ParsePose(pose_text);
  EVPOSE_RETURN_IF_ERROR(AsUsageError(pose.status(), option + ": "));
  return PoseReset{id, FromCore(*pose)};
}

absl::Status ParseInitialPoses(const RunArguments& arguments, std::vector<InputObject>& objects) {
  for (const std::string& text : arguments.init_poses) {
    EVPOSE_ASSIGN_OR_RETURN(const PoseReset initial, ParseObjectPose(arguments, objects, text, "--init-pose"));
    for (InputObject& object : objects) {
      if (object.id != initial.object_id) continue;
      if (object.initial_pose) return UsageError(absl::StrCat("--init-pose of ", object.id, " was given twice"));
      object.initial_pose = initial.camera_from_object;
    }
  }
  return absl::OkStatus();
}

// "T_US POSE", or "T_US ID=POSE" with --object.
absl::StatusOr<TimedReset> ParseReset(const RunArguments& arguments, const std::vector<InputObject>& objects,
                                      const std::string& text) {
  const std::pair<std::string, std::string> time_and_pose = absl::StrSplit(text, absl::MaxSplits(' ', 1));
  TimedReset timed;
  if (!absl::SimpleAtoi(time_and_pose.first, &timed.t_us) || timed.t_us < 0) {
    return UsageError(absl::StrCat("--reset-pose: \"", text, "\" does not begin with a sensor time in microseconds"));
  }
  EVPOSE_ASSIGN_OR_RETURN(timed.reset, ParseObjectPose(arguments, objects, time_and_pose.second, "--reset-pose"));
  return timed;
}

absl::Status ParseResets(const RunArguments& arguments, RunInputs& inputs) {
  if (!arguments.reset_poses.empty() && arguments.recording == "-" && !arguments.resume.empty()) {
    return UsageError("--reset-pose: is not possible with --resume on standard input, which cannot be read again");
  }
  for (const std::string& text : arguments.reset_poses) {
    EVPOSE_ASSIGN_OR_RETURN(TimedReset reset, ParseReset(arguments, inputs.objects, text));
    inputs.resets.push_back(std::move(reset));
  }
  std::stable_sort(inputs.resets.begin(), inputs.resets.end(),
                   [](const TimedReset& a, const TimedReset& b) { return a.t_us < b.t_us; });
  return absl::OkStatus();
}

// RecordingReaderOptions::stop of a reader, and whether the reader was told to stop.
struct StopRequest {
  std::function<bool()> stop;
  std::atomic<bool> was_told = false;

  bool Ask() {
    if (stop && stop()) was_told = true;
    return was_told;
  }
};

// Ends as soon as a stop is requested, even while data are available: the bytes read until then are the recording. If
// the run is to be continued, the stop is an error instead, so that the session does not end.
class StoppableReader final : public RecordingReader {
 public:
  StoppableReader(std::unique_ptr<RecordingReader> reader, std::shared_ptr<StopRequest> stop, const RunInputs& inputs,
                  const RunArguments& arguments)
      : reader_(std::move(reader)),
        stop_(std::move(stop)),
        first_time_(reader_->header().encoding, reader_->header().metavision_zero_us),
        metavision_zero_us_(inputs.metavision_zero_us),
        has_ended_(inputs.has_ended),
        stop_status_(arguments.resume.empty() || arguments.ends_at_interrupt
                         ? absl::OkStatus()
                         : absl::CancelledError(absl::StrCat(arguments.recording, ": interrupted before its end"))) {}

  const RecordingHeader& header() const override { return reader_->header(); }
  int64_t data_size_bytes() const override { return reader_->data_size_bytes(); }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    if (*has_ended_) return 0;
    if (stop_->Ask()) return Stopped();
    EVPOSE_ASSIGN_OR_RETURN(const size_t size, reader_->Read(buffer));
    first_time_.Add(buffer.first(size));
    *metavision_zero_us_ = first_time_.t_us().value_or(0);
    if (size > 0) return size;
    // The source itself knows whether this is the end: an interrupt may have come after it.
    if (stop_->was_told) return Stopped();
    *has_ended_ = true;
    return 0;
  }
  bool follows_loss() const override { return reader_->follows_loss(); }
  std::vector<SkippedParts> skipped() const override { return reader_->skipped(); }

 private:
  absl::StatusOr<size_t> Stopped() const {
    EVPOSE_RETURN_IF_ERROR(stop_status_);
    return 0;
  }

  const std::unique_ptr<RecordingReader> reader_;
  const std::shared_ptr<StopRequest> stop_;
  FirstTimeWord first_time_;
  const std::shared_ptr<std::atomic<int64_t>> metavision_zero_us_;
  const std::shared_ptr<std::atomic<bool>> has_ended_;
  const absl::Status stop_status_;
};

// The error of a server for an initial pose, which names the field of the API, in terms of the options; empty for
// other errors.
std::string DescribeInitialPose(const absl::Status& status, const RunInputs& inputs) {
  const std::string field = GetDetails(status).field;
  for (size_t i = 0; i < inputs.objects.size(); ++i) {
    const std::string pose = absl::StrCat("config.objects[", i, "].initial_camera_from_object");
    if (field != pose && !absl::StartsWith(field, pose + ".")) continue;
    const std::string of = inputs.objects.size() > 1 ? absl::StrCat(" of ", inputs.objects[i].id) : "";
    const absl::string_view message = status.message();
    const std::string name = absl::StrCat(": ", field, ": ");  // between the address and the description
    const size_t begin = message.find(name);
    return absl::StrCat("--init-pose", of, ": ",
                        begin == absl::string_view::npos ? message : message.substr(begin + name.size()));
  }
  return "";
}

absl::Status ReadObjects(const CliContext& context, const RunArguments& arguments, std::vector<InputObject>& objects) {
  for (InputObject& object : objects) {
    EVPOSE_ASSIGN_OR_RETURN(object.model, arguments.reading.ReadForUpload(context, object.model_path));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::vector<std::pair<std::string, std::string>>> ParseObjectModels(
    const std::string& model, const std::vector<std::string>& objects) {
  if (model.empty() == objects.empty()) {
    return UsageError("give --model MODEL, or --object ID=MODEL for each of several objects");
  }
  if (!model.empty()) return std::vector{std::make_pair(TrackedObject().object_id, model)};
  std::vector<std::pair<std::string, std::string>> parsed;
  for (const std::string& text : objects) {
    EVPOSE_ASSIGN_OR_RETURN(auto id_and_model, SplitId(text, "--object"));
    for (const auto& [other, unused] : parsed) {
      if (other == id_and_model.first) return UsageError(absl::StrCat("--object ", other, " was given twice"));
    }
    parsed.push_back(std::move(id_and_model));
  }
  return parsed;
}

void AddObjectModels(CLI::App& app, std::string& model, std::vector<std::string>& objects) {
  CLI::Option* const one = AddFile(app, "--model", model, absl::StrCat("Model of the object: ", kModelFormats));
  app.add_option("--object", objects, "Name and model of one of several objects; to be repeated for each of them")
      ->type_name("ID=FILE")
      ->allow_extra_args(false)
      ->excludes(one);
}

std::vector<std::string> RunInputs::object_ids() const {
  std::vector<std::string> ids;
  for (const InputObject& object : objects) ids.push_back(object.id);
  return ids;
}

absl::StatusOr<RunInputs> ReadRunInputs(const CliContext& context, const RunArguments& arguments,
                                        const RecordingReaderOptions& reader_options) {
  RunInputs inputs;
  EVPOSE_ASSIGN_OR_RETURN(inputs.objects, ParseObjects(arguments));
  if (!arguments.out.empty()) {
    EVPOSE_RETURN_IF_ERROR(AsUsageError(PoseFiles::Check(arguments.out, inputs.object_ids()), "--out "));
  }
  EVPOSE_RETURN_IF_ERROR(arguments.recording_options.Check(arguments.out));
  EVPOSE_RETURN_IF_ERROR(ParseInitialPoses(arguments, inputs.objects));
  EVPOSE_RETURN_IF_ERROR(ParseResets(arguments, inputs));
  EVPOSE_ASSIGN_OR_RETURN(inputs.camera, LoadCameraModel(arguments.camera));
  if (!arguments.sensor.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(inputs.sensor, LoadSensorProfile(arguments.sensor));
  }
  EVPOSE_ASSIGN_OR_RETURN(inputs.frame, arguments.frame.Read(context.err));
  EVPOSE_RETURN_IF_ERROR(ReadObjects(context, arguments, inputs.objects));
  const std::optional<WaitMessage> wait = WaitForRecording(context, arguments.recording);
  const auto stop = std::make_shared<StopRequest>();
  stop->stop = reader_options.stop;
  EVPOSE_ASSIGN_OR_RETURN(
      std::unique_ptr<RecordingReader> reader,
      OpenSeenBy(inputs.camera, arguments.camera, arguments.recording,
                 {.is_following = reader_options.is_following, .stop = [stop] { return stop->Ask(); }}));
  inputs.reader = std::make_unique<StoppableReader>(std::move(reader), stop, inputs, arguments);
  return inputs;
}

void AddDueResets(std::vector<TimedReset>& resets, EventChunk& chunk) {
  if (chunk.bytes.empty()) return;  // the end
  const auto is_later = [&chunk](const TimedReset& each) { return each.t_us > chunk.t_last_us; };
  const auto end = std::find_if(resets.begin(), resets.end(), is_later);
  for (auto each = resets.begin(); each != end; ++each) chunk.resets.push_back(std::move(each->reset));
  resets.erase(resets.begin(), end);
}

ChunkerOptions MakeChunkerOptions(const RunArguments& arguments) {
  ChunkerOptions options;
  if (arguments.chunk_bytes == 0) return options;
  options.max_bytes = arguments.chunk_bytes;
  options.max_duration_us = int64_t{1} << 40;  // by size alone
  return options;
}

absl::StatusOr<SessionConfig> UploadModels(const CliContext& context, Client& client, const RunArguments& arguments,
                                           const RunInputs& inputs, ReplayReport& report) {
  SessionConfig config = {.encoding = FromCore(inputs.reader->header().encoding), .camera = FromCore(inputs.camera)};
  EVPOSE_ASSIGN_OR_RETURN(config.estimator, EstimatorByName(arguments.estimator));
  config.sensor = FromCore(inputs.sensor);
  config.pose_rate_hz = arguments.pose_rate_hz;
  report.models.clear();
  for (const InputObject& input : inputs.objects) {
    absl::StatusOr<ModelInfo> model = UploadModel(context, client, input.model_path, input.model);
    if (!model.ok()) return model.status();
    report.models.push_back(
        {input.id, model->notices, model->num_symmetries, model->diameter_m, model->continuous_symmetry});
    config.objects.push_back(
        {.object_id = input.id, .model = model->name, .initial_camera_from_object = input.initial_pose});
  }
  return config;
}

absl::StatusOr<Session> CreateSession(const CliContext& context, Client& client, const SessionConfig& config,
                                      const RunArguments& arguments, const RunInputs& inputs,
                                      const std::string& request_id) {
  const WaitMessage wait(context, "the server to create the session, for which it draws views of each model");
  // The session waits for its turn at a server that others use, too. With ends_at_interrupt, the data that was read
  // until the interrupt is still tracked.
  std::optional<StopOnInterrupt> interrupt;
  if (!arguments.ends_at_interrupt && !arguments.server.address.empty()) interrupt.emplace(context);
  absl::StatusOr<Session> session = client.CreateSession(config, request_id, /*max_wait=*/absl::ZeroDuration(),
                                                         interrupt ? interrupt->stop().get_token() : std::stop_token());
  if (session.ok()) return session;
  if (interrupt && interrupt->stop().stop_requested() && absl::IsCancelled(session.status())) {
    return absl::CancelledError(
        absl::StrCat(arguments.recording, ": interrupted before the server had created a session"));
  }
  if (const std::string why = DescribeInitialPose(session.status(), inputs); !why.empty()) {
    return WithMessage(session.status(), why);
  }
  const std::string models = absl::StrJoin(inputs.objects, ", ", [](std::string* text, const InputObject& object) {
    absl::StrAppend(text, object.model_path);
  });
  // The details say whether and when to try again.
  return WithMessage(session.status(), absl::StrCat("no session for ", models, " seen by ", arguments.camera, ": ",
                                                    session.status().message()));
}

RetainOptions RunArguments::retain() const {
  if (server.address.empty()) return {.duration = absl::ZeroDuration()};
  return {.duration = absl::Seconds(retain_s), .max_bytes = retain_bytes};
}

void RunArguments::AddInputs(CLI::App& app) {
  app.option_defaults()->group(kInputGroup);
  AddFile(app, "recording", recording, absl::StrCat("Recording: ", is_live ? kLiveFormats : kRecordingFormats))
      ->required();
  AddObjectModels(app, model, objects);
  AddFile(app, "--camera", camera, kCameraFiles)->required();
  AddFile(app, "--sensor", sensor, "Profile of the sensor, as evpose calibrate writes it. Default: that of an EVK4");
  reading.AddTo(app);
}

void RunArguments::AddOutputs(CLI::App& app, const std::string& epoch_default) {
  app.option_defaults()->group(kOutputGroup);
  AddOutputFile(
      app, "-o,--out", out,
      absl::StrCat("Poses: ", kPoseFormats,
                   ", with covariances, transforms, model, camera and health; the file appears when the run has "
                   "ended. {object} in the name stands for the ID of each object"));
  recording_options.AddTo(app, epoch_default);
  frame.AddTo(app);
  AddOutputFile(
      app, "--clock-log", clock_log,
      "CSV with the host's times (UTC) at which events, poses and triggers arrived, and their sensor times, which "
      "relates the sensor's clock to others");
  AddJson(app, is_json);
}

void RunArguments::AddTracking(CLI::App& app) {
  app.option_defaults()->group(kTrackingGroup);
  AddOption(app, "--pose-rate", pose_rate_hz,
            "Poses per second of each object. A pose needs 150 events, so that 10000 poses need 1.5 million events per "
            "second; with fewer events there are fewer poses. Poses at a higher rate are as accurate, and their "
            "processing takes longer",
            NumberRange(1000.0, 10'000.0))
      ->type_name("HZ");
  app.add_option("--init-pose", init_poses,
                 "Pose camera_from_object at the first event, \"tx ty tz qx qy qz qw\"; without it, the object is "
                 "searched for. With --object: \"ID=tx ...\", once for each object with a known pose")
      ->type_name("POSE")
      ->allow_extra_args(false);
  app.add_option(
         "--reset-pose", reset_poses,
         "Pose camera_from_object from which tracking starts anew, before the first chunk of events that reaches "
         "the sensor time T_US, in microseconds: \"T_US tx ty tz qx qy qz qw\", with --object \"T_US ID=tx "
         "...\". May be repeated")
      ->type_name("POSE")
      ->allow_extra_args(false);
}

void RunArguments::AddConnection(CLI::App& app, bool server_is_required) {
  server.AddTo(app, server_is_required);
  app.add_flag("--keep-session", keeps_session,
               "Keep the session on the server, so that evpose watch can read its poses")
      ->needs(app.get_option("--server"))
      ->group(kConnectionGroup);
  app.option_defaults()->group(kOutageGroup);
  AddOption(app, "--max-outage", max_outage_s,
            "Longest time without a response of --server, after which the command gives up; 0: no reconnection; inf: "
            "no limit",
            NotNegative())
      ->type_name("SECONDS")
      ->needs(app.get_option("--server"));
  AddOption(app, "--retain", retain_s,
            "Time for which events are kept after --server has stored them, so that they can be sent again if its "
            "store loses its last writes (a replica without them becomes the master); 0: none",
            NumberRange(0.0, 86400.0))
      ->type_name("SECONDS")
      ->needs(app.get_option("--server"));
  AddOption(app, "--retain-bytes", retain_bytes, "Limit of the events of --retain",
            NumberRange(uint64_t{1} << 20, uint64_t{1} << 40))
      ->type_name("BYTES")
      ->needs(app.get_option("--server"));
  AddOutputFile(
      app, "--resume", resume,
      "File with the position of the session, which is removed at the end. If it exists, the command continues from "
      "there: after a kill, run the same command again");
}

void RunArguments::AddResearch(CLI::App& app) {
  app.option_defaults()->group(kResearchGroup);
  app.add_option("--estimator", estimator,
                 "Estimator of the poses. mixture is the method of evpose; the others are a filter and corrected "
                 "versions of published estimators, for comparison. evpose bench tracking also has these as published")
      ->check(CheckIsOffered)
      ->check(CLI::IsMember(OfferedEstimators()))
      ->capture_default_str();
  app.add_option("--chunk-bytes", chunk_bytes,
                 "Size of a chunk of events, a multiple of 8. Default: 1 ms of sensor time or 256 KiB, whichever is "
                 "smaller")
      ->type_name("BYTES")
      ->check(NumberRange(size_t{8}, size_t{64} << 20))
      ->check([](const std::string& text) {
        size_t bytes = 0;
        return absl::SimpleAtoi(text, &bytes) && bytes % 8 == 0 ? "" : "must be a multiple of 8, the longest word";
      });
}

void RunArguments::AddTo(CLI::App& app, bool server_is_required, const std::string& epoch_default) {
  AddInputs(app);
  AddOutputs(app, epoch_default);
  AddTracking(app);
  AddConnection(app, server_is_required);
  AddResearch(app);
}

}  // namespace evpose::client
