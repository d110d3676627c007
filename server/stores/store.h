// Where models and poses are kept. Sessions and services see this interface only; each kind of store is one class.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "absl/types/span.h"
#include "core/models/object_model.h"
#include "core/tracking/tracker.h"

namespace evpose::server {

// A pose as a session made it.
struct StoredPose {
  uint64_t pose_seq = 0;      // 1, 2, 3, ... in the session
  uint32_t object_index = 0;  // in the session's configuration
  PoseEstimate estimate;
  int64_t latency_us = 0;  // from the receipt of the chunk that completed the window
};

// The poses of one session, in order. Thread-safe.
class PoseLog {
 public:
  virtual ~PoseLog() = default;

  // `poses` continue the log: the first has the number after the last one's. Errors: FAILED_PRECONDITION when not.
  virtual absl::Status Append(absl::Span<const StoredPose> poses) = 0;

  // At most `max_poses` of those numbered above `after_pose_seq`, from the oldest that is still kept. Empty: no such
  // pose yet. The first one's number tells whether poses between were forgotten.
  virtual absl::StatusOr<std::vector<StoredPose>> Read(uint64_t after_pose_seq, size_t max_poses) const = 0;

  // The number of the oldest pose that Read can give; one above the last when there is none.
  virtual uint64_t first_pose_seq() const = 0;
};

// A model's file and how it is to be read.
struct ModelRecord {
  std::string name;  // "models/{id}"
  ModelFormat format = ModelFormat::kObj;
  double metres_per_unit = 1.0;
  double crease_angle_deg = 30.0;
  absl::Time create_time;
  std::shared_ptr<const std::vector<uint8_t>> bytes;
};

// Thread-safe.
class Store {
 public:
  virtual ~Store() = default;

  virtual absl::string_view kind() const = 0;  // "memory"
  virtual size_t pose_log_capacity() const = 0;

  // All models, in the order of their names.
  virtual absl::StatusOr<std::vector<ModelRecord>> ReadModels() const = 0;
  // Putting a name again changes nothing.
  virtual absl::Status PutModel(const ModelRecord& model) = 0;
  // Deleting what is not there is OK.
  virtual absl::Status DeleteModel(absl::string_view name) = 0;

  // Errors: ALREADY_EXISTS.
  virtual absl::StatusOr<std::shared_ptr<PoseLog>> CreatePoseLog(const std::string& session) = 0;
  // Deleting what is not there is OK. Who holds the log may read on.
  virtual absl::Status DeletePoseLog(absl::string_view session) = 0;
};

}  // namespace evpose::server
