// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pose_reader.h"

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "evpose/types.h"

namespace evpose::client {
namespace {

using Fields = std::vector<absl::string_view>;

constexpr std::array<const char*, 7> kPoseColumns = {"tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw"};
constexpr std::array<const char*, 6> kAxes = {"tx", "ty", "tz", "rx", "ry", "rz"};

// Indices of the columns.
struct Columns {
  size_t count = 0;
  size_t t_us = 0;
  std::array<size_t, 7> pose = {};
  std::vector<size_t> covariance;  // 21, upper triangle row by row; or empty
  std::optional<size_t> object_id;
  std::optional<size_t> state;
  std::optional<size_t> transform;
};

std::optional<size_t> Find(const Fields& header, absl::string_view name) {
  const auto found = std::find(header.begin(), header.end(), name);
  if (found == header.end()) return std::nullopt;
  return static_cast<size_t>(found - header.begin());
}

absl::StatusOr<Columns> FindColumns(const Fields& header, const std::string& path) {
  const auto needed = [&](absl::string_view name) -> absl::StatusOr<size_t> {
    const std::optional<size_t> found = Find(header, name);
    if (found) return *found;
    return absl::InvalidArgumentError(
        absl::StrCat(path, ":1: has no column ", name, "; evpose replay --out writes a CSV that has"));
  };
  Columns columns;
  columns.count = header.size();
  EVPOSE_ASSIGN_OR_RETURN(columns.t_us, needed("t_us"));
  for (size_t i = 0; i < kPoseColumns.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(columns.pose[i], needed(kPoseColumns[i]));
  }
  columns.object_id = Find(header, "object_id");
  columns.state = Find(header, "state");
  columns.transform = Find(header, "transform");
  for (size_t row = 0; row < kAxes.size(); ++row) {
    for (size_t column = row; column < kAxes.size(); ++column) {
      const std::optional<size_t> found = Find(header, absl::StrCat("cov_", kAxes[row], "_", kAxes[column]));
      if (found) columns.covariance.push_back(*found);
    }
  }
  constexpr size_t kUpperNumbers = 21;
  if (columns.covariance.size() != kUpperNumbers) columns.covariance.clear();
  return columns;
}

absl::Status ParseLine(const Columns& columns, const Fields& fields, ReadPoses& poses) {
  if (fields.size() != columns.count) {
    return absl::InvalidArgumentError(absl::StrCat("has ", fields.size(), " fields and not ", columns.count));
  }
  const auto number = [&](size_t index, double& value) {
    return absl::SimpleAtod(fields[index], &value)
               ? absl::OkStatus()
               : absl::InvalidArgumentError(absl::StrCat("\"", fields[index], "\" is no number"));
  };
  if (columns.transform) poses.transform = std::string(fields[*columns.transform]);
  StampedPose pose;
  if (!absl::SimpleAtoi(fields[columns.t_us], &pose.t_us)) {
    return absl::InvalidArgumentError(absl::StrCat("\"", fields[columns.t_us], "\" is no time in microseconds"));
  }
  const bool follows_pose = poses.trajectory.empty() || pose.t_us > poses.trajectory.back().t_us;
  if (!follows_pose || (!poses.ambiguous_us.empty() && pose.t_us <= poses.ambiguous_us.back())) {
    return absl::InvalidArgumentError("its time does not increase");
  }
  std::array<double, 7> v = {};
  for (size_t i = 0; i < v.size(); ++i) EVPOSE_RETURN_IF_ERROR(number(columns.pose[i], v[i]));
  EVPOSE_ASSIGN_OR_RETURN(pose.camera_from_object,
                          MakeRigidTransform({v[0], v[1], v[2]}, Eigen::Quaterniond(v[6], v[3], v[4], v[5])));
  if (columns.state && fields[*columns.state] == std::string(TrackStateName(TrackState::kAmbiguous))) {
    poses.ambiguous_us.push_back(pose.t_us);
    return absl::OkStatus();
  }
  poses.trajectory.push_back(pose);
  if (columns.covariance.empty()) return absl::OkStatus();
  Matrix6d covariance;
  size_t next = 0;
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) {
      double value = 0.0;
      EVPOSE_RETURN_IF_ERROR(number(columns.covariance[next++], value));
      covariance(row, column) = covariance(column, row) = value;
    }
  }
  poses.covariances.push_back(covariance);
  return absl::OkStatus();
}

// The transform that the first line of a TUM file states; camera_from_object for a file without such a line.
std::string TransformOfTum(absl::string_view text) {
  const absl::string_view line = text.substr(0, text.find('\n'));
  const size_t comma = line.find(',');
  if (!absl::StartsWith(line, "# ") || comma == absl::string_view::npos) return kCameraFromObject;
  const absl::string_view name = line.substr(2, comma - 2);
  const bool is_transform = absl::StrContains(name, "_from_") && !absl::StrContains(name, ' ');
  return std::string(is_transform ? name : absl::string_view(kCameraFromObject));
}

}  // namespace

absl::StatusOr<ReadPoses> ParsePoseCsv(absl::string_view text, const std::string& name_for_errors) {
  ReadPoses poses;
  std::optional<Columns> columns;
  absl::string_view object;
  int line_number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++line_number;
    line = absl::StripSuffix(line, "\r");
    if (line.empty()) continue;
    const Fields fields = absl::StrSplit(line, ',');
    if (!columns) {
      EVPOSE_ASSIGN_OR_RETURN(columns, FindColumns(fields, name_for_errors));
      continue;
    }
    if (const absl::Status status = ParseLine(*columns, fields, poses); !status.ok()) {
      return absl::Status(status.code(), absl::StrCat(name_for_errors, ":", line_number, ": ", status.message()));
    }
    if (!columns->object_id) continue;
    const absl::string_view id = fields[*columns->object_id];
    if (poses.trajectory.size() + poses.ambiguous_us.size() > 1 && id != object) {
      return absl::InvalidArgumentError(absl::StrCat(name_for_errors, ":", line_number, ": holds poses of ", object,
                                                     " and of ", id, "; keep those of one object"));
    }
    object = id;
  }
  return poses;
}

absl::StatusOr<ReadPoses> ReadPoseFile(const std::string& path) {
  constexpr size_t kMaxBytes = size_t{4} << 30;  // more than an hour of poses at 1 kHz with covariances
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxBytes));
  if (absl::EndsWith(path, ".csv")) return ParsePoseCsv(text, path);
  ReadPoses poses;
  EVPOSE_ASSIGN_OR_RETURN(poses.trajectory, ParseTumTrajectory(text, path));
  poses.transform = TransformOfTum(text);
  return poses;
}

absl::StatusOr<ReadPoses> ReadCameraPoses(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(ReadPoses poses, ReadPoseFile(path));
  if (poses.transform == kCameraFromObject) return poses;
  if (poses.transform != kObjectFromCamera) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": its poses are ", poses.transform, "; give those of a run ",
                                                   "without --world-from-camera"));
  }
  for (size_t i = 0; i < poses.trajectory.size(); ++i) {
    RigidTransform& pose = poses.trajectory[i].camera_from_object;
    if (!poses.covariances.empty()) {
      const Matrix6d jacobian = JacobianOfInverse(pose);
      poses.covariances[i] = (jacobian * poses.covariances[i] * jacobian.transpose()).eval();
    }
    pose = pose.Inverse();
  }
  poses.transform = kCameraFromObject;
  return poses;
}

}  // namespace evpose::client
