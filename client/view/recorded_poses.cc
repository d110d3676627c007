// SPDX-License-Identifier: Apache-2.0
#include "client/view/recorded_poses.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/common/pose_records.h"
#include "client/lib/messages/core_types.h"
#include "client/view/keep_every_second.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kPosesPerFrame = 256;  // as kPosesPerMessage of page_outbox.cc

// Adds the poses of a file to those of its objects.
absl::Status ReadFileOfPoses(const std::string& path, const std::vector<std::string>& object_ids,
                             const PoseFrame& frame, std::map<std::string, RecordedPoses>& poses) {
  std::optional<std::string> only_id;  // that the file uses
  const auto add = [&](const Pose& pose, const Eigen::Quaterniond& rotation) -> absl::Status {
    if (!only_id) only_id = pose.object_id;
    const bool is_only = object_ids.size() == 1 && pose.object_id == *only_id;
    const auto found = poses.find(is_only ? object_ids[0] : pose.object_id);
    if (found != poses.end()) return found->second.Add(pose, rotation);
    return absl::InvalidArgumentError(absl::StrCat("holds a pose of the object \"", pose.object_id,
                                                   "\", but the objects are ", absl::StrJoin(object_ids, ", "),
                                                   ": give --object ID=MODEL for each object of the file"));
  };
  // The transform of the file, which is the same for all its poses, is known after the last pose.
  EVPOSE_ASSIGN_OR_RETURN(const PoseFileFacts facts,
                          VisitPoses(path, [&](const FilePose& pose) { return add(pose, pose.quaternion); }));
  EVPOSE_ASSIGN_OR_RETURN(const PoseFrame to_camera, FrameToCamera(facts.transform, frame, path));
  if (!to_camera.is_default()) {
    for (auto& [id, each] : poses) each = RecordedPoses();
    const auto add_converted = [&](const Pose& pose) {
      const Pose of_camera = to_camera.Apply(pose);
      return add(of_camera, of_camera.camera_from_object.Quaternion());
    };
    EVPOSE_RETURN_IF_ERROR(VisitPoses(path, add_converted).status());
  }
  for (auto& [id, each] : poses) each.Finish(facts.has_losses);
  return absl::OkStatus();
}

}  // namespace

absl::Status RecordedPoses::Add(const Pose& pose, const Eigen::Quaterniond& rotation) {
  if (!trajectory_.empty() && pose.t_us <= trajectory_.back().t_us) {
    return absl::InvalidArgumentError("its time does not increase");
  }
  if (trajectory_.size() % stride_ == 0) {
    sent_.push_back(pose);
    sent_rotations_.push_back(rotation);
  }
  if (sent_.size() > kMaxSent) {
    KeepEverySecond(sent_);
    KeepEverySecond(sent_rotations_);
    stride_ *= 2;
  }
  // Each pose has the latest loss before it.
  if (pose.latest_loss && (losses_.empty() || losses_.back() != *pose.latest_loss)) {
    losses_.push_back(*pose.latest_loss);
    after_losses_.push_back(trajectory_.size());
  }
  trajectory_.push_back({pose.t_us, ToCore(pose.camera_from_object)});
  states_.push_back(pose.state);
  return absl::OkStatus();
}

void RecordedPoses::Finish(bool has_losses) {
  has_losses_ = has_losses;
  longest_step_us_ = LongestStepUs(trajectory_);
  longest_interpolated_us_ = LongestInterpolatedStepUs(trajectory_);
}

TrackState RecordedPoses::StateAt(int64_t t_us) const {
  const auto after = std::upper_bound(trajectory_.begin(), trajectory_.end(), t_us,
                                      [](int64_t t, const StampedPose& pose) { return t < pose.t_us; });
  return states_[after == trajectory_.begin() ? 0 : static_cast<size_t>(after - trajectory_.begin()) - 1];
}

void RecordedPoses::AppendLoss(size_t index, const Loss* loss,
                               absl::FunctionRef<void(int64_t t_us, const std::string& reason)> append) const {
  const int64_t t_us = trajectory_[index].t_us;
  const int64_t before_us = index == 0 ? std::numeric_limits<int64_t>::min() : trajectory_[index - 1].t_us;
  const int64_t gap_us = index == 0 ? 0 : t_us - before_us;
  // The page replaces a state by that of a pose at the same time.
  const int64_t earliest_us = before_us + 1;
  const std::string gap = absl::StrFormat("no pose for %.3f s", static_cast<double>(gap_us) * 1e-6);
  if (loss == nullptr) {
    if (!has_losses_ && gap_us > longest_step_us_) append(earliest_us, gap);
    return;
  }
  const std::string cause = CauseText(loss->cause);
  // A pose is that of the middle of its window, and a loss is at the end of a window.
  const bool is_between = loss->t_us > before_us && loss->t_us < t_us;
  if (is_between || index > 0) {
    append(is_between ? loss->t_us : earliest_us, index == 0 ? cause : absl::StrCat(cause, "; ", gap));
  }
}

void RecordedPoses::AppendFrames(const std::string& object_id, bool is_truth, const PoseFrame& frame,
                                 PageOutbox::Prepared& frames) const {
  size_t num_states = 0;
  const auto add_state = [&](int64_t t_us, TrackState state, const std::string& reason) {
    if (num_states++ < kMaxStates) frames.push_back({StateText(object_id, t_us, state, reason)});
  };
  size_t next_loss = 0;
  for (size_t i = 0; i < trajectory_.size() && !is_truth; ++i) {
    const bool has_loss = next_loss < losses_.size() && after_losses_[next_loss] == i;
    bool is_new = i == 0 || states_[i] != states_[i - 1];
    AppendLoss(i, has_loss ? &losses_[next_loss] : nullptr, [&](int64_t t_us, const std::string& reason) {
      add_state(t_us, TrackState::kLost, reason);
      is_new = true;
    });
    if (has_loss) ++next_loss;
    if (is_new) add_state(trajectory_[i].t_us, states_[i], "");
  }
  for (size_t first = 0; first < sent_.size(); first += kPosesPerFrame) {
    const auto poses = absl::MakeConstSpan(sent_).subspan(first, kPosesPerFrame);
    if (frame.is_default()) {
      const auto rotations = absl::MakeConstSpan(sent_rotations_).subspan(first, kPosesPerFrame);
      frames.push_back({PosesText(object_id, poses, is_truth, rotations)});
    } else {
      frames.push_back({PosesText(object_id, frame.Apply(poses), is_truth)});
    }
  }
}

absl::StatusOr<std::map<std::string, RecordedPoses>> ReadRecordedPoses(const std::string& path,
                                                                       const std::vector<std::string>& object_ids,
                                                                       const PoseFrame& frame) {
  if (object_ids.size() > 1 && absl::EndsWith(path, ".tum") && !absl::StrContains(path, "{object}")) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": a .tum file has the poses of one object: give the name of one for each object, such as ",
                     "'poses-{object}.tum', or a .csv or .jsonl file"));
  }
  std::map<std::string, RecordedPoses> poses;
  for (const auto& [id, name] : PoseFiles::Paths(path, object_ids)) {
    const std::vector<std::string> ids = id.empty() ? object_ids : std::vector<std::string>{id};
    std::map<std::string, RecordedPoses> of_file;
    for (const std::string& each : ids) of_file[each];
    EVPOSE_RETURN_IF_ERROR(ReadFileOfPoses(name, ids, frame, of_file));
    poses.merge(of_file);
  }
  return poses;
}

}  // namespace evpose::client
