// SPDX-License-Identifier: Apache-2.0

// Parameters and results of the client library. Most types correspond to a message or enumeration in proto/evpose/v1,
// some under another name (client/lib/messages converts them). The enumerators have the numbers of the API. Times
// `t_us` are microseconds on the sensor's clock.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/time.h"

namespace evpose::client {

// A rigid motion target_from_source: x_target = rotation * x_source + translation_m.
struct Transform {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero();

  Eigen::Quaterniond Quaternion() const;  // unit length, w >= 0
};

// The distortion of a lens, in OpenCV's terms.
enum class LensModel {
  kBrown = 1,     // k1 k2 p1 p2 k3: ROS's plumb_bob, Kalibr's radtan
  kRational = 2,  // k1 k2 p1 p2 k3 k4 k5 k6: ROS's rational_polynomial
  kFisheye = 3,   // k1 k2 k3 k4: equidistant
};

// Pinhole camera with the distortion of a lens. Pixel (0, 0) is the centre of the top-left pixel. Read from a file by
// LoadCamera() (evpose/recording.h).
struct Camera {
  int width_px = 0;
  int height_px = 0;
  double fx_px = 0.0;
  double fy_px = 0.0;
  double cx_px = 0.0;
  double cy_px = 0.0;
  std::array<double, 8> distortion = {};  // of the lens model, in its order; then 0
  LensModel lens_model = LensModel::kBrown;

  bool operator==(const Camera&) const = default;
};

// Constants of a sensor and its lens; the defaults are those of an EVK4.
struct SensorParameters {
  double pixel_noise_px = 0.8;       // standard deviation of the distance between an edge and its events
  double blur_px = 0.47;             // standard deviation of the image of an edge
  double contrast_threshold = 0.35;  // change of the natural logarithm of light that causes an event
  double refractory_us = 140.0;      // dead time of a pixel after an event
  double latency_us = 40.0;          // delay of the time stamps
  // Standard deviation of the errors of these constants, relative to the spread among sensors: 1 for a sensor that was
  // not calibrated, 0.3 after `evpose calibrate`, 0 for exact constants. It affects the covariance of the poses only.
  double uncertainty = 1.0;

