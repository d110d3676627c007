// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bench/bench_tracking_output.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

// More intervals than a picture of the trace has pixels.
constexpr int64_t kTraceIntervals = 1200;

struct TracePoint {
  int64_t t_us = 0;
  RigidTransform pose;
  double position_of_depth = 0.0;
  double rotation_rad = 0.0;
  double nees = 0.0;
};

void AppendPose(const TrackingBenchBlock& block, const std::string& estimator, int64_t t_us, const RigidTransform& pose,
                std::string& text) {
  const Trajectory& truth = block.truth;
  const Eigen::Vector3d& position = pose.translation_m;
  const Eigen::Matrix3d& first = truth.front().camera_from_object.rotation;
  const Eigen::Vector3d rotation_deg = kDegreesPerRadian * LogSo3(pose.rotation * first.transpose());
  absl::StrAppendFormat(&text, "%s,%s,%.6f,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g", block.scenario.name, estimator,
                        1e-6 * static_cast<double>(t_us - truth.front().t_us), position.x(), position.y(), position.z(),
                        rotation_deg.x(), rotation_deg.y(), rotation_deg.z());
}

// Empty for a value that does not exist.
void AppendNumber(double value, std::string& text) {
  absl::StrAppend(&text, ",", std::isfinite(value) ? absl::StrFormat("%.6g", value) : "");
}

std::vector<TracePoint> Downsample(const TrackingScore& score, const Trajectory& truth) {
  const int64_t begin_us = truth.front().t_us;
  const int64_t interval_us = std::max<int64_t>(1, (truth.back().t_us - begin_us) / kTraceIntervals);
  std::vector<TracePoint> points;
  int64_t interval = -1;
  for (size_t i = 0; i < score.errors.size(); ++i) {
    const TrajectoryError& error = score.errors[i];
    const int64_t now = (error.t_us - begin_us) / interval_us;
    if (now != interval) {
      const absl::StatusOr<RigidTransform> true_pose = Interpolate(truth, error.t_us);
      if (!true_pose.ok()) continue;
      interval = now;
      // error.true_pose is the equivalent true pose nearest to the estimate; the product is the estimate in the branch
      // of the truth.
      points.push_back({error.t_us, error.estimated_pose * error.true_pose.Inverse() * *true_pose, 0.0, 0.0, 0.0});
    }
    TracePoint& point = points.back();
    point.position_of_depth = std::max(point.position_of_depth, error.position_of_depth);
    point.rotation_rad = std::max(point.rotation_rad, error.rotation_rad);
    point.nees = std::max(point.nees, score.nees[i]);
  }
  return points;
}

}  // namespace

std::string TrackingTraceHeader() {
  return "scenario,estimator,time_s,x_m,y_m,z_m,rotation_x_deg,rotation_y_deg,rotation_z_deg,position_of_depth_percent,"
         "rotation_error_deg,nees\n";
}

std::string TrackingTraces(const TrackingBenchBlock& block) {
  std::string text;
  const Trajectory& truth = block.truth;
  const size_t step = 1 + truth.size() / static_cast<size_t>(kTraceIntervals);
  for (size_t i = 0; i < truth.size(); i += step) {
    AppendPose(block, "truth", truth[i].t_us, truth[i].camera_from_object, text);
    text += ",,,\n";
  }
  for (const TrackingBenchRow& row : block.rows) {
    for (const TracePoint& point : Downsample(row.scores.front(), truth)) {
      AppendPose(block, row.estimator, point.t_us, point.pose, text);
      AppendNumber(100.0 * point.position_of_depth, text);
      AppendNumber(kDegreesPerRadian * point.rotation_rad, text);
      AppendNumber(point.nees, text);
      text += "\n";
    }
  }
  return text;
}

}  // namespace evpose::client
