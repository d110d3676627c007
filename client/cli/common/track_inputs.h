// SPDX-License-Identifier: Apache-2.0

// What replay and stream are given, and what they make of it before a server is asked.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "client/cli/common/replay_report.h"
#include "client/lib/client.h"
#include "core/events/recording_reader.h"

namespace evpose::client {

struct TrackArguments {
  std::string recording;
  std::string model;
  std::vector<std::string> objects;  // "ID=MODEL"
  std::string camera;
  std::string sensor;
  ServerArguments server;
  std::string out;
  std::vector<std::string> init_poses;
  std::string estimator = "mixture";
  size_t chunk_bytes = 0;
  double metres_per_unit = 1.0;
  double max_outage_s = 120.0;
  std::string resume;  // empty: cannot be gone on with
  bool keeps_session = false;
  bool is_json = false;

  void AddTo(CLI::App& app, bool server_is_required);
};

struct InputObject {
  std::string id;
  std::string model_path;
  std::string model_bytes;
  UploadOptions upload;
  std::optional<RigidTransform> initial_pose;
};

struct TrackInputs {
  std::vector<InputObject> objects;
  CameraModel camera;
  SensorProfile sensor;
  std::unique_ptr<RecordingReader> reader;

  std::vector<std::string> object_ids() const;
};

// Everything that can be wrong before a server is asked. When `reader_options.stop` says so, what was read until then
// is the whole recording.
absl::StatusOr<TrackInputs> ReadTrackInputs(const TrackArguments& arguments,
                                            const RecordingReaderOptions& reader_options);

ChunkerOptions MakeChunkerOptions(const TrackArguments& arguments);

// Uploads the models and says in `report` what the server made of them.
absl::StatusOr<SessionConfig> UploadModels(Client& client, const TrackArguments& arguments, const TrackInputs& inputs,
                                           ReplayReport& report);

// Errors name the files that the session is for.
absl::StatusOr<Session> CreateSession(Client& client, const SessionConfig& config, const TrackArguments& arguments,
                                      const TrackInputs& inputs, const std::string& request_id);

}  // namespace evpose::client
