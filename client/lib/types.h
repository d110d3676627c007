// SPDX-License-Identifier: Apache-2.0

// Parameters and results of the client library: plain types without generated headers. Each corresponds to the message
// of the same name in proto/evpose/v1, which documents the fields.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/time/time.h"
#include "core/baselines/estimators/estimator_kind.h"
#include "core/estimation/sensor_profile.h"
#include "core/events/decoder.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/tracking/tracker.h"

namespace evpose::client {

// The lowest level that a server writes to its log.
enum class LogLevel { kDebug, kInfo, kWarning, kError, kOff };

struct ServerInfo {
  std::string version;
  std::string commit;  // commit of the build
  std::string store;
  uint32_t active_sessions = 0;
  uint32_t max_sessions = 0;
  uint32_t max_chunk_bytes = 0;
  uint64_t max_model_bytes = 0;
  bool is_draining = false;
  uint64_t skipped_events = 0;
};

struct ModelInfo {
  std::string name;  // "models/{id}"
  ModelFormat format = ModelFormat::kObj;
  uint64_t size_bytes = 0;
  uint32_t num_faces = 0;
  uint32_t num_lines = 0;
  uint32_t num_symmetries = 1;
  double diameter_m = 0.0;
  double metres_per_unit = 1.0;
  double crease_angle_deg = 0.0;
  std::string sha256_hex;
  absl::Time create_time = absl::InfinitePast();
  std::vector<std::string> notices;
};

struct TrackedObject {
  std::string object_id = "object";
  std::string model;                                         // ModelInfo::name
  std::optional<RigidTransform> initial_camera_from_object;  // absent: the pose is searched for in the events
  std::optional<Eigen::Matrix3d> reference_rotation;         // absent: the identity
};

enum class OverloadPolicy { kBlock, kLatest };

struct SessionConfig {
  Encoding encoding = Encoding::kEvt3;
  CameraModel camera;
  std::vector<TrackedObject> objects;
  Estimator estimator = Estimator::kMixture;
  SensorProfile sensor;
  OverloadPolicy overload_policy = OverloadPolicy::kBlock;
  std::optional<absl::Duration> max_lag;  // kLatest only; absent: the server's default, which CreateSession returns
};

struct ObjectHealth {
  std::string object_id;
  TrackState state = TrackState::kInitializing;
  uint32_t losses = 0;
  float explained_ratio = 0.0f;
  InitializationStatus initialization = InitializationStatus::kWaitingForEvents;
  uint64_t initialization_attempts = 0;
  std::string detail;
};

struct SessionHealth {
  int64_t t_us = 0;
  uint64_t received_bytes = 0;
  uint64_t processed_bytes = 0;
  uint64_t decoded_events = 0;
  uint64_t dropped_events = 0;
  uint64_t invalid_words = 0;
  uint64_t time_backsteps = 0;
  uint64_t poses = 0;
  double event_rate_hz = 0.0;
  double pose_rate_hz = 0.0;
  double real_time_ratio = 0.0;
  std::optional<absl::Duration> latency_p50;
  std::optional<absl::Duration> latency_p99;
  uint64_t skipped_events = 0;
  int64_t skipped_us = 0;
  std::vector<ObjectHealth> objects;
};

enum class SessionState { kUnknown, kDetached, kAttached, kEnded };

struct Session {
  std::string name;  // "sessions/{id}"
  SessionConfig config;
  std::string resume_token;  // returned by CreateSession only; a secret
  SessionState state = SessionState::kUnknown;
  absl::Time create_time = absl::InfinitePast();
  std::optional<absl::Time> expire_time;
  SessionHealth health;
};

struct Pose {
  uint64_t seq = 0;
  std::string object_id;
  PoseEstimate estimate;
  absl::Duration latency;  // the only field that is not a function of the events
};

struct GoAway {
  absl::Duration deadline;
};
struct DecodeFault {
  uint64_t chunk_seq = 0;
  uint64_t count = 0;
  std::string detail;
};
struct StateChange {
  std::string object_id;
  int64_t t_us = 0;
  TrackState state = TrackState::kInitializing;
};
enum class DropReason { kUnknown, kLag, kMemory, kReader };
struct EventsDropped {
  uint64_t num_events = 0;
  int64_t from_t_us = 0;
  int64_t to_t_us = 0;
  DropReason reason = DropReason::kUnknown;
};
// The session was restored without the state of its tracker: every object is searched for again.
struct TrackingRestarted {
  uint64_t after_seq = 0;  // the last chunk that was tracked before
  std::string detail;      // the reason, for people
};
// Reported by this library: the server no longer stored these poses when the stream was re-established.
struct PosesLost {
  uint64_t first_seq = 0;
  uint64_t last_seq = 0;
};
using Notice = std::variant<GoAway, DecodeFault, StateChange, EventsDropped, TrackingRestarted, PosesLost>;

}  // namespace evpose::client
