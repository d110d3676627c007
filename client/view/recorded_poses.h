// SPDX-License-Identifier: Apache-2.0

// The poses of a recording's objects, from the files that replay and simulate write.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "client/cli/common/pose_format.h"
#include "client/view/page_outbox.h"
#include "core/geometry/trajectory_gaps.h"

namespace evpose::client {

// The poses of one object, in the order of their times.
class RecordedPoses {
 public:
  // Largest number of poses that are sent to a page. Of a longer recording every second, fourth, ... pose is sent. A
  // plot of a screen's width shows no more, and all of them take some megabytes in the browser.
  static constexpr size_t kMaxSent = 20'000;
  // Largest number of state changes that are sent to a page, which lists them. Later ones are left out.
  static constexpr size_t kMaxStates = 4096;

  // Error: INVALID_ARGUMENT if the time of the pose is not later than that of the pose before.
  absl::Status Add(const Pose& pose) { return Add(pose, pose.camera_from_object.Quaternion()); }
  // The same, with the rotation that is sent to pages: the quaternion of the file with all its digits.
  absl::Status Add(const Pose& pose, const Eigen::Quaterniond& rotation);

  // To be called after the last Add(). `has_losses` is that of the file (PoseFileFacts): the object was then lost where
  // the file states it, and otherwise in each gap that is longer than longest_step_us().
  void Finish(bool has_losses);

  const Trajectory& trajectory() const { return trajectory_; }
  // Returns LongestStepUs() of the poses.
  int64_t longest_step_us() const { return longest_step_us_; }
  // Returns the pose at an instant (PoseNear()): none is interpolated over more than LongestInterpolatedStepUs() or
  // over a loss.
  std::optional<RigidTransform> At(int64_t t_us) const {
    return PoseNear(trajectory_, t_us, longest_interpolated_us_, after_losses_);
  }
  // Returns the state of the last pose at or before this time; before the first pose, the state of the first one.
  // Precondition: there is a pose.
  TrackState StateAt(int64_t t_us) const;

  // Appends the messages of the poses, in the frame that the page shows, and, unless they are the truth, of the state
  // changes. The state is LOST as Finish() describes it.
  void AppendFrames(const std::string& object_id, bool is_truth, const PoseFrame& frame,
                    PageOutbox::Prepared& frames) const;

 private:
  // Appends the state LOST before the pose with this index, if the object was lost there. `loss` is null if the file
  // states none there.
  void AppendLoss(size_t index, const Loss* loss,
                  absl::FunctionRef<void(int64_t t_us, const std::string& reason)> append) const;

  Trajectory trajectory_;
  std::vector<TrackState> states_;
  std::vector<Loss> losses_;          // that the file states, each before a pose
  std::vector<size_t> after_losses_;  // the indexes of these poses
  bool has_losses_ = false;
  int64_t longest_step_us_ = LongestStepUs({});
  int64_t longest_interpolated_us_ = LongestInterpolatedStepUs({});
  std::vector<Pose> sent_;  // every `stride_`-th one
  std::vector<Eigen::Quaterniond> sent_rotations_;
  uint64_t stride_ = 1;
};

// Reads the poses of the objects, by ID, from a TUM, CSV or JSON lines file, and converts them to camera_from_object;
// `frame` is that of --world-from-camera. If the path contains "{object}", there is one file for each object. If the
// file has poses of a single ID and there is a single object, they are those of this object whatever the ID. Errors
// name the path: those of VisitPoses() and FrameToCamera(); INVALID_ARGUMENT for poses of an object that is not in
// `object_ids`.
absl::StatusOr<std::map<std::string, RecordedPoses>> ReadRecordedPoses(const std::string& path,
                                                                       const std::vector<std::string>& object_ids,
                                                                       const PoseFrame& frame = {});

}  // namespace evpose::client
