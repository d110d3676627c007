// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/session_run.h"

#include <algorithm>
#include <filesystem>
#include <stop_token>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/console/lag_messages.h"
#include "client/cli/console/wait_message.h"
#include "client/lib/client_access.h"
#include "client/lib/messages/core_types.h"
#include "client/lib/messages/status_details.h"
#include "core/base/byte_order.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"
#include "evpose/v1/error_reason.pb.h"

namespace evpose::client {
namespace {

// Limits of the poses and the time that a killed client repeats: the server stores only some thousand poses.
constexpr uint64_t kMaxPosesBetween = 1024;
constexpr absl::Duration kMaxTimeBetween = absl::Seconds(1);

// The sizes of pose files are kept under the IDs of their objects, in which PoseFiles::Check() refuses a slash.
constexpr char kClockLogKey[] = "/--clock-log";

std::string Digest(const std::string& bytes) { return Sha256Hex(AsBytes(bytes)).substr(0, 32); }

// Returns the inputs and options that must be the same when a run is continued, by the names used in errors.
std::map<std::string, std::string> Identify(const RunArguments& arguments, const RunInputs& inputs) {
  std::map<std::string, std::string> identity;
  std::error_code error;
  const auto absolute = [&error](const std::string& path) {
    if (path == "-" || path.empty()) return path;
    // Absolute first, because weakly_canonical() leaves the relative path of a missing file relative.
    return std::filesystem::weakly_canonical(std::filesystem::absolute(path, error), error).string();
  };
  identity["recording"] = absolute(arguments.recording);
  identity["header of the recording"] =
      absl::StrCat(std::string(EncodingName(inputs.reader->header().encoding)), " ",
                   inputs.reader->header().geometry.width_px, "x", inputs.reader->header().geometry.height_px);
  identity["--time-zero"] = arguments.has_metavision_zero ? "metavision" : "sensor";
  identity["--out"] = absolute(arguments.out);
  identity["--epoch"] = arguments.recording_options.epoch;
  identity["--clock-log"] = absolute(arguments.clock_log);
  identity["--pose-rate"] = absl::StrCat(arguments.pose_rate_hz);
  identity["--estimator"] = arguments.estimator;
  identity["--scale"] = absl::StrCat(arguments.reading.metres_per_unit);
  identity["--crease-angle"] = absl::StrCat(arguments.reading.crease_angle_deg);
  identity["--surface"] = arguments.reading.surface;
  identity["--chunk-bytes"] = absl::StrCat(arguments.chunk_bytes);
  identity["--init-pose"] = "";
  for (const std::string& pose : arguments.init_poses) absl::StrAppend(&identity["--init-pose"], pose, ";");
  identity["--reset-pose"] = absl::StrJoin(arguments.reset_poses, ";");
  for (const InputObject& object : inputs.objects) identity["model of " + object.id] = Digest(object.model.bytes);
  identity["--camera"] = absolute(arguments.camera);
  identity["--world-from-camera and --pose"] = Digest(inputs.frame.Description());
  identity["--sensor"] = absolute(arguments.sensor);
  return identity;
}

std::string DescribeLag(const LagChange& change) {
  if (!change.falls_behind) return "the server processes the events in real time again";
  return absl::StrFormat(
      "the server processes the events more slowly than real time: the oldest have waited for %.1f s; for a live "
      "camera, use a less busy server or a model with fewer lines. If the session or its tenant is at a limit of "
      "processor time, which evpose sessions get shows, the operator can raise --max-session-cpu or --tenant-max-cpu",
      absl::ToDoubleSeconds(change.lag));
}

// Requests `stop` if an interrupt has occurred and `is_away` remains set for kGrace after it: the work in progress
// cannot be finished while the server is unreachable. After a shorter outage it is finished normally. The arguments
// must outlive the object.
class InterruptWatch {
 public:
  InterruptWatch(const CliContext& context, const std::atomic<bool>& is_away, std::stop_source stop)
      : thread_([&context, &is_away, stop = std::move(stop)](std::stop_token ended) mutable {
          for (absl::Duration waited; waited < kGrace; waited += kInterruptPeriod) {
            if (!is_away || !context.IsInterrupted()) waited = absl::ZeroDuration();
            if (!SystemClock().SleepUntil(SystemClock().Now() + kInterruptPeriod, ended)) return;
          }
          stop.request_stop();
        }) {}

