// SPDX-License-Identifier: Apache-2.0

// One run of a session from beginning to end: what replay and stream share.
#pragma once

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/common/connection_lines.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/common/replay_report.h"
#include "client/cli/common/resume_file.h"
#include "client/cli/common/session_progress.h"
#include "client/cli/common/track_inputs.h"
#include "client/lib/client.h"
#include "core/events/recording_reader.h"

namespace evpose::client {

// The steps in their order: Open(), MakeFeed(), then, with a client, Begin() and Track(). Used once.
class TrackRun {
 public:
  // `own_arguments` are those of the command alone that must stay the same when it is gone on with. All must outlive
  // it.
  TrackRun(const TrackArguments& arguments, TrackInputs& inputs, CliContext& context,
           std::map<std::string, std::string> own_arguments);
  ~TrackRun();

  // Reads what --resume has kept and opens the files of poses.
  absl::Status Open();
  bool is_resumed() const { return resume_ && resume_->record(); }
  // Of a run that is gone on with.
  const TrackPosition& position() const { return record_.position; }

  // Chunks of the recording. An error of the source ends the stream; with `ends_on_error` what was read before is
  // tracked to its end, and the run fails then.
  absl::Status MakeFeed(FeedOptions options, bool ends_on_error);
  EventFeed& feed() { return *feed_; }

  // Uploads the models and creates the session, unless the run is gone on with.
  absl::Status Begin(Client& client, const std::function<void(SessionConfig&)>& complete,
                     const std::string& request_id);
  // Until the summary; then the report and the files of poses are complete.
  absl::Status Track(Client& client, TrackOptions options);

  void Say(const std::string& text);
  ConnectionLines& connection() { return connection_; }

 private:
  absl::StatusOr<EventChunkBytes> NextChunk();
  absl::Status KeepPosition(const TrackPosition& position, bool has_new_token);
  TrackCallbacks MakeCallbacks();
  // Of a run that failed: with what to do now.
  absl::Status Explain(Client& client, const absl::Status& status) const;
  absl::Status Finish(Client& client, const TrackSummary& summary, absl::Duration wall_time);

  const TrackArguments& arguments_;
  TrackInputs& inputs_;
  CliContext& context_;
  Chunker chunker_;
  std::optional<ResumeFile> resume_;
  ResumeRecord record_;
  std::optional<PoseFiles> poses_;
  std::unique_ptr<EventFeed> feed_;
  bool ends_on_error_ = false;
  absl::Status source_status_;  // of a source that ends on errors; of the feed's thread until the summary
  std::unique_ptr<SessionProgress> progress_;
  ConnectionLines connection_;
  std::atomic<bool> is_away_ = false;  // the server, while there is a stream
  ReplayReport report_;
  uint64_t kept_pose_seq_ = 0;
  absl::Time kept_at_ = absl::InfinitePast();
};

}  // namespace evpose::client
