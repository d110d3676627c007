// SPDX-License-Identifier: Apache-2.0

// A complete run of a session; used by replay and stream.
#pragma once

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/common/clock_log.h"
#include "client/cli/common/connection_messages.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/common/replay_report.h"
#include "client/cli/common/resume_file.h"
#include "client/cli/common/run_inputs.h"
#include "client/cli/common/session_progress.h"
#include "client/lib/stream/event_feed.h"
#include "client/mcap/session_observer.h"
#include "core/recordings/chunker.h"
#include "evpose/client.h"

namespace evpose::client {

// Call order: Open(), MakeFeed(), then, with a client, Begin() and Track(). Used once.
class SessionRun {
 public:
  // `own_arguments` are the arguments of the command that must be the same when a run is continued. All references must
  // outlive it.
  SessionRun(const RunArguments& arguments, RunInputs& inputs, CliContext& context,
             std::map<std::string, std::string> own_arguments);
  ~SessionRun();

  // Reads the file of --resume and opens the pose files.
  absl::Status Open();
  // Returns whether this run continues an earlier one.
  bool is_resumed() const { return resume_ && resume_->record(); }
  const TrackPosition& position() const { return record_.position; }

  // Creates the feed of the recording's chunks. An error of the source ends the stream; with `ends_on_error`, the data
  // read before the error is tracked, and the run fails afterwards.
  absl::Status MakeFeed(const FeedOptions& options, bool ends_on_error);
  EventFeed& feed() { return *feed_; }

  // Uploads the models and creates the session, unless the run continues an earlier one.
  absl::Status Begin(Client& client, const std::function<void(SessionConfig&)>& complete,
                     const std::string& request_id);
  // Runs until the summary; then the report and the pose files are complete. Without --resume, a run that fails also
  // completes the pose files, with the poses received so far.
  absl::Status Track(Client& client, TrackOptions options);

  void PrintLine(const std::string& text);
  ConnectionMessages& connection() { return connection_; }

 private:
  class LagWatch;

  absl::StatusOr<EventChunk> NextChunk();
  absl::Status OpenClockLog();
  absl::Status OpenPoses();
  // Writes all outputs to the disk, and keeps their sizes in the record.
  absl::Status SyncOutputs();
  // Completes the outputs, and lists the pose files in the report.
  absl::Status CommitOutputs();
  absl::Status KeepPosition(const TrackPosition& position, bool has_new_token);
  // Sensor time at which the clock of the pose files is 0.
  int64_t TimeZeroUs() const { return arguments_.has_metavision_zero ? inputs_.metavision_zero_us->load() : 0; }
  void WritePose(const Pose& pose);
  void WriteState(const StateChange& change);
  TrackCallbacks MakeCallbacks();
  // Begins to record what a .mcap file has beside the poses.
  void Observe(Client& client);
  // Completes the pose files of a run that failed, and returns its status with advice.
  absl::Status GiveUp(Client& client, const absl::Status& status);
  // Writes the poses so far, if any was received; returns a text about the files.
  std::string KeepPoses();
  absl::Status Finish(Client& client, const TrackSummary& summary, absl::Duration wall_time);
  void DeleteSession(Client& client) const;
  // The status of a run that has reported its summary.
  absl::Status FinalStatus() const;

  const RunArguments& arguments_;
  RunInputs& inputs_;
  CliContext& context_;
  Chunker chunker_;
  std::optional<ResumeFile> resume_;
  ResumeRecord record_;
  std::optional<PoseFiles> poses_;
  std::unique_ptr<ClockLog> clock_log_;  // null: none
  bool has_received_pose_ = false;       // in this process
  std::unique_ptr<EventFeed> feed_;
  bool ends_on_error_ = false;
  absl::Status source_status_;  // status of a source that ends on errors; owned by the feed's thread until the summary
  std::unique_ptr<SessionProgress> progress_;
  std::unique_ptr<SessionObserver> observer_;
  ConnectionMessages connection_;
  std::atomic<bool> is_away_ = false;              // the server is unreachable while there is a stream
  std::atomic<bool> server_falls_behind_ = false;  // the latest LagChange
  std::atomic<uint64_t> processed_seq_ = 0;        // the latest TrackProgress
  ReplayReport report_;
  uint64_t kept_pose_seq_ = 0;
  absl::Time kept_at_ = absl::InfinitePast();
};

}  // namespace evpose::client