 private:
  static constexpr absl::Duration kGrace = absl::Seconds(2);  // also in the help of evpose stream

  std::jthread thread_;
};

}  // namespace

// Reports the lag of the events, in a thread of its own, while it exists.
class SessionRun::LagWatch {
 public:
  explicit LagWatch(SessionRun& run) : run_(run), thread_([this](std::stop_token ended) { Watch(ended); }) {}
  ~LagWatch() {
    thread_ = {};
    Report(/*is_over=*/true);
    run_.report_.longest_lag = messages_.longest();
    run_.report_.pace = run_.arguments_.pace;
  }
  LagWatch(const LagWatch&) = delete;
  LagWatch& operator=(const LagWatch&) = delete;

 private:
  // A quarter of the lag from which on a run counts as late (LagMessages::kLate).
  static constexpr absl::Duration kPeriod = absl::Milliseconds(250);
  // Time at the start in which no lag is reported: a live source has waited for the session, and the object is searched
  // for.
  static constexpr absl::Duration kStart = absl::Seconds(2);

  void Watch(const std::stop_token& ended) {
    const absl::Time begin = SystemClock().Now();
    while (SystemClock().SleepUntil(SystemClock().Now() + kPeriod, ended)) {
      if (SystemClock().Now() - begin > kStart) Report(/*is_over=*/false);
    }
  }
  // With `is_over`, the run has ended, and its result is reported instead of a lag that remains.
  void Report(bool is_over) {
    const bool is_explained = is_over || run_.is_away_ || run_.server_falls_behind_;
    run_.PrintLine(messages_.Update(run_.feed_->Lag(run_.processed_seq_), is_explained));
  }

