// SPDX-License-Identifier: Apache-2.0

// evpose stream: sends the events of a camera to a server as they arrive, and writes the poses.
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <memory>
#include <string>
#include <utility>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/str_cat.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/run_inputs.h"
#include "client/cli/common/session_run.h"
#include "client/cli/common/session_start.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"

namespace evpose::client {
namespace {

struct StreamArguments {
  RunArguments track;
  std::string overload = "block";
  double max_lag_s = 0.0;
  std::string spool;
  uint64_t memory_bytes = OutboxOptions().memory_bytes;
  uint64_t spool_bytes = SpoolOptions().max_bytes;

  bool is_pipe() const { return track.recording == "-"; }
};

std::string SpoolDirectory(const StreamArguments& arguments) {
  if (!arguments.spool.empty()) return arguments.spool;
  if (!arguments.track.resume.empty()) return arguments.track.resume + ".spool";
  const char* const temporary = std::getenv("TMPDIR");
  return temporary != nullptr ? temporary : "/tmp";
}

// Standard input is also read during outages; a file is read only while the server is reachable.
FeedOptions MakeFeedOptions(const StreamArguments& arguments, const SessionRun& run) {
  FeedOptions options;
  options.outbox.memory_bytes = arguments.memory_bytes;
  options.outbox.retain = arguments.track.retain();
  if (!arguments.is_pipe()) {
    options.skip = run.position().durable;
    return options;
  }
  options.is_live = true;
  options.read_ahead_bytes = std::numeric_limits<uint64_t>::max();
  options.outbox.spool = {.directory = SpoolDirectory(arguments),
                          .max_bytes = arguments.spool_bytes,
                          .outlives_process = !arguments.track.resume.empty()};
  options.begins_after_gap = run.is_resumed();
  return options;
}

// Checks that the spool and the file of --resume belong to the same session.
absl::Status CheckSpool(const StreamArguments& arguments, SessionRun& run) {
  if (!arguments.is_pipe() || arguments.track.resume.empty()) return absl::OkStatus();
  const OutboxState state = run.feed().outbox().state();
  const std::string directory = SpoolDirectory(arguments);
  // A spool that contains all chunks from the first one on can be sent to a new session.
  if (!run.is_resumed() && state.first_seq > 1) {
    return absl::FailedPreconditionError(absl::StrCat(directory, ": has chunks of a session that ",
                                                      arguments.track.resume,
                                                      " does not describe; remove it to begin a new session"));
  }
  if (state.last.seq >= run.position().durable.seq) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(directory, ": does not have the chunks of the session in ",
                                          arguments.track.resume, "; remove that to begin a new session"));
}

absl::Status RunStream(const StreamArguments& arguments, CliContext& context) {
  if (arguments.max_lag_s > 0.0 && arguments.overload != "latest") {
    return UsageError("--max-lag: is for --overload latest; with block nothing is skipped");
  }
  TrackOptions options;
  options.clock = context.clock;
  options.retry.max_outage = absl::Seconds(arguments.track.max_outage_s);
  const auto stop_reading = [&context, stop = options.stop.get_token()] {
    return stop.stop_requested() || context.IsInterrupted();
  };
  EVPOSE_ASSIGN_OR_RETURN(RunInputs inputs,
                          ReadRunInputs(context, arguments.track, {.is_following = true, .stop = stop_reading}));
  SessionRun run(arguments.track, inputs, context,
                 {{"--overload", arguments.overload}, {"--max-lag", absl::StrCat(arguments.max_lag_s)}});
  // Stops a source that waits for standard input.
  const absl::Cleanup stop_at_end = [&options] { options.stop.request_stop(); };
  EVPOSE_RETURN_IF_ERROR(run.Open());
  EVPOSE_RETURN_IF_ERROR(run.MakeFeed(MakeFeedOptions(arguments, run), true));
  EVPOSE_RETURN_IF_ERROR(CheckSpool(arguments, run));
  // The data of a camera must be read before a server is reachable.
  if (arguments.is_pipe()) run.feed().Start(MakeChunkerOptions(arguments.track).max_bytes);

  const auto complete = [&arguments](SessionConfig& config) {
    if (arguments.overload == "latest") config.overload_policy = OverloadPolicy::kLatest;
    if (arguments.max_lag_s > 0.0) config.max_lag = absl::Seconds(arguments.max_lag_s);
  };
  const SessionStartOptions begin = {options.retry, /*continues_session=*/run.is_resumed(), complete};
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, StartSession(begin, run, arguments.track, context));
  EVPOSE_RETURN_IF_ERROR(run.Track(*client, options));
  std::error_code error;
  // The spool has created the directory, which is empty now.
  if (arguments.is_pipe() && !arguments.track.resume.empty()) std::filesystem::remove(SpoolDirectory(arguments), error);
  return absl::OkStatus();
}

