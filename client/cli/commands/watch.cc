// SPDX-License-Identifier: Apache-2.0

// evpose watch: the poses or the health of a session as they arrive.
#include <algorithm>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/pace_meter.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/console/stop_on_interrupt.h"
#include "client/cli/console/wait_message.h"
#include "client/mcap/session_observer.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"

namespace evpose::client {
namespace {

constexpr absl::Duration kHealthPeriod = absl::Seconds(1);  // between two lines that a person reads

struct WatchArguments {
  std::string session;
  ServerArguments server;
  WatchPosesOptions poses;
  bool is_health = false;
  double period_s = 1.0;
  bool is_json = false;
  std::string out;  // empty: standard output
  RecordingArguments recording;
  PoseFrameArguments frame;
};

// Prints the states of the objects on standard error when they change, with the reason for a missing pose; and, once
// for each pause of at least `notice_delay` without poses, a line that it is waiting. Thread-safe.
class StateLines {
 public:
  StateLines(std::ostream& err, const std::string& session, absl::Duration notice_delay)
      : err_(err),
        notice_delay_(notice_delay),
        thread_([this, session](std::stop_token stop) { Wait(session, stop); }) {}

  void PosesArrived() {
    const std::lock_guard lock(mutex_);
    poses_at_ = SystemClock().Now();
    is_waiting_ = false;
  }
  void Show(const SessionHealth& health) {
    const std::lock_guard lock(mutex_);
    for (const ObjectHealth& object : health.objects) {
      std::string& shown = shown_[object.object_id];
      const std::string text = DescribeState(object);
      if (text == shown) continue;
      shown = text;
      err_ << object.object_id << ": " << text << (object.detail.empty() ? "" : ": ") << object.detail << std::endl;
    }
  }
  // "; cube: LOST", for each object.
  std::string Shown() {
    const std::lock_guard lock(mutex_);
    std::string text;
    for (const auto& [object_id, state] : shown_) absl::StrAppend(&text, "; ", object_id, ": ", state);
    return text;
  }
  void Skipped(uint64_t num_skipped) {
    const std::lock_guard lock(mutex_);
    err_ << "skipped " << num_skipped << " poses: too slow, or no longer stored" << std::endl;
  }
  void RolledBack(uint64_t last_pose_seq) {
    const std::lock_guard lock(mutex_);
    err_ << "the session continues after pose " << last_pose_seq
         << ": its server or its store has lost the later ones, which are computed again" << std::endl;
  }
  void Print(const std::string& text) {
    const std::lock_guard lock(mutex_);
    err_ << text << std::endl;
  }

 private:
  void Wait(const std::string& session, const std::stop_token& stop) {
    absl::Time due = SystemClock().Now() + notice_delay_;
    while (SystemClock().SleepUntil(due, stop)) {
      const std::lock_guard lock(mutex_);
      due = poses_at_ + notice_delay_;
      const absl::Time now = SystemClock().Now();
      if (due > now) continue;
      due = now + notice_delay_;
      if (!is_waiting_) err_ << "waiting for poses of " << session << " ..." << std::endl;
      is_waiting_ = true;
    }
  }

