// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/trajectory.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "core/base/output_file.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

constexpr size_t kMaxTrajectoryBytes = size_t{2} << 30;  // bounds memory; an hour at 1 kHz has 0.5 GB
// Larger than Unix time until 2096; a double resolves 0.5 us there. Larger numbers are in other units.
constexpr double kMaxTimeSeconds = 4e9;
constexpr std::array<absl::string_view, 7> kPoseFields = {"tx", "ty", "tz", "qx", "qy", "qz", "qw"};

// A finite number.
absl::StatusOr<double> ParseNumber(absl::string_view field, absl::string_view text) {
  double value = 0.0;
  if (!absl::SimpleAtod(text, &value) || !std::isfinite(value)) {
    return absl::InvalidArgumentError(absl::StrCat(field, " is not a finite number: ", Quoted(text)));
  }
  return value;
}

// The pose of seven fields in the order of kPoseFields.
absl::StatusOr<RigidTransform> ParsePoseFields(absl::Span<const absl::string_view> fields) {
  std::array<double, 7> values = {};
  for (size_t i = 0; i < values.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(values[i], ParseNumber(kPoseFields[i], fields[i]));
  }
  return MakeRigidTransform(Eigen::Vector3d(values[0], values[1], values[2]),
                            Eigen::Quaterniond(values[6], values[3], values[4], values[5]));
}

std::vector<absl::string_view> SplitFields(absl::string_view line) {
  return absl::StrSplit(line, absl::ByAnyChar(" \t\r,"), absl::SkipEmpty());
}

absl::StatusOr<StampedPose> ParseTumLine(absl::string_view line) {
  const std::vector<absl::string_view> fields = SplitFields(line);
  if (fields.size() != 1 + kPoseFields.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat(fields.size(), " numbers instead of the 8 of \"timestamp tx ty tz qx qy qz qw\""));
  }
  EVPOSE_ASSIGN_OR_RETURN(const double t_s, ParseNumber("timestamp", fields[0]));
  if (std::abs(t_s) > kMaxTimeSeconds) {
    return absl::InvalidArgumentError(absl::StrCat("timestamp ", fields[0], " is too large; give seconds"));
  }
  StampedPose pose;
  pose.t_us = std::llround(t_s * 1e6);
  EVPOSE_ASSIGN_OR_RETURN(pose.camera_from_object, ParsePoseFields(absl::MakeConstSpan(fields).subspan(1)));
  return pose;
}

absl::Status AtLine(const std::string& name, size_t line_number, const absl::Status& status) {
  return absl::Status(status.code(), absl::StrCat(name, ":", line_number, ": ", status.message()));
}

}  // namespace

absl::StatusOr<Trajectory> ParseTumTrajectory(absl::string_view text, const std::string& name_for_errors) {
  Trajectory trajectory;
  size_t line_number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++line_number;
    line = absl::StripAsciiWhitespace(line);
    if (line.empty() || line.front() == '#') continue;
    absl::StatusOr<StampedPose> pose = ParseTumLine(line);
    if (!pose.ok()) return AtLine(name_for_errors, line_number, pose.status());
    if (!trajectory.empty() && pose->t_us <= trajectory.back().t_us) {
      return AtLine(name_for_errors, line_number,
                    absl::InvalidArgumentError(absl::StrFormat("time does not increase: %.6f s after %.6f s",
                                                               pose->t_us * 1e-6, trajectory.back().t_us * 1e-6)));
    }
    trajectory.push_back(*pose);
  }
  return trajectory;
}

absl::StatusOr<Trajectory> ReadTumTrajectory(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxTrajectoryBytes));
  return ParseTumTrajectory(text, path);
}

std::string TumLine(const StampedPose& pose) {
  const Eigen::Vector3d& t = pose.camera_from_object.translation_m;
  const Eigen::Quaterniond q = pose.camera_from_object.Quaternion();
  const int64_t seconds = pose.t_us / 1'000'000;
  const int64_t micros = std::abs(pose.t_us % 1'000'000);
  const char* sign = pose.t_us < 0 ? "-" : "";
  return absl::StrFormat("%s%d.%06d %.17g %.17g %.17g %.17g %.17g %.17g %.17g", sign, std::abs(seconds), micros, t.x(),
                         t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
}

absl::Status WriteTumTrajectory(const std::string& path, const Trajectory& trajectory) {
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(path));
  for (const StampedPose& pose : trajectory) EVPOSE_RETURN_IF_ERROR(file.Append(TumLine(pose) + "\n"));
  return file.Commit();
}

absl::StatusOr<RigidTransform> ParsePose(const std::string& text) {
  std::string line = text;
  std::replace(line.begin(), line.end(), '\n', ' ');
  const std::vector<absl::string_view> fields = SplitFields(line);
  if (fields.size() < kPoseFields.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("the pose \"", text, "\" has ", fields.size(),
                     " of the 7 numbers \"tx ty tz qx qy qz qw\": ", kPoseFields[fields.size()], " is missing"));
  }
  if (fields.size() > kPoseFields.size()) {
    return absl::InvalidArgumentError(absl::StrCat("the pose \"", text, "\" has ", fields.size(),
                                                   " numbers instead of the 7 \"tx ty tz qx qy qz qw\""));
  }
  absl::StatusOr<RigidTransform> pose = ParsePoseFields(fields);
  if (pose.ok()) return pose;
  return absl::InvalidArgumentError(absl::StrCat("the pose \"", text, "\": ", pose.status().message()));
}

absl::StatusOr<RigidTransform> Interpolate(const Trajectory& trajectory, int64_t t_us) {
  if (trajectory.empty()) return absl::OutOfRangeError("the trajectory is empty");
  if (t_us < trajectory.front().t_us || t_us > trajectory.back().t_us) {
    return absl::OutOfRangeError(absl::StrFormat("%.6f s lies outside the trajectory, %.6f to %.6f s", t_us * 1e-6,
                                                 trajectory.front().t_us * 1e-6, trajectory.back().t_us * 1e-6));
  }
  const auto after = std::lower_bound(trajectory.begin(), trajectory.end(), t_us,
                                      [](const StampedPose& pose, int64_t t) { return pose.t_us < t; });
  if (after->t_us == t_us) return after->camera_from_object;
  const StampedPose& a = *(after - 1);
  const StampedPose& b = *after;
  const double ratio = static_cast<double>(t_us - a.t_us) / static_cast<double>(b.t_us - a.t_us);
  const Vector6d screw = LogSe3(b.camera_from_object * a.camera_from_object.Inverse());
  return ExpSe3(ratio * screw) * a.camera_from_object;
}

std::optional<RigidTransform> PoseNear(const Trajectory& trajectory, int64_t t_us, int64_t max_gap_us) {
  const auto after = std::lower_bound(trajectory.begin(), trajectory.end(), t_us,
                                      [](const StampedPose& pose, int64_t t) { return pose.t_us < t; });
  if (trajectory.empty()) return std::nullopt;
  if (after == trajectory.begin() || after == trajectory.end()) {
    const StampedPose& nearest = after == trajectory.begin() ? trajectory.front() : trajectory.back();
    if (std::abs(nearest.t_us - t_us) > max_gap_us) return std::nullopt;
    return nearest.camera_from_object;
  }
  if (after->t_us != t_us && after->t_us - (after - 1)->t_us > max_gap_us) return std::nullopt;
  const absl::StatusOr<RigidTransform> pose = Interpolate(trajectory, t_us);
  return pose.ok() ? std::optional(*pose) : std::nullopt;
}

}  // namespace evpose
