// SPDX-License-Identifier: Apache-2.0

// evpose replay: sends a recording to a server and writes the poses.
#include <algorithm>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/cli/commands/commands.h"
#include "client/cli/commands/page_arguments.h"
#include "client/cli/common/run_inputs.h"
#include "client/cli/common/session_run.h"
#include "client/cli/common/session_start.h"
#include "client/lib/client_access.h"
#include "client/view/live_view.h"
#include "core/base/status_macros.h"
#include "server/rpc/server.h"

namespace evpose::client {
namespace {

struct ReplayArguments {
  RunArguments track;
  std::string rate = "max";
  std::string time_zero = "sensor";
  bool is_following = false;
  bool is_viewed = false;
};

// Parses "max" or a positive factor.
absl::StatusOr<double> ParseRate(const std::string& text) {
  if (text == "max") return 0.0;
  double rate = 0.0;
  if (absl::SimpleAtod(text, &rate) && rate > 0.0 && rate <= 1e6) return rate;
  return UsageError(
      absl::StrCat("--rate: \"", text, "\" is neither max nor a factor above 0, 1 being the sensor's pace"));
}

// The server of --server, or a server inside this process, and a client that is connected to it.
struct ServerHandle {
  std::unique_ptr<server::Server> own;
  std::unique_ptr<Client> client;
};

absl::StatusOr<ServerHandle> BeginSession(const RetryOptions& retry, SessionRun& run, const RunArguments& arguments,
                                          const CliContext& context) {
  ServerHandle handle;
  if (!arguments.server.address.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(handle.client, StartSession({.retry = retry}, run, arguments, context));
    return handle;
  }
  server::ServerOptions options;
  options.listen_address.clear();
  EVPOSE_ASSIGN_OR_RETURN(handle.own, server::Server::Start(options));
  handle.client = ClientAccess::OverChannel(handle.own->InProcessChannel(), "server in this process");
  const auto complete = [](SessionConfig&) {};
  EVPOSE_RETURN_IF_ERROR(run.Begin(*handle.client, complete, /*request_id=*/""));
  return handle;
}

absl::Status CheckResume(const RunArguments& arguments) {
  if (arguments.resume.empty()) return absl::OkStatus();
  if (arguments.server.address.empty()) {
    return UsageError("--resume: give --server, too: a server inside this process ends with it");
  }
  if (arguments.recording != "-") return absl::OkStatus();
  return UsageError("--resume: standard input cannot be read again; evpose stream stores the events that it has read");
}

absl::Status RunReplay(const ReplayArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const double rate, ParseRate(arguments.rate));
  EVPOSE_RETURN_IF_ERROR(CheckResume(arguments.track));
  const PageArguments page{.is_opened = true};
  std::unique_ptr<PageServer> pages;  // null without --view
  if (arguments.is_viewed) {
    EVPOSE_ASSIGN_OR_RETURN(pages, page.Listen());
  }
  TrackOptions options;
  options.clock = context.clock;
  const bool has_server = !arguments.track.server.address.empty();
  options.retry.max_outage = has_server ? absl::Seconds(arguments.track.max_outage_s) : absl::ZeroDuration();
  const auto stop_reading = [&context, stop = options.stop.get_token()] {
    return stop.stop_requested() || context.IsInterrupted();
  };
  EVPOSE_ASSIGN_OR_RETURN(
      RunInputs inputs,
      ReadRunInputs(context, arguments.track, {.is_following = arguments.is_following, .stop = stop_reading}));
  SessionRun run(arguments.track, inputs, context, {});
  EVPOSE_RETURN_IF_ERROR(run.Open());
  // With --resume, a read error leaves the session unchanged, so that the same command can continue it.
  EVPOSE_RETURN_IF_ERROR(run.MakeFeed({.outbox = {.retain = arguments.track.retain()},
                                       .rate = rate,
                                       .clock = context.clock,
                                       .skip = run.position().durable},
                                      /*ends_on_error=*/arguments.track.resume.empty()));
  EVPOSE_ASSIGN_OR_RETURN(const ServerHandle server, BeginSession(options.retry, run, arguments.track, context));
  if (pages == nullptr) return run.Track(*server.client, options);
  LiveSource source(*server.client, has_server ? arguments.track.server.address : "the server of evpose replay",
                    run.position().session, inputs.frame);
  page.Serve(*pages, source, context.err, context.err);
  const absl::Status status = run.Track(*server.client, options);
  pages->End("the replay has ended");
  pages.reset();  // destroyed before its source and the client
  return status;
}

}  // namespace