  std::mutex mutex_;
  std::ostream& err_;
  const absl::Duration notice_delay_;
  absl::Time poses_at_ = absl::InfinitePast();
  bool is_waiting_ = false;
  std::map<std::string, std::string> shown_;
  std::jthread thread_;
};

// Time without poses after which the command says that it waits for them. Poses of a limited rate come seldom.
absl::Duration NoticeDelay(const WatchArguments& arguments) {
  const std::optional<double> rate_hz = arguments.poses.max_rate_hz;
  return absl::Seconds(std::max(1.0, rate_hz ? 2.0 / *rate_hz : 0.0));
}

Json HealthJson(const SessionHealth& health) {
  Json json = {{"t_us", health.t_us},
               {"received_bytes", health.received_bytes},
               {"processed_bytes", health.processed_bytes},
               {"decoded_events", health.decoded_events},
               {"dropped_events", health.dropped_events},
               {"invalid_words", health.invalid_words},
               {"time_backsteps", health.time_backsteps},
               {"skipped_events", health.skipped_events},
               {"skipped_us", health.skipped_us},
               {"poses", health.poses},
               {"event_rate_hz", health.event_rate_hz},
               {"pose_rate_hz", health.pose_rate_hz},
               {"real_time_ratio", health.real_time_ratio},
               {"processing", ProcessingJson(health.processing)},
               {"latency_p50_ms", MillisecondsJson(health.latency_p50)},
               {"latency_p99_ms", MillisecondsJson(health.latency_p99)},
               {"objects", Json::array()}};
  for (const ObjectHealth& object : health.objects) json["objects"].push_back(ObjectJson(object));
  return json;
}

std::string HealthLine(const SessionHealth& health, const std::string& pace) {
  std::string line = absl::StrFormat("%.6f s  %.2f Mev/s  %.0f poses/s", 1e-6 * health.t_us,
                                     1e-6 * health.event_rate_hz, health.pose_rate_hz);
  if (!pace.empty()) absl::StrAppend(&line, "  ", pace);
  if (health.latency_p99) {
    absl::StrAppendFormat(&line, "  latency p99 %.1f ms", absl::ToDoubleMilliseconds(*health.latency_p99));
  }
  absl::StrAppend(&line, "  ", DescribeProcessing(health.processing));
  for (const ObjectHealth& object : health.objects) {
    absl::StrAppend(&line, "  ", object.object_id, " ", DescribeState(object), ", ", object.losses, " losses");
  }
  return line;
}

absl::Status RunWatchHealth(const WatchArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  StopOnInterrupt interrupt(context);
  std::stop_source& stop = interrupt.stop();
  PaceMeter pace;
  std::optional<WaitMessage> wait(std::in_place, context, "the health of " + arguments.session);
  const auto on_health = [&](const SessionHealth& health) {
    wait.reset();
    const std::string json = HealthJson(health).dump(-1, ' ', false, Json::error_handler_t::replace);
    context.out << (arguments.is_json ? json : HealthLine(health, pace.Update(health))) << std::endl;
    if (!context.out) stop.request_stop();  // the output is closed
  };
  const absl::Status status =
      client->WatchHealth(arguments.session, absl::Seconds(arguments.period_s), on_health, stop.get_token());
  return stop.stop_requested() ? absl::OkStatus() : SessionError(arguments.session, status);
}

// Writes poses to --out, or prints them.
class PoseOutput {
 public:
  // Error: INVALID_ARGUMENT (usage) for an invalid --out; those of PoseFiles.
  static absl::StatusOr<PoseOutput> Open(const WatchArguments& arguments, const PoseFrame& frame,
                                         const Session& session, CliContext& context) {
    PoseOutput output(context);
    output.frame_ = frame;
    output.format_ = arguments.is_json ? PoseFormat::kJsonLines : PoseFormat::kTum;
    if (arguments.out.empty()) {
      context.out << PoseHeader(output.format_, output.frame_);
      return output;
    }
    std::vector<std::string> ids;
    for (const TrackedObject& object : session.config.objects) ids.push_back(object.object_id);
    EVPOSE_RETURN_IF_ERROR(AsUsageError(PoseFiles::Check(arguments.out, ids), "--out "));
    EVPOSE_ASSIGN_OR_RETURN(output.files_, PoseFiles::Open(arguments.out, ids,
                                                           {.frame = output.frame_,
                                                            .epoch_ns = arguments.recording.EpochNs(std::nullopt)}));
    return output;
  }

  // False: standard output is closed.
  bool Write(const std::vector<Pose>& poses) {
    for (const Pose& pose : poses) {
      if (files_) {
        files_->Write(pose);
      } else {
        const std::string line = PoseLine(format_, pose, frame_);
        has_printed_ = has_printed_ || !line.empty();
        context_->out << line;
      }
    }
    context_->out.flush();
    return static_cast<bool>(context_->out);
  }
  // NOT_FOUND if no pose was written.
  absl::Status CheckNotEmpty(const std::string& session) const {
    if (!files_) {
      if (has_printed_) return absl::OkStatus();
      return absl::NotFoundError(
          absl::StrCat(session, ": every pose is AMBIGUOUS, and TUM has none of them: use --json"));
    }
    for (const auto& [id, num_poses] : files_->num_poses()) {
      if (num_poses > 0) return absl::OkStatus();
    }
    return absl::NotFoundError(absl::StrCat(session, ": ", kOnlyAmbiguousPoses));
  }
  std::vector<PoseRecorder*> recorders() const { return files_ ? files_->recorders() : std::vector<PoseRecorder*>(); }
  absl::Status Commit() {
    if (!files_) return absl::OkStatus();
    EVPOSE_RETURN_IF_ERROR(files_->Commit());
    for (const PoseFile& file : files_->files()) {
      if (file.keeps_older) context_->err << file.Describe() << std::endl;
    }
    return absl::OkStatus();
  }

 private:
  explicit PoseOutput(CliContext& context) : context_(&context) {}