  bool operator==(const SensorParameters&) const = default;
};

// Encoding of the event stream.
enum class EventEncoding { kEvt3 = 1, kEvt21, kEvt2, kDat, kFlat64 };
std::string_view EventEncodingName(EventEncoding encoding);  // "EVT3", "EVT2.1", "EVT2", "DAT", "FLAT64"

// The pose estimator of a session. All but kMixture exist for comparisons.
enum class PoseEstimator { kMixture = 1, kStaticMm, kStaticLs, kStaticM, kStaticS, kErrorStateFilter };

// Format of a model file.
enum class ModelFormat { kObj = 1, kPly, kStl, kMesh };

// What the facets of a model stand for: a smooth surface, or themselves.
enum class ModelSurface { kSmooth = 1, kAsIs };

// State of an object's track. kUnknown is a state of a later server; it means that there is no confirmed pose.
enum class TrackState {
  kUnknown,
  kInitializing,  // no pose has been confirmed yet
  kTracking,      // the pose is confirmed
  kDegraded,      // the events support only a part of the pose, are too few, or contradict it
  kLost,          // the track was lost; the object is searched for again
  kAmbiguous,     // several poses explain the events; the most likely one is reported, with the others
};
std::string_view TrackStateName(TrackState state);  // "UNKNOWN", "INITIALIZING", "TRACKING", ...

// The reason why an object has no pose yet.
enum class InitializationStatus {
  kNotNeeded = 1,     // a pose is tracked
  kWaitingForEvents,  // too few events
  kTooFewLines,       // fewer than three lines were detected
  kNoPoseFits,        // no pose of the model fits the detected lines
  kVerifying,         // a pose is being tested against the events
  kAmbiguous,         // several poses are equally consistent with the events
  kNotSearchable,     // no edge of the model is visible from any side; give a pose
  kNotEnoughMotion,   // the detected lines moved by less than a pixel
  kTooSmall,          // fewer than three lines, and the region with the events is too small for them
  kNotSupported,      // a pose was found or given, and the events do not support it
};
std::string_view InitializationStatusName(InitializationStatus status);  // "NOT_NEEDED", "WAITING_FOR_EVENTS", ...

// The reason why a reported or given pose was rejected. kUnknown also stands for causes of a later server.
enum class LossCause {
  kUnknown,
  kContradicted,  // the events contradicted it
  kUncertain,     // it was no longer determined, or the estimation failed
  kOutOfView,     // all of its edges were outside the image
  kBetterPose,    // another pose explains the events better
  kOccupied,      // it was at the place of another object
  kUnconfirmed,   // a given pose was not confirmed before the end of the events
};
std::string_view LossCauseName(LossCause cause);  // "UNKNOWN", "CONTRADICTED", "UNCERTAIN", ...

// The lowest level that a server writes to its log.
enum class LogLevel { kDebug = 1, kInfo, kWarning, kError, kOff };

struct ServerInfo {
  std::string version;
  std::string commit;  // commit of the build
  std::string store;   // "memory", "sqlite", "redis" or "postgresql"; "unknown" for a kind of a later server
  uint32_t active_sessions = 0;
  uint32_t max_sessions = 0;
  uint32_t max_chunk_bytes = 0;
  uint64_t max_model_bytes = 0;
  bool is_draining = false;
  uint64_t skipped_events = 0;
  uint32_t pose_log_capacity = 0;  // poses that are stored for each session
  absl::Duration session_expiry;   // how long a session without a stream is kept
  std::optional<absl::Time> time;  // the server's clock when it made the response; earlier servers do not state it
};

// A continuous group of motions that map an object onto itself: the rotation of the object by them is not measured, and
// the covariance of its poses has the variance pi^2 / 3 rad^2 along them.
struct ContinuousSymmetry {
  enum class Kind { kAxis = 1, kSphere };
  Kind kind = Kind::kAxis;
  Eigen::Vector3d centre_m = Eigen::Vector3d::Zero();  // object frame; a point of the axis, or the centre
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();      // unit; zero for a sphere
  // Whether half turns about the axes through the centre that are perpendicular to `axis` map the object onto itself,
  // too.
  bool is_flippable = false;
};

struct ModelInfo {
  std::string name;  // "models/{id}"
  ModelFormat format = ModelFormat::kObj;
  uint64_t size_bytes = 0;
  uint32_t num_faces = 0;
  uint32_t num_lines = 0;                                 // straight edges
  uint32_t num_curves = 0;                                // curved edges
  uint32_t num_regions = 0;                               // parts of the surface between creases; 0 if all are flat
  uint32_t num_symmetries = 1;                            // 1 with a continuous symmetry
  std::optional<ContinuousSymmetry> continuous_symmetry;  // absent also for a kind of a later server
  double diameter_m = 0.0;
  double metres_per_unit = 1.0;
  double crease_angle_deg = 0.0;
  ModelSurface surface = ModelSurface::kSmooth;
  std::string sha256_hex;
  absl::Time create_time = absl::InfinitePast();
  std::vector<std::string> notices;
  std::string file_name;  // UploadOptions::file_name of the first upload
};

struct TrackedObject {
  std::string object_id = "object";
  std::string model;                                    // ModelInfo::name
  std::optional<Transform> initial_camera_from_object;  // absent: the pose is searched for in the events
  // A rotation camera_from_object. Of the poses in which a symmetric object looks the same, the one nearest to it is
  // reported. Absent: the identity.
  std::optional<Eigen::Matrix3d> reference_rotation;
};

// What happens when events arrive faster than the session tracks them.
enum class OverloadPolicy {
  kBlock = 1,  // lossless, for recordings: the client waits
  kLatest,     // for live cameras: events that have waited longer than max_lag are counted, but not tracked
};

struct SessionConfig {
  EventEncoding encoding = EventEncoding::kEvt3;
  Camera camera;
  std::vector<TrackedObject> objects;
  PoseEstimator estimator = PoseEstimator::kMixture;
  SensorParameters sensor;
  // 1000 to 10,000. Poses per second of each object, while there are 150 events for each. The processor time of the
  // server per second grows with it.
  double pose_rate_hz = 1000.0;
  OverloadPolicy overload_policy = OverloadPolicy::kBlock;
  std::optional<absl::Duration> max_lag;  // kLatest only; absent: the server's default, which CreateSession returns
};

// Searches for the pose by their result, since the start or the latest loss.
struct SearchCounts {
  uint64_t no_signal = 0;  // no region had more events than the noise
  uint64_t too_small = 0;
  uint64_t too_few_lines = 0;
  uint64_t not_enough_motion = 0;
  uint64_t no_pose_fits = 0;
  uint64_t poses_found = 0;  // poses, which the events may have rejected later
};

// The rejection of a reported or given pose.
struct Loss {
  int64_t t_us = 0;
  LossCause cause = LossCause::kUnknown;

