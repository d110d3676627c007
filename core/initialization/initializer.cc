// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/initializer.h"

#include <cmath>
#include <optional>
#include <utility>

#include "core/geometry/projected_line.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

ImageSegment AtMiddle(const DetectedLine& line) {
  return {0.5 * (line.at_begin.p1_px + line.at_end.p1_px), 0.5 * (line.at_begin.p2_px + line.at_end.p2_px)};
}

// Adds the displacement `begin_px` to `end_px` of a point that moves with the line.
void AddDisplacement(const CameraModel& camera, const ProjectedLine& line, const Eigen::Vector2d& begin_px,
                     const Eigen::Vector2d& end_px, double duration_s, double sigma_px_per_s,
                     TwistEquations& equations) {
  // The distance d = a . b is positive on the side to which this normal points.
  const Eigen::Vector2d normal = Eigen::Vector2d(line.a.x() / camera.fx_px, line.a.y() / camera.fy_px).normalized();
  const double velocity_px_per_s = normal.dot(end_px - begin_px) / duration_s;
  const Eigen::Vector3d bearing = BearingOf(camera, 0.5 * (begin_px + end_px));
  const Vector6d row = -(line.jacobian.transpose() * bearing);  // a . b_dot = -a_dot . b on the line, by the twist
  equations.Add(row, velocity_px_per_s, 1.0 / (sigma_px_per_s * sigma_px_per_s));
}

// Returns the upper quartile: an edge that slides along itself has no normal motion, however fast the object is.
double MotionPx(const LineDetection& detection) {
  const double duration_s = static_cast<double>(detection.t_end_us - detection.t_begin_us) * 1e-6;
  std::vector<double> motion_px;
  for (const DetectedLine& line : detection.lines) {
    motion_px.push_back(std::abs(line.normal_velocity_px_per_s) * duration_s);
  }
  if (motion_px.empty()) return 0.0;
  return UpperQuantile(motion_px, 0.75);
}

}  // namespace

TwistEstimate EstimateTwist(const ObjectModel& model, const CameraModel& camera,
                            const RigidTransform& camera_from_object, const LineDetection& detection,
                            absl::Span<const int> model_line, const InitializerOptions& options) {
  const double duration_s = static_cast<double>(detection.t_end_us - detection.t_begin_us) * 1e-6;
  const double m_per_px = camera_from_object.translation_m.norm() / camera.fx_px;
  TwistEquations equations;
  equations.AddPrior(options.twist_prior, m_per_px);
  for (size_t j = 0; duration_s > 0.0 && j < model_line.size(); ++j) {
    if (model_line[j] < 0) continue;
    const ModelLine& line = model.lines[model_line[j]];
    const std::optional<ProjectedLine> projected = ProjectLine(camera, camera_from_object, line.p1, line.p2);
    if (!projected) continue;
    const DetectedLine& detected = detection.lines[j];
    // The positions at both ends of the interval have independent errors.
    constexpr double kSqrt2 = 1.4142135623730951;
    const double sigma_px_per_s = kSqrt2 * options.line_error_px / duration_s;
    AddDisplacement(camera, *projected, detected.at_begin.p1_px, detected.at_end.p1_px, duration_s, sigma_px_per_s,
                    equations);
    AddDisplacement(camera, *projected, detected.at_begin.p2_px, detected.at_end.p2_px, duration_s, sigma_px_per_s,
                    equations);
  }
  return equations.Solve();
}

PoseInitializer::PoseInitializer(std::shared_ptr<const ObjectModel> model, const CameraModel& camera,
                                 std::vector<std::shared_ptr<LineDetector>> detectors,
                                 std::unique_ptr<PoseSearch> search, std::unique_ptr<TemplateSearch> templates)
    : model_(std::move(model)),
      camera_(camera),
      detectors_(std::move(detectors)),
      search_(std::move(search)),
      templates_(std::move(templates)) {}

bool PoseInitializer::IsPlausible(const PoseHypothesis& hypothesis) const {
  return hypothesis.expected_false_alarms <= options_.max_false_alarms;
}

FirstPoses PoseInitializer::Find(absl::Span<const PixelEvent> events) {
  FirstPoses first;
  for (size_t i = 0; search_ != nullptr && i < detectors_.size() && first.poses.empty(); ++i) {
    const FirstPoses found = FindByLines(events, *detectors_[i]);
    // Of searches without a pose, the one that came nearest to one is reported.
    const bool is_nearer = found.has_moved == first.has_moved ? found.num_lines > first.num_lines : found.has_moved;
    if (i == 0 || is_nearer || !found.poses.empty()) first = found;
  }
  if (templates_ != nullptr) FindByContours(events, first);
  return first;
}

void PoseInitializer::FindByContours(absl::Span<const PixelEvent> events, FirstPoses& first) {
  first.uses_contours = true;
  std::vector<PoseProposal> proposals;
  for (const FirstPose& pose : first.poses) proposals.push_back({pose.t_us, pose.camera_from_object, pose.twist});
  const TemplateMatches found = templates_->Find(events, proposals);
  first.has_moved = first.has_moved || found.has_moved;
  if (found.matches.empty()) return;
  first.poses.clear();
  for (const TemplateMatch& match : found.matches) {
    first.poses.push_back({found.t_us, match.camera_from_object, match.motion.twist, match.motion.covariance});
  }
}

FirstPoses PoseInitializer::FindByLines(absl::Span<const PixelEvent> events, LineDetector& detector) {
  const LineDetection detection = detector.Detect(events);
  std::vector<ImageSegment> segments;
  for (const DetectedLine& line : detection.lines) segments.push_back(AtMiddle(line));
  FirstPoses first;
  first.num_lines = static_cast<int>(segments.size());
  first.motion_px = MotionPx(detection);
  first.has_moved = first.motion_px >= options_.min_motion_px;
  if (!first.has_moved) return first;
  const std::vector<PoseHypothesis> hypotheses = search_->Search(segments);
  for (const PoseHypothesis& hypothesis : hypotheses) {
    if (!IsPlausible(hypothesis.is_near_symmetric ? hypotheses.front() : hypothesis)) continue;
    const TwistEstimate motion =
        EstimateTwist(*model_, camera_, hypothesis.camera_from_object, detection, hypothesis.model_line, options_);
    first.poses.push_back({detection.t_begin_us + (detection.t_end_us - detection.t_begin_us) / 2,
                           hypothesis.camera_from_object, motion.twist, motion.covariance});
  }
  return first;
}

}  // namespace evpose
