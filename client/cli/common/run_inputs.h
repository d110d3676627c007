// SPDX-License-Identifier: Apache-2.0

// The inputs of replay and stream, and their validation before a server is contacted.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/common/replay_report.h"
#include "core/estimation/sensor_profile.h"
#include "core/recordings/chunker.h"
#include "core/recordings/recording_reader.h"
#include "evpose/client.h"

namespace evpose::client {

struct RunArguments {
  std::string recording;
  std::string model;
  std::vector<std::string> objects;  // "ID=MODEL"
  std::string camera;
  std::string sensor;
  ServerArguments server;
  std::string out;
  RecordingArguments recording_options;  // options of an `out` in .mcap
  std::string clock_log;                 // empty: none
  std::vector<std::string> init_poses;
  std::vector<std::string> reset_poses;  // "T_US [ID=]POSE"
  double pose_rate_hz = SessionConfig().pose_rate_hz;
  std::string estimator = "mixture";
  size_t chunk_bytes = 0;
  ModelReadingArguments reading;
  PoseFrameArguments frame;
  double max_outage_s = 120.0;
  double retain_s = absl::ToDoubleSeconds(RetainOptions().duration);
  uint64_t retain_bytes = RetainOptions().max_bytes;
  std::string resume;  // empty: the run cannot be continued
  bool keeps_session = false;
  bool is_live = false;              // the events arrive as the camera sends them
  std::string pace = "real time";    // of the events, for messages
  bool ends_at_interrupt = false;    // an interrupt is the normal end of the events: stream, replay --follow
  bool has_metavision_zero = false;  // the pose files count from Metavision's zero, not from the sensor's
  bool is_json = false;

  // `epoch_default`: that of RecordingArguments. The formats of the recording are those for `is_live`.
  void AddTo(CLI::App& app, bool server_is_required, const std::string& epoch_default);
  // None without a server: the one inside this process has no store that could lose writes.
  RetainOptions retain() const;

 private:
  void AddInputs(CLI::App& app);
  void AddOutputs(CLI::App& app, const std::string& epoch_default);
  void AddTracking(CLI::App& app);
  void AddConnection(CLI::App& app, bool server_is_required);
  void AddResearch(CLI::App& app);
};

struct InputObject {
  std::string id;
  std::string model_path;
  ModelUpload model;
  std::optional<Transform> initial_pose;
};

// A reset of a pose at a sensor time: --reset-pose.
struct TimedReset {
  int64_t t_us = 0;
  PoseReset reset;
};

struct RunInputs {
  std::vector<InputObject> objects;
  std::vector<TimedReset> resets;  // in the order of their times
  CameraModel camera;
  SensorProfile sensor;
  PoseFrame frame;
  // The sensor time at which Metavision's clock is 0 (RecordingHeader::metavision_zero_us or FirstTimeWord); set before
  // a pose can arrive, by the thread that reads.
  std::shared_ptr<std::atomic<int64_t>> metavision_zero_us = std::make_shared<std::atomic<int64_t>>(0);
  // Whether the reader has returned the end of the recording, and was not stopped before; set by the thread that reads.
  std::shared_ptr<std::atomic<bool>> has_ended = std::make_shared<std::atomic<bool>>(false);
  std::unique_ptr<RecordingReader> reader;

  std::vector<std::string> object_ids() const;
};

// --model for one object, or --object for each of several.
void AddObjectModels(CLI::App& app, std::string& model, std::vector<std::string>& objects);
// Returns ID and path of the models of these options. Errors (usage): none or both options, a text that is not
// ID=MODEL, an ID that was given twice.
absl::StatusOr<std::vector<std::pair<std::string, std::string>>> ParseObjectModels(
    const std::string& model, const std::vector<std::string>& objects);

// Moves the resets that are due at the end of `chunk` from the front of `resets` into the chunk.
void AddDueResets(std::vector<TimedReset>& resets, EventChunk& chunk);

// Validates all inputs that can be validated without a server. When `reader_options.stop` is requested, the data read
// until then is the complete recording; with --resume and without ends_at_interrupt, the reader then returns CANCELLED.
absl::StatusOr<RunInputs> ReadRunInputs(const CliContext& context, const RunArguments& arguments,
                                        const RecordingReaderOptions& reader_options);

ChunkerOptions MakeChunkerOptions(const RunArguments& arguments);

// Uploads the models and adds the server's description of them to `report`.
absl::StatusOr<SessionConfig> UploadModels(const CliContext& context, Client& client, const RunArguments& arguments,
                                           const RunInputs& inputs, ReplayReport& report);

// Errors name the input files of the session. With --server and without ends_at_interrupt, an interrupt ends the call:
// CANCELLED.
absl::StatusOr<Session> CreateSession(const CliContext& context, Client& client, const SessionConfig& config,
                                      const RunArguments& arguments, const RunInputs& inputs,
                                      const std::string& request_id);

}  // namespace evpose::client
