// SPDX-License-Identifier: Apache-2.0

// The messages between the page and the gateway (client/view/README.md, section 3).
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/common/recording_input.h"
#include "core/events/event_counts.h"
#include "evpose/types.h"

namespace evpose::client {

// Messages of the page.
struct KeyRequest {
  std::string key;
};
struct ListRequest {};
struct OpenRequest {
  std::string session;
};
struct ImageSettings {
  double window_ms = 10.0;  // duration of the events of an image of a recording, 0.1 to 1000
  int cell_px = 2;          // width and height of a cell: 1, 2 or 4
  double rate_hz = 30.0;    // images per second, 1 to 60

  bool operator==(const ImageSettings&) const = default;
};
struct AckRequest {
  uint64_t number = 0;
};
struct SeekRequest {
  int64_t t_us = 0;
};
struct PlayRequest {
  double speed = 1.0;  // seconds of the recording per second, 0.001 to 10
};
struct PauseRequest {};
struct StepRequest {
  int count = 0;  // poses forwards, or backwards if negative; -10000 to 10000 without 0
};
using PageRequest = std::variant<KeyRequest, ListRequest, OpenRequest, ImageSettings, AckRequest, SeekRequest,
                                 PlayRequest, PauseRequest, StepRequest>;

// Error: INVALID_ARGUMENT naming the field. The text is that of an untrusted sender.
absl::StatusOr<PageRequest> ParsePageRequest(std::string_view text);

// Messages of the gateway.
struct HelloMessage {
  bool is_recording = false;
  std::string source;   // address of the server, or the file
  std::string session;  // empty: none was chosen
};
struct SceneObject {
  std::string id;
  std::string model;  // a name for people
  double diameter_m = 0.0;
};
struct PageScene {
  std::string session;  // empty for a recording
  PoseFrame frame;      // of the poses that are sent
  Camera camera;
  std::vector<SceneObject> objects;
  std::optional<TimeSpan> recording;
  bool has_truth = false;
};
// Counters of the connection to a page.
struct LinkCounts {
  uint64_t images_sent = 0;
  uint64_t images_skipped = 0;
  uint64_t unacknowledged = 0;
};
enum class NoticeLevel { kInfo, kError };

std::string ToText(const HelloMessage& hello);
std::string ToText(const PageScene& scene);
std::string SessionsText(const std::vector<Session>& sessions);
// `rotations` has the rotation of each pose as a unit quaternion; if it is empty, they are computed from the matrices
// of the poses.
std::string PosesText(const std::string& object_id, absl::Span<const Pose> poses, bool is_truth,
                      absl::Span<const Eigen::Quaterniond> rotations = {});
std::string StateText(const std::string& object_id, int64_t t_us, TrackState state, const std::string& reason);
// The cause of a loss as the reason of a state: "better pose" for BETTER_POSE.
std::string CauseText(LossCause cause);
std::string HealthText(const SessionHealth& health, const LinkCounts& link);
std::string PositionText(int64_t t_us, bool is_playing, double speed);
std::string RangeText(const TimeSpan& range, bool is_complete, const EventCounts& counts);
std::string NoticeText(NoticeLevel level, const std::string& text);
std::string EndText(const std::string& reason);

// An image of events for a page.
struct PageImage {
  EventImage image;
  int64_t t_us = 0;  // the instant of the outlines
  // The last `num_truths` outlines of image.outlines show the true poses.
  size_t num_truths = 0;
  // True if the events of successive images are disjoint. An image that replaces one that was not sent then contains
  // the events of both.
  bool is_continuation = false;
};
// `skipped` is the number of images that were not sent. The cells are compressed if that makes them smaller.
std::string ToBinary(const PageImage& image, uint64_t number, uint64_t skipped);
std::string ToBinary(const SceneObject& object, const ModelGeometry& geometry);

}  // namespace evpose::client