  bool operator==(const Loss&) const = default;
};

struct ObjectHealth {
  std::string object_id;  // TrackedObject::object_id
  TrackState state = TrackState::kInitializing;
  uint32_t losses = 0;           // changes to kLost
  float explained_ratio = 0.0f;  // of the latest pose
  // Why there is no confirmed pose. When the session has ended without a pose: the result of most searches.
  InitializationStatus initialization = InitializationStatus::kWaitingForEvents;
  uint64_t initialization_attempts = 0;  // searches for the pose so far
  std::string detail;                    // for people: why there is no confirmed pose; empty when there is one
  std::optional<Loss> latest_loss;       // absent before the first loss
  SearchCounts searches;
  uint32_t followed_poses = 0;  // the first pose, tested or reported, and those that are compared with it
};

// Processor seconds per second, averaged with a time constant of one second. A limit of 0 means none.
struct ProcessingHealth {
  double cpu_s_per_s = 0.0;
  double max_cpu_s_per_s = 0.0;         // limit of cpu_s_per_s, at which the session waits
  bool falls_behind = false;            // the events are processed more slowly than the camera sends them
  double tenant_cpu_s_per_s = 0.0;      // of all sessions of the tenant on the server
  double max_tenant_cpu_s_per_s = 0.0;  // limit of tenant_cpu_s_per_s, at which all sessions of the tenant wait
};

struct SessionHealth {
  int64_t t_us = 0;              // up to which events were processed
  uint64_t received_bytes = 0;   // payload, without repeated chunks
  uint64_t processed_bytes = 0;  // payload
  uint64_t decoded_events = 0;   // changes of brightness
  uint64_t dropped_events = 0;   // events before the first full time stamp, or outside the sensor
  uint64_t invalid_words = 0;    // words of unknown type, and incomplete vectors
  uint64_t time_backsteps = 0;   // backward steps of the time stamps, other than wraps of the clock
  uint64_t poses = 0;            // of all objects
  double event_rate_hz = 0.0;    // per second of sensor time
  double pose_rate_hz = 0.0;     // per second of sensor time
  double real_time_ratio = 0.0;  // processing time over sensor time; above 1 the session falls behind
  // From the receipt of the events of a pose by the server to the pose; absent before the first pose.
  std::optional<absl::Duration> latency_p50;
  std::optional<absl::Duration> latency_p99;
  uint64_t skipped_events = 0;  // decoded, but not tracked (OverloadPolicy::kLatest)
  int64_t skipped_us = 0;       // the sensor time of these events
  ProcessingHealth processing;
  std::vector<ObjectHealth> objects;
};

enum class SessionState {
  kUnknown,   // not given, or a state of a later server
  kDetached,  // the session waits for a stream until expire_time
  kAttached,  // a stream is attached
  kEnded,     // all events are processed; the session can be read until expire_time
};
std::string_view SessionStateName(SessionState state);  // "UNKNOWN", "DETACHED", "ATTACHED", "ENDED"

struct Session {
  std::string name;  // "sessions/{id}"
  SessionConfig config;
  std::string resume_token;  // returned by CreateSession only; a secret
  SessionState state = SessionState::kUnknown;
  absl::Time create_time = absl::InfinitePast();
  std::optional<absl::Time> expire_time;  // absent while a stream is attached
  SessionHealth health;
};

// A pose that competes with the reported one.
struct PoseAlternative {
  Transform camera_from_object;
  double log_likelihood_ratio = 0.0;  // relative to the reported pose; 0 means equally likely
};

// The pose of one object. All fields but `latency` are functions of the session's events.
struct Pose {
  uint64_t seq = 0;
  std::string object_id;
  int64_t t_us = 0;  // sensor time of the pose: the middle of the window of events
  Transform camera_from_object;
  // Covariance of [tx ty tz rx ry rz], m and rad, for a perturbation on the left.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  // Linear and angular velocity in the camera frame, [vx vy vz wx wy wz], m/s and rad/s.
  Eigen::Matrix<double, 6, 1> twist = Eigen::Matrix<double, 6, 1>::Zero();
  TrackState state = TrackState::kInitializing;
  uint32_t num_events = 0;       // events of the window within the gates, the regions about the predicted edges
  float explained_ratio = 0.0f;  // fraction of these events that are attributed to the edges
  float residual_rms_px = 0.0f;  // root mean square of the distances of the attributed events from their edges
  absl::Duration latency;
  std::vector<PoseAlternative> alternatives;  // kAmbiguous only: at most 4, the most likely one first
  std::optional<Loss> latest_loss;            // of the object, before this pose; absent before its first loss