void AddSpoolOptions(CLI::App& app, StreamArguments& arguments) {
  app.option_defaults()->group(kOutageGroup);
  AddOption(app, "--memory-bytes", arguments.memory_bytes, "Limit of the data of standard input that is kept in memory",
            NumberRange(uint64_t{1} << 20, uint64_t{1} << 40))
      ->type_name("BYTES");
  app.add_option("--spool", arguments.spool,
                 "Directory for the data of standard input beyond --memory-bytes; with --resume, for all data that the "
                 "server has not made durable. Default: FILE.spool of --resume, otherwise $TMPDIR or /tmp")
      ->type_name("DIR");
  AddOption(app, "--spool-bytes", arguments.spool_bytes,
            "Limit of the data in --spool; beyond it, standard input is not read",
            NumberRange(uint64_t{16} << 20, uint64_t{1} << 50))
      ->type_name("BYTES");
}

}  // namespace

CommandRunner AddStreamCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<StreamArguments>();
  arguments->track.max_outage_s = std::numeric_limits<double>::infinity();
  arguments->track.is_live = true;
  arguments->track.ends_at_interrupt = true;
  arguments->track.AddTo(app, true, "host");
  app.option_defaults()->group(kTrackingGroup);
  AddOption(app, "--overload", arguments->overload,
            "What happens when the server cannot keep up. block: standard input is read more slowly, and no event is "
            "skipped; latest: old events are skipped and counted",
            CLI::IsMember({"block", "latest"}));
  app.add_option("--max-lag", arguments->max_lag_s,
                 "Age at which --overload latest skips events. Default: chosen by the server")
      ->type_name("SECONDS")
      ->check(AboveZero());
  AddSpoolOptions(app, *arguments);
  app.footer(
      "Usage:\n  RECORDING --camera FILE (--model FILE | --object ID=FILE ...) --server HOST:PORT\n\n"
      "Reads a RAW or DAT stream from standard input (-) until it ends, or such a file that still grows, until an "
      "interrupt (SIGINT, SIGTERM, SIGHUP); then all data that was read is tracked.\n\n"
      "If no server can be reached within --connect-timeout at the start, the command fails. Later, and with a session "
      "that --resume continues, --max-outage is the limit.\n\n"
      "While the server cannot be reached, standard input is read and stored, and a file is read later. If that lasts "
      "more than two seconds, an interrupt ends the wait; a second interrupt ends the program at once. After an error, "
      "the poses received so far are written; with --resume, the same command continues the session instead, and for "
      "standard input it marks the gap in the events.\n\n"
      "Exit status:\n"
      "  0  Poses of each object were found, in whatever state, also if an interrupt has ended the stream; a script "
      "that needs confirmed poses tests tracking_poses of --json\n"
      "  1  Failure, or no pose of an object was found; the reason is on standard error\n"
      "  2  Wrong usage\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  cat cube/recording.raw | evpose stream - --model cube/model.obj --camera cube/camera.yaml "
      "--server 127.0.0.1:50051 --out cube/poses.tum");
  return [arguments, &context] { return RunStream(*arguments, context); };
}

}  // namespace evpose::client