CommandRunner AddReplayCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<ReplayArguments>();
  arguments->track.AddTo(app, false, "that of the recording, if it had times since 1970, else 0");
  app.option_defaults()->group(kInputGroup);
  app.add_option("--rate", arguments->rate, "Pace of the events: max, or a multiple of real time")
      ->type_name("max|FACTOR")
      ->capture_default_str();
  app.add_flag("--follow", arguments->is_following, "Keep reading a RAW or DAT file as it grows, until an interrupt");
  AddOption(app, "--time-zero", arguments->time_zero,
            "Time 0 of the pose files: sensor, that of the camera's clock, as evpose info prints it; metavision, that "
            "from which Metavision counts: the first time word of a RAW file, or the time_shift of an HDF5 file",
            CLI::IsMember({"sensor", "metavision"}))
      ->group(kOutputGroup);
  app.add_flag("--view", arguments->is_viewed,
               "Show the replay on a page in the browser while it runs, as evpose view; use --rate 1 to watch it")
      ->group(kOutputGroup);
  app.footer(
      "Usage:\n  RECORDING --camera FILE (--model FILE | --object ID=FILE ...)\n\n"
      "Without --server, the command runs a server in its own process. Times are on the sensor's clock. No pose is "
      "written before the object is found, and none while it is lost; the report gives the reason. An AMBIGUOUS pose, "
      "the most likely of several, is in .csv and .jsonl files, with the others as alternatives, and in the states of "
      ".mcap files. In these files, lost_at_us and loss_cause are the latest loss before a pose.\n\n"
      "Among the equivalent poses of a symmetric object, the first one that is reported is the nearest to the identity "
      "rotation, and each later one is the nearest to its predecessor.\n\n"
      "After an interrupt or an error, the poses received so far are written; with --resume, the same command "
      "continues instead. A file without a pose does not replace an earlier file. A connection that breaks is "
      "established again within --max-outage. The poses of a "
      "run that was continued are byte for byte those of one that was not disturbed.\n\n"
      "Latencies are measured from the arrival of a chunk at the server to its pose: with --rate max behind a full "
      "queue, with --rate 1 as for a camera.\n\n"
      "Several objects: --object left=cube.obj --object right=book.obj --out poses-{object}.tum\n\n"
      "The last example resets the pose 0.25 s after the first event, whose time is 16 s.\n\n"
      "Exit status:\n"
      "  0  Poses of each object were found, in whatever state, also if an interrupt has ended --follow; a script that "
      "needs confirmed poses tests tracking_poses of --json\n"
      "  1  Failure, no pose of an object was found, or without --follow an interrupt before the end of the recording; "
      "the reason is on standard error\n"
      "  2  Wrong usage\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out cube/poses.tum\n"
      "  pose=$(awk '$1 >= 16.25 { print $2, $3, $4, $5, $6, $7, $8; exit }' cube/truth.tum)\n"
      "  evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out cube/poses.tum "
      "--reset-pose \"16250000 $pose\"");
  return [arguments, &context] {
    arguments->track.ends_at_interrupt = arguments->is_following;
    if (arguments->rate != "1") arguments->track.pace = "--rate " + arguments->rate;
    arguments->track.has_metavision_zero = arguments->time_zero == "metavision";
    return RunReplay(*arguments, context);
  };
}

}  // namespace evpose::client