  // camera_from_object at another sensor time, microseconds, if the twist is constant in between. The acceleration a of
  // the object adds an error of a dt^2 / 2.
  Transform At(int64_t at_us) const;
};

// A pose given by the caller; tracking of the object restarts from it.
struct PoseReset {
  std::string object_id = "object";
  Transform camera_from_object;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// The kind of an edge of a model. kUnknown is a kind of a later server.
enum class EdgeKind { kCrease, kBoundary, kPaintedLine, kOccludingContour, kUnknown };

// The visible edges of an object at one pose, as the tracker has extracted them.
struct ObjectOutline {
  // A part of an edge, from one end to the other. In pixels of the sensor, distortion included; the centre of the first
  // pixel is (0, 0).
  struct Segment {
    Eigen::Vector2f p1_px = Eigen::Vector2f::Zero();
    Eigen::Vector2f p2_px = Eigen::Vector2f::Zero();
    EdgeKind kind = EdgeKind::kUnknown;
  };

  std::string object_id;
  TrackState state = TrackState::kUnknown;  // at t_us
  int64_t t_us = 0;                         // sensor time of the pose
  Transform camera_from_object;
  std::vector<Segment> segments;
};

// The events of an interval of sensor time, and the visible edges of the objects that have a pose at its end.
struct EventImage {
  int64_t from_t_us = 0;
  int64_t to_t_us = 0;
  int cell_px = 0;           // width and height of a cell
  int width = 0;             // cells in a row; those at the right and lower borders may be incomplete
  int height = 0;            // rows
  uint64_t num_events = 0;   // of the interval
  uint64_t num_skipped = 0;  // images that were replaced by later ones, which contain their events; cumulative
  // Two bits for each cell, row by row without padding between rows; four cells in a byte, the first in the lowest
  // bits. 0: no event, 1: brighter (ON), 2: darker (OFF), 3: both. (width * height + 3) / 4 bytes, never compressed.
  std::vector<uint8_t> cells;
  std::vector<ObjectOutline> outlines;

  // The two bits of a cell. Precondition: the cell is inside the image.
  int CellAt(int x, int y) const;
};

// The geometry of a model in the object's frame, in metres.
struct ModelGeometry {
  std::vector<Eigen::Vector3f> vertices_m;
  std::vector<std::array<uint32_t, 3>> faces;           // numbers of vertices, counter-clockwise seen from outside
  std::vector<std::array<Eigen::Vector3f, 2>> edges_m;  // straight lines, and the chords of curved edges
  bool is_simplified = false;                           // the mesh was simplified, or edges were left out
};

// The server shuts down.
struct GoAway {
  absl::Duration deadline;  // from now; the stream is ended then
};
// The decoder skipped words or events of a chunk.
struct DecodeFault {
  uint64_t chunk_seq = 0;
  uint64_t count = 0;  // of skipped words and events
  std::string detail;  // what is wrong with them
};
// The state of an object's track has changed.
struct StateChange {
  std::string object_id;
  int64_t t_us = 0;  // sensor time of the change
  TrackState state = TrackState::kInitializing;
};
// Why events were skipped.
enum class DropReason {
  kUnknown,
  kLag,     // they had waited longer than SessionConfig::max_lag
  kMemory,  // more bytes were waiting than the server grants as credit
  kReader,  // the client of the stream does not read its poses
};
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
  // The last stored pose. If later ones were delivered before, poses of the new search are delivered with the same
  // numbers. Absent: the server has an earlier version, which does not send those.
  std::optional<uint64_t> after_pose_seq;
};
// The server has begun or ceased to process the events more slowly than they were recorded.
struct LagChange {
  bool falls_behind = false;
  absl::Duration lag;  // waiting time of the oldest unprocessed events
};
// An edge on an external trigger input of the camera.
struct Trigger {
  int64_t t_us = 0;  // sensor time
  uint32_t input = 0;
  bool is_rising = false;
};
// The triggers of a chunk, in order. They have no influence on poses. As every notice, one may be missing after an
// outage.
struct Triggers {
  uint64_t chunk_seq = 0;
  std::vector<Trigger> triggers;  // at most 64
  uint64_t num_skipped = 0;       // triggers of the chunk beyond them
};
// Reported by this library: the server no longer stored these poses when the stream was re-established.
struct PosesLost {
  uint64_t first_seq = 0;
  uint64_t last_seq = 0;
};
using Notice =
    std::variant<GoAway, DecodeFault, StateChange, EventsDropped, TrackingRestarted, LagChange, Triggers, PosesLost>;

}  // namespace evpose::client