  SessionRun& run_;
  LagMessages messages_{run_.arguments_.pace};
  std::jthread thread_;
};

SessionRun::SessionRun(const RunArguments& arguments, RunInputs& inputs, CliContext& context,
                       std::map<std::string, std::string> own_arguments)
    : arguments_(arguments),
      inputs_(inputs),
      context_(context),
      chunker_(*inputs.reader, MakeChunkerOptions(arguments)) {
  record_.arguments = std::move(own_arguments);
  record_.arguments.merge(Identify(arguments, inputs));
}

SessionRun::~SessionRun() {
  observer_.reset();
  if (progress_ != nullptr) progress_->Stop();
}

absl::Status SessionRun::Open() {
  if (!arguments_.resume.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(ResumeFile file, ResumeFile::Open(arguments_.resume));
    if (file.record()) {
      EVPOSE_RETURN_IF_ERROR(file.CheckArguments(record_.arguments));
      record_ = *file.record();
    }
    resume_.emplace(std::move(file));
  }
  kept_pose_seq_ = record_.position.last_pose_seq;
  EVPOSE_RETURN_IF_ERROR(OpenClockLog());
  return arguments_.out.empty() ? absl::OkStatus() : OpenPoses();
}

absl::Status SessionRun::OpenPoses() {
  std::optional<int64_t> epoch_ns;  // absent for live events: the time at which they arrive counts
  // Saturates: a recording may state any number.
  if (!arguments_.is_live)
    epoch_ns = absl::ToInt64Nanoseconds(absl::Microseconds(inputs_.reader->header().time_offset_us));
  EVPOSE_ASSIGN_OR_RETURN(poses_, PoseFiles::Open(arguments_.out, inputs_.object_ids(),
                                                  {.frame = inputs_.frame,
                                                   .epoch_ns = arguments_.recording_options.EpochNs(epoch_ns),
                                                   .kept_bytes = resume_ ? &record_.output_bytes : nullptr,
                                                   .kept_poses = record_.output_poses}));
  return absl::OkStatus();
}

absl::Status SessionRun::OpenClockLog() {
  if (arguments_.clock_log.empty()) return absl::OkStatus();
  std::optional<uint64_t> kept_bytes;
  if (resume_) kept_bytes = record_.output_bytes[kClockLogKey];
  EVPOSE_ASSIGN_OR_RETURN(clock_log_, ClockLog::Open(arguments_.clock_log, kept_bytes));
  return absl::OkStatus();
}

absl::Status SessionRun::SyncOutputs() {
  if (poses_) {
    EVPOSE_ASSIGN_OR_RETURN(record_.output_bytes, poses_->Sync());
    record_.output_poses = poses_->num_poses();
  }
  if (clock_log_ == nullptr) return absl::OkStatus();
  EVPOSE_ASSIGN_OR_RETURN(record_.output_bytes[kClockLogKey], clock_log_->Sync());
  return absl::OkStatus();
}

absl::Status SessionRun::CommitOutputs() {
  // The poses first: an error of the log does not lose them.
  if (poses_) {
    EVPOSE_RETURN_IF_ERROR(poses_->Commit());
    report_.files = poses_->files();
  }
  return clock_log_ != nullptr ? clock_log_->Commit() : absl::OkStatus();
}

absl::StatusOr<EventChunk> SessionRun::NextChunk() {
  absl::StatusOr<EventChunk> chunk = FromCore(chunker_.Next());
  if (clock_log_ != nullptr && chunk.ok() && !chunk->bytes.empty()) clock_log_->AddChunk(chunk->t_last_us);
  if (chunk.ok()) AddDueResets(inputs_.resets, *chunk);
  if (chunk.ok() || !ends_on_error_) return chunk;
  source_status_ = chunk.status();
  return EventChunk{};
}

absl::Status SessionRun::MakeFeed(const FeedOptions& options, bool ends_on_error) {
  ends_on_error_ = ends_on_error;
  EVPOSE_ASSIGN_OR_RETURN(feed_, EventFeed::Open([this] { return NextChunk(); }, options));
  return absl::OkStatus();
}

absl::Status SessionRun::Begin(Client& client, const std::function<void(SessionConfig&)>& complete,
                               const std::string& request_id) {
  // Also for a continued run: models are named by their content, and the report describes them.
  EVPOSE_ASSIGN_OR_RETURN(SessionConfig config, UploadModels(context_, client, arguments_, inputs_, report_));
  if (is_resumed()) return absl::OkStatus();
  complete(config);
  EVPOSE_ASSIGN_OR_RETURN(const Session session,
                          CreateSession(context_, client, config, arguments_, inputs_, request_id));
  record_.position.session = session.name;
  record_.position.resume_token = session.resume_token;
  return absl::OkStatus();
}

absl::Status SessionRun::KeepPosition(const TrackPosition& position, bool has_new_token) {
  if (!resume_) return absl::OkStatus();
  const absl::Time now = SystemClock().Now();
  // The first durable position is stored at once, because its digest identifies the recording.
  const bool is_first = record_.position.durable.seq == 0 && position.durable.seq > 0;
  const bool is_due = has_new_token || is_first || now - kept_at_ >= kMaxTimeBetween ||
                      position.last_pose_seq - kept_pose_seq_ >= kMaxPosesBetween;
  if (!is_due) return absl::OkStatus();
  // The outputs are synced first, so that the record is never ahead of them.
  EVPOSE_RETURN_IF_ERROR(SyncOutputs());
  record_.position = position;
  record_.position.max_piece_bytes = feed_->max_piece_bytes();
  EVPOSE_RETURN_IF_ERROR(resume_->Write(record_));
  kept_pose_seq_ = position.last_pose_seq;
  kept_at_ = now;
  return absl::OkStatus();
}

void SessionRun::PrintLine(const std::string& text) {
  if (text.empty()) return;
  if (progress_ != nullptr) {
    progress_->PrintLine(text);
  } else {
    context_.err << text << std::endl;
  }
}

void SessionRun::WritePose(const Pose& pose) {
  Pose written = pose;
  written.t_us -= TimeZeroUs();
  if (written.latest_loss) written.latest_loss->t_us -= TimeZeroUs();
  poses_->Write(written);
}

void SessionRun::WriteState(const StateChange& change) {
  const int64_t t_us = change.t_us - TimeZeroUs();
  for (PoseRecorder* const recorder : poses_->recorders()) {
    recorder->AddState(change.object_id, t_us, change.state);
  }
}

TrackCallbacks SessionRun::MakeCallbacks() {
  TrackCallbacks callbacks;
  callbacks.on_pose = [this](const Pose& pose) {
    if (poses_) WritePose(pose);
    if (clock_log_ != nullptr) clock_log_->AddPose(pose.t_us);
    report_.Add(pose);
    has_received_pose_ = true;
  };
  callbacks.on_notice = [this](const Notice& notice) {
    report_.Add(notice);
    const auto* triggers = std::get_if<Triggers>(&notice);
    if (triggers != nullptr && clock_log_ != nullptr) clock_log_->AddTriggers(*triggers);
    if (const auto* change = std::get_if<LagChange>(&notice)) {
      server_falls_behind_ = change->falls_behind;
      PrintLine(DescribeLag(*change));
    }
    if (const auto* change = std::get_if<StateChange>(&notice); change != nullptr && poses_) WriteState(*change);
  };
  callbacks.on_progress = [this](const TrackProgress& value) {
    processed_seq_ = value.processed_chunks;
    progress_->Update(value);
  };
  callbacks.on_connection = [this](const ConnectionChange& change) {
    is_away_ = change.is_unreachable;
    PrintLine(connection_.Describe(change));
  };
  callbacks.on_position = [this](const TrackPosition& position, bool has_new_token) {
    return KeepPosition(position, has_new_token);
  };
  return callbacks;
}

void SessionRun::Observe(Client& client) {
  if (!poses_) return;
  SessionObserverOptions options;
  options.camera = FromCore(inputs_.camera);
  options.event_cell_px = arguments_.recording_options.event_cell_px;
  options.time_zero_us = [this] { return TimeZeroUs(); };
  options.records_first_states = is_resumed();
  options.print = [this](const std::string& text) { PrintLine(text); };
  observer_ = std::make_unique<SessionObserver>(client, record_.position.session, poses_->recorders(), options);
}

absl::Status SessionRun::Track(Client& client, TrackOptions options) {
  options.object_ids = inputs_.object_ids();
  // A run that was killed before its first chunk may divide chunks in any way.
  if (record_.position.max_piece_bytes > 0) feed_->Start(record_.position.max_piece_bytes);
  report_.recording = arguments_.recording;
  report_.session = arguments_.keeps_session ? record_.position.session : "";
  report_.trace_id = TraceId(record_.position.session);
  report_.out = arguments_.out;
  report_.transform = inputs_.frame.transform();
  report_.header = inputs_.reader->header();
  EVPOSE_RETURN_IF_ERROR(KeepPosition(record_.position, true));
  progress_ = std::make_unique<SessionProgress>(context_, client, record_.position.session,
                                                inputs_.reader->data_size_bytes(), !arguments_.is_json);
  Observe(client);
  const absl::Time begin = SystemClock().Now();
  absl::StatusOr<TrackSummary> summary = absl::UnknownError("");
  {
    const InterruptWatch watch(context_, is_away_, options.stop);
    const LagWatch lag_watch(*this);
    summary = ClientAccess::Track(client, record_.position, *feed_, MakeCallbacks(), options);
    if (summary.ok()) processed_seq_ = UINT64_MAX;
  }
  if (observer_ != nullptr) {
    if (summary.ok()) observer_->Finish();
    observer_->Stop();
    if (summary.ok()) observer_->RecordHealth(summary->health);
  }
  progress_->Stop();
  if (summary.ok()) return Finish(client, *summary, SystemClock().Now() - begin);
  return GiveUp(client, summary.status());
}

std::string SessionRun::KeepPoses() {
  if (!poses_ || !has_received_pose_) return "";
  const absl::Status status = CommitOutputs();
  if (!status.ok()) return absl::StrCat("; the poses are lost: ", status.message());
  std::string text;
  for (const PoseFile& file : report_.files) {
    absl::StrAppend(&text, "; ", file.Describe());
    if (file.num_poses == 0) continue;
    absl::StrAppendFormat(&text, " up to %.6f s", static_cast<double>(file.last_t_us) * 1e-6);
  }
  return text;
}

void SessionRun::DeleteSession(Client& client) const {
  const std::string& session = record_.position.session;
  WaitFor(context_, "the server to delete " + session, [&] { return client.DeleteSession(session); }).IgnoreError();
}

absl::Status SessionRun::GiveUp(Client& client, const absl::Status& status) {
  // The interrupt has ended the run, not the server.
  const bool is_interrupted = is_away_ && context_.IsInterrupted() && absl::IsCancelled(status);
  std::string text = absl::StrCat(is_interrupted ? "interrupted while no server responded: " : "", status.message());
  const std::string& session = record_.position.session;
  if (resume_) {
    if (!absl::IsNotFound(status)) {
      return absl::Status(status.code(), absl::StrCat(text, "; the same command continues from there"));
    }
    absl::StrAppend(&text, "; the server no longer has the session: remove ", resume_->path(), " to begin a new one");
    for (const PoseFile& file : poses_ ? poses_->files() : std::vector<PoseFile>()) {
      absl::StrAppend(&text, "; ", file.path, ".partial has the poses so far, and a new run overwrites it");
    }
    return absl::Status(status.code(), text);
  }
  absl::StrAppend(&text, KeepPoses());
  if (is_interrupted) {
    absl::StrAppend(&text, "; with --resume FILE, the run could be continued");
  } else if (GetDetails(status).reason == v1::ErrorReason_Name(v1::STORE_FULL)) {
    absl::StrAppend(&text, "; ", session, " is kept until it expires, but only a run with --resume FILE can continue");
  } else if (!arguments_.keeps_session) {
    // Frees the capacity of the server at once. The error of an unreachable server has been reported already.
    DeleteSession(client);
  }
  return absl::Status(status.code(), text);
}

absl::Status SessionRun::Finish(Client& client, const TrackSummary& summary, absl::Duration wall_time) {
  report_.summary = summary;
  report_.wall_time = wall_time;
  report_.truncated_bytes = chunker_.truncated_bytes();
  report_.skipped = inputs_.reader->skipped();
  report_.is_interrupted = context_.IsInterrupted() && !*inputs_.has_ended;
  report_.outages = connection_.outages();
  report_.away_for = connection_.away_for();
  if (clock_log_ != nullptr) report_.host_minus_sensor = clock_log_->SmallestDifference();
  EVPOSE_RETURN_IF_ERROR(CommitOutputs());
  if (resume_) resume_->Remove();
  feed_->outbox().Clear();
  if (!arguments_.keeps_session) DeleteSession(client);
  EVPOSE_RETURN_IF_ERROR(
      PrintResult(context_, arguments_.is_json, report_.ToJson(), [this](std::ostream& out) { report_.Print(out); }));
  return FinalStatus();
}

absl::Status SessionRun::FinalStatus() const {
  EVPOSE_RETURN_IF_ERROR(source_status_);
  const TrackSummary& summary = report_.summary;
  if (report_.is_interrupted && !arguments_.ends_at_interrupt) {
    return absl::CancelledError(absl::StrCat(
        arguments_.recording, ": interrupted before its end: ", Counted(summary.poses, "pose"),
        " of the events until then ", summary.poses == 1 ? "was" : "were", " found; run the command again for all"));
  }
  if (!inputs_.resets.empty()) {
    return absl::OutOfRangeError(absl::StrCat(
        "--reset-pose at ", inputs_.resets.front().t_us,
        " us was not applied: the events end before it; sensor times are those of evpose info and of the poses"));
  }
  if (summary.health.poses == 0) {
    return absl::NotFoundError(absl::StrCat(arguments_.recording, ": no pose was found; the report has the reason",
                                            report_.KeepsOlderFiles() ? "; earlier pose files stay as they were" : ""));
  }
  if (report_.HasOnlyFilesWithoutPose()) {
    return absl::NotFoundError(absl::StrCat(arguments_.recording, ": ", kOnlyAmbiguousPoses,
                                            report_.KeepsOlderFiles() ? "; earlier pose files stay as they were" : ""));
  }
  if (const std::vector<std::string> missing = report_.ObjectsWithoutPose(); !missing.empty()) {
    return absl::NotFoundError(absl::StrCat(arguments_.recording, ": no pose of ", absl::StrJoin(missing, ", "),
                                            " was found; the report has the reason"));
  }
  if (summary.lost_poses == 0) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(summary.lost_poses,
                                          " poses are missing: the server no longer kept them when the ",
                                          "stream was re-established (its --pose-log-capacity)"));
}

}  // namespace evpose::client
