// SPDX-License-Identifier: Apache-2.0

// evpose view: a page in the browser that shows a session or a recording.
#include <algorithm>
#include <chrono>
#include <filesystem>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/cli/commands/commands.h"
#include "client/cli/commands/page_arguments.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/recording_input.h"
#include "client/cli/common/run_inputs.h"
#include "client/cli/console/stop_on_interrupt.h"
#include "client/cli/console/wait_message.h"
#include "client/view/live_view.h"
#include "client/view/pending_source.h"
#include "client/view/recording_source.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"

namespace evpose::client {
namespace {

struct ViewArguments {
  std::string what;  // a recording or a session
  std::string poses;
  std::string truth;
  std::string model;
  std::vector<std::string> objects;
  std::string camera;
  ModelReadingArguments reading;
  PoseFrameArguments frame;
  ServerArguments server;
  PageArguments page;
};

// Time for which the command waits for the poses, the models and the camera of a recording. If reading them takes
// longer, the page is served before, with a notice of what is being read.
constexpr std::chrono::milliseconds kSoon(300);

// Waits until the command is interrupted. `check` is called repeatedly meanwhile.
void WaitForInterrupt(
    PageServer& server, const CliContext& context, const std::function<void()>& check = [] {}) {
  while (!context.IsInterrupted()) {
    check();
    SystemClock().SleepUntil(SystemClock().Now() + kInterruptPeriod, {});
  }
  server.End("evpose view was stopped");
}

absl::Status ViewServer(const ViewArguments& arguments, CliContext& context) {
  EVPOSE_RETURN_IF_ERROR(CheckHasPage());
  if (!arguments.what.empty() && !IsSessionName(arguments.what)) {
    return UsageError(absl::StrCat("\"", arguments.what,
                                   "\" is not a session: with --server, give sessions/ID, as "
                                   "`evpose sessions list` prints it, or nothing"));
  }
  EVPOSE_ASSIGN_OR_RETURN(const PoseFrame frame, arguments.frame.Read(context.err));
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<PageServer> server, arguments.page.Listen());
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  if (!arguments.what.empty()) {
    StopOnInterrupt interrupt(context);
    const absl::Status status = WaitFor(context, "the state of " + arguments.what, [&] {
      return client->GetSession(arguments.what, interrupt.stop().get_token()).status();
    });
    if (interrupt.stop().stop_requested()) return absl::OkStatus();
    EVPOSE_RETURN_IF_ERROR(SessionError(arguments.what, status));
  }
  LiveSource source(*client, arguments.server.address, arguments.what, frame);
  const std::unique_ptr<PageServer> ends_first = std::move(server);
  arguments.page.Serve(*ends_first, source, context.out, context.err);
  WaitForInterrupt(*ends_first, context);
  return absl::OkStatus();
}

using PosesByObject = std::map<std::string, RecordedPoses>;

// A file without poses is no error, but seldom intended.
void WarnWithoutPoses(const std::string& path, const PosesByObject& poses, std::ostream& err) {
  const auto is_empty = [](const auto& of_object) { return of_object.second.trajectory().empty(); };
  if (std::all_of(poses.begin(), poses.end(), is_empty)) {
    err << "evpose view: " << path << ": has no pose: the events are shown alone" << std::endl;
  }
}

// Returns a text if all events have been read and no pose is among them; empty otherwise.
std::string DescribeNoPoseInTime(const ViewArguments& arguments, const RecordingSource& source) {
  const RecordedEvents::Progress events = source.events().progress();
  const std::vector<int64_t>& poses_us = source.pose_times_us();
  if (!events.is_complete || !events.has_events || poses_us.empty()) return "";
  return DescribeNoCommonTime(arguments.poses, {poses_us.front(), poses_us.back()}, arguments.what, events.range);
}

absl::StatusOr<RecordingInputs> ReadViewInputs(const ViewArguments& arguments, const CliContext& context) {
  RecordingInputs inputs;
  inputs.path = arguments.what;
  EVPOSE_ASSIGN_OR_RETURN(const auto ids_and_models, ParseObjectModels(arguments.model, arguments.objects));
  EVPOSE_ASSIGN_OR_RETURN(inputs.camera, LoadCameraModel(arguments.camera));
  EVPOSE_ASSIGN_OR_RETURN(inputs.frame, arguments.frame.Read(context.err));
  std::vector<std::string> ids;
  for (const auto& [id, path] : ids_and_models) ids.push_back(id);
  // Reading a long file of poses takes about as long as reading a large model, so that both are read at the same time.
  std::future<absl::StatusOr<PosesByObject>> poses =
      std::async(std::launch::async, [&] { return ReadRecordedPoses(arguments.poses, ids, inputs.frame); });
  for (const auto& [id, path] : ids_and_models) {
    EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, arguments.reading.LoadSilently(path));
    inputs.objects.push_back({id, std::filesystem::path(path).filename().string(), std::move(model)});
  }
  if (!arguments.truth.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(inputs.truth, ReadRecordedPoses(arguments.truth, ids, inputs.frame));
  }
  EVPOSE_ASSIGN_OR_RETURN(inputs.poses, poses.get());
  EVPOSE_ASSIGN_OR_RETURN(
      inputs.reader, OpenSeenBy(inputs.camera, arguments.camera, arguments.what, {.stop = context.is_interrupted}));
  return inputs;
}