  CliContext* context_;
  PoseFormat format_ = PoseFormat::kTum;
  PoseFrame frame_;
  std::optional<PoseFiles> files_;
  bool has_printed_ = false;  // a pose, on standard output
};

absl::Status RunWatch(const WatchArguments& arguments, CliContext& context) {
  EVPOSE_RETURN_IF_ERROR(arguments.recording.Check(arguments.out));
  if (!arguments.out.empty()) {
    EVPOSE_RETURN_IF_ERROR(AsUsageError(PoseFormatFromPath(arguments.out).status(), "--out "));
  }
  EVPOSE_ASSIGN_OR_RETURN(const PoseFrame frame, arguments.frame.Read(context.err));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  StopOnInterrupt interrupt(context);
  std::stop_source& stop = interrupt.stop();
  const absl::StatusOr<Session> session = WaitFor(context, "the state of " + arguments.session, [&] {
    return client->GetSession(arguments.session, stop.get_token());
  });
  if (stop.stop_requested()) return absl::OkStatus();
  if (!session.ok()) return SessionError(arguments.session, session.status());
  EVPOSE_ASSIGN_OR_RETURN(PoseOutput output, PoseOutput::Open(arguments, frame, *session, context));
  StateLines states(context.err, arguments.session, NoticeDelay(arguments));
  bool has_poses = false;
  const auto on_poses = [&](const std::vector<Pose>& poses, uint64_t num_skipped) {
    states.PosesArrived();
    has_poses = has_poses || !poses.empty();
    if (num_skipped > 0) states.Skipped(num_skipped);
    if (!output.Write(poses)) stop.request_stop();
  };
  states.Show(session->health);
  SessionObserverOptions recording = {
      .camera = session->config.camera, .event_cell_px = arguments.recording.event_cell_px, .records_states = true};
  recording.print = [&states](const std::string& text) { states.Print(text); };
  SessionObserver observer(*client, arguments.session, output.recorders(), recording);
  std::jthread shows_states([&] {
    const auto show = [&states](const SessionHealth& health) { states.Show(health); };
    // The stream of poses ends with the same error, and reports it.
    client->WatchHealth(arguments.session, kHealthPeriod, show, stop.get_token()).IgnoreError();
  });
  WatchPosesOptions options = arguments.poses;
  options.on_rolled_back = [&states](uint64_t last_pose_seq) { states.RolledBack(last_pose_seq); };
  absl::Status status = client->WatchPoses(arguments.session, options, on_poses, stop.get_token());
  const bool was_stopped = stop.stop_requested();
  if (!status.ok()) stop.request_stop();
  shows_states.join();  // prints the last states of a session that has ended
  if (was_stopped) {
    status = absl::OkStatus();
  } else if (status.ok()) {
    observer.Finish();
    if (!has_poses) {
      status = absl::NotFoundError(absl::StrCat(arguments.session, ": the session has ended without a ",
                                                options.after_pose_seq > 0 ? "later pose" : "pose", states.Shown()));
    } else {
      status = output.CheckNotEmpty(arguments.session);
    }
  }
  observer.Stop();
  const absl::Status written = output.Commit();
  return status.ok() ? written : status;
}

}  // namespace

CommandRunner AddWatchCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<WatchArguments>();
  AddSessionName(app, arguments->session);
  app.option_defaults()->group(kOutputGroup);
  CLI::Option* const after =
      app.add_option("--after", arguments->poses.after_pose_seq, "Number of the pose after which the output begins")
          ->check(WholeNumber())
          ->capture_default_str();
  CLI::Option* const max_rate =
      app.add_option("--max-rate-hz", arguments->poses.max_rate_hz,
                     "Limit of the poses per second of sensor time, for each object. Default: all poses")
          ->type_name("HZ")
          ->check(AboveZero());
  CLI::Option* const health =
      app.add_flag("--health", arguments->is_health, "Print the health of the session instead of its poses")
          ->excludes(after)
          ->excludes(max_rate);
  AddOption(app, "--period", arguments->period_s, "Time between two lines of --health", NumberRange(0.01, 86400.0))
      ->type_name("SECONDS")
      ->needs(health);
  CLI::Option* const out =
      AddOutputFile(app, "-o,--out", arguments->out,
                    absl::StrCat("Poses, in a file instead of on standard output: ", kPoseFormats,
                                 ". It appears at the end. {object} in the name stands for the ID of each object"))
          ->excludes(health);
  arguments->recording.AddTo(app, "host");
  arguments->frame.AddTo(app);
  AddJson(app, arguments->is_json, "Print one JSON object on each line")->excludes(out);
  arguments->server.AddTo(app, true);
  app.footer(
      "Prints the stored poses (TUM) and then the live ones, until the session ends or until an interrupt. Changes of "
      "the objects' states are printed on standard error. With --health, prints a line at once and after each period: "
      "sensor time, rates, latency and the states of the objects. \"can track 5.8 x real time\" is what the server "
      "could "
      "do with events that arrive faster; below 1 it falls behind the sensor. With --json, real_time_ratio is the "
      "inverse of this, from the first event on: the processing time of a second of events.\n\n"
      "Exit status:\n"
      "  0  Poses were printed, or an interrupt has ended the command\n"
      "  1  Failure, or the session has ended without a pose, or, for TUM, with AMBIGUOUS poses only; the reason is on "
      "standard error\n"
      "  2  Wrong usage\n\n"
      "Example:\n"
      "  session=$(evpose sessions list --server 127.0.0.1:50051 | sed 's/ .*//;q')\n"
      "  evpose watch \"$session\" --server 127.0.0.1:50051 --max-rate-hz 10\n"
      "  evpose watch \"$session\" --server 127.0.0.1:50051 --health");
  return [arguments, &context] {
    return arguments->is_health ? RunWatchHealth(*arguments, context) : RunWatch(*arguments, context);
  };
}

}  // namespace evpose::client
