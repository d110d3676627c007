// SPDX-License-Identifier: Apache-2.0

// The poses of a recording's objects, from the files that replay and simulate write.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/view/page_outbox.h"
#include "core/geometry/trajectory.h"

namespace evpose::client {

// The poses of one object, in the order of their times.
class RecordedPoses {
 public:
  // Longest time between two poses that is interpolated; in a longer one the object was lost.
  static constexpr int64_t kMaxGapUs = 50'000;
  // Most poses that are sent to a page with all their fields; of a longer recording, every second, fourth, ... pose.
  static constexpr size_t kMaxSent = 20'000;
  // Most state changes that are sent to a page; later ones are left out.
  static constexpr size_t kMaxStates = 4096;

  // Error: INVALID_ARGUMENT if its time does not follow that of the pose before.
  absl::Status Add(const Pose& pose) { return Add(pose, pose.camera_from_object.Quaternion()); }
  // With the rotation as its file states it, which is sent to pages.
  absl::Status Add(const Pose& pose, const Eigen::Quaterniond& rotation);

  const Trajectory& trajectory() const { return trajectory_; }
  // The pose at an instant (PoseNear()).
  std::optional<RigidTransform> At(int64_t t_us) const { return PoseNear(trajectory_, t_us, kMaxGapUs); }
  // The state of the last pose until then; that of the first one before it. Precondition: there is a pose.
  TrackState StateAt(int64_t t_us) const;

  // Messages of the poses and, unless they are the truth, of the states, with LOST in the gaps.
  void AppendFrames(const std::string& object_id, bool is_truth, PageOutbox::Prepared& frames) const;

 private:
  Trajectory trajectory_;
  std::vector<TrackState> states_;
  std::vector<Pose> sent_;  // every `stride_`-th one
  std::vector<Eigen::Quaterniond> sent_rotations_;
  uint64_t stride_ = 1;
};

// Reads the poses camera_from_object of the objects, by ID, from a TUM, CSV or JSON lines file, or with "{object}" in
// the path from one file for each. Errors name the path: those of VisitPoses() and AsCameraFromObject();
// INVALID_ARGUMENT for poses of an object that is none of `object_ids`, except that a single object has the poses of
// the only one of the file.
absl::StatusOr<std::map<std::string, RecordedPoses>> ReadRecordedPoses(const std::string& path,
                                                                       const std::vector<std::string>& object_ids);

}  // namespace evpose::client