absl::Status ViewRecording(const ViewArguments& arguments, CliContext& context) {
  EVPOSE_RETURN_IF_ERROR(CheckHasPage());
  if (arguments.what.empty()) {
    return UsageError("give --server HOST:PORT, or a recording with --poses, --model and --camera");
  }
  // A recording may have such a path, too, and then has options of its own.
  if (IsSessionName(arguments.what) && arguments.poses.empty()) {
    return UsageError(absl::StrCat(arguments.what, " is a session: give --server HOST:PORT, too"));
  }
  for (const auto& [name, value] : {std::pair("--poses", arguments.poses), {"--camera", arguments.camera}}) {
    if (value.empty()) return UsageError(absl::StrCat("a recording is shown with its poses: give ", name, ", too"));
  }
  std::unique_ptr<RecordingSource> source;
  PendingSource pending({.is_recording = true, .source = arguments.what},
                        absl::StrCat("reading ", arguments.poses, ", the models and ", arguments.what));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<PageServer> server, arguments.page.Listen());  // ends first
  std::future<absl::Status> reading = std::async(std::launch::async, [&]() -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(RecordingInputs inputs, ReadViewInputs(arguments, context));
    EVPOSE_ASSIGN_OR_RETURN(source, RecordingSource::Open(std::move(inputs)));
    return absl::OkStatus();
  });
  const bool is_slow = reading.wait_for(kSoon) == std::future_status::timeout;
  if (is_slow) {
    arguments.page.Serve(*server, pending, context.out, context.err);
    const std::optional<WaitMessage> wait = WaitForRecording(context, arguments.what);
    reading.wait();
  }
  if (const absl::Status status = reading.get(); !status.ok()) {
    server->End(std::string(status.message()));
    return status;
  }
  WarnWithoutPoses(arguments.poses, source->inputs().poses, context.err);
  pending.Provide(*source);
  if (!is_slow) arguments.page.Serve(*server, pending, context.out, context.err);
  bool has_warned = false;
  WaitForInterrupt(*server, context, [&] {
    const std::string why = has_warned ? "" : DescribeNoPoseInTime(arguments, *source);
    if (!why.empty()) context.err << "evpose view: " << why << std::endl;
    has_warned = has_warned || !why.empty();
  });
  return absl::OkStatus();
}

}  // namespace

CommandRunner AddViewCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<ViewArguments>();
  app.option_defaults()->group(kInputGroup);
  app.add_option("recording", arguments->what,
                 absl::StrCat("Recording: ", kRecordingFormats,
                              ". With --server: the session, sessions/ID; without it, the page lists the sessions"))
      ->type_name("FILE|SESSION");
  AddFile(
      app, "--poses", arguments->poses,
      "Poses: .tum, .csv or .jsonl; the latter two have states and the causes of losses. {object} in the name stands "
      "for the ID of each object");
  AddFile(app, "--truth", arguments->truth, "True poses in the same formats, which are drawn beside the others");
  AddObjectModels(app, arguments->model, arguments->objects);
  AddFile(app, "--camera", arguments->camera, kCameraFiles);
  arguments->reading.AddTo(app);
  arguments->frame.AddTo(app, "shown");
  arguments->page.AddTo(app);
  arguments->server.AddTo(app, false);
  for (const char* const name :
       {"--poses", "--truth", "--model", "--object", "--camera", "--scale", "--crease-angle", "--surface"}) {
    app.get_option(name)->excludes(app.get_option("--server"));
  }
  app.footer(
      "Usage:\n  FILE --poses FILE --camera FILE (--model FILE | --object ID=FILE ...)\n  [SESSION] --server "
      "HOST:PORT\n\n"
      "Prints the address of a page that shows events, edges, poses and states, and serves it until an interrupt. The "
      "address has a key: everybody who has it can see the page. From another machine: ssh -L PORT:127.0.0.1:PORT "
      "HOST, "
      "with --port PORT. --open passes the address on the command line of the browser, which other users of this "
      "machine can see.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose view cube/recording.raw --poses cube/truth.tum --model cube/model.obj --camera cube/camera.yaml\n"
      "  evpose view --server 127.0.0.1:50051");
  return [arguments, &context] {
    const bool is_live = !arguments->server.address.empty();
    return is_live ? ViewServer(*arguments, context) : ViewRecording(*arguments, context);
  };
}

}  // namespace evpose::client
