// SPDX-License-Identifier: Apache-2.0
#include "core/detection/detection_trial_testing.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/geometry/projected_line.h"
#include "core/geometry/undistortion_table.h"
#include "core/models/visibility.h"
#include "core/simulation/simulator.h"

namespace evpose::testing {
namespace {

constexpr double kMaxDistancePx = 1.5;
constexpr double kMaxAngleRad = 2.0 * std::numbers::pi / 180.0;
constexpr double kMinMotionPx = 3.0;
constexpr double kMinLengthPx = 15.0;
constexpr double kMinOverlapRatio = 0.7;

struct VisibleEdge {
  ImageSegment segment;
  double motion_px = 0.0;  // motion since the beginning
};

Eigen::Vector2d Direction(const ImageSegment& segment) { return (segment.p2_px - segment.p1_px).normalized(); }

// The unit normal (-dy, dx) of the direction (dx, dy).
double SignedDistance(const ImageSegment& line, const Eigen::Vector2d& point) {
  const Eigen::Vector2d d = Direction(line), r = point - line.p1_px;
  return d.x() * r.y() - d.y() * r.x();
}

std::vector<VisibleEdge> VisibleEdges(const ObjectRecording& recording, int64_t t_begin_us, int64_t t_end_us) {
  const auto pose_at = [&recording](int64_t t_us) { return Interpolate(recording.truth, t_us).value(); };
  const RigidTransform at_end = pose_at(t_end_us), at_begin = pose_at(t_begin_us);
  const VisibilityTester tester(recording.model, {});
  std::vector<VisibleEdge> edges;
  for (const VisibleSegment& visible : tester.VisibleSegments(recording.camera, at_end)) {
    const ModelLine& line = recording.model.lines[visible.line];
    const Eigen::Vector3d extent = line.p2 - line.p1;
    const auto project = [&](const RigidTransform& pose) {
      const auto projected =
          ProjectLine(recording.camera, pose, line.p1 + visible.begin * extent, line.p1 + visible.end * extent);
      return projected ? ImageSegment{projected->p1_px, projected->p2_px} : ImageSegment{};
    };
    const ImageSegment now = project(at_end), before = project(at_begin);
    if (now.length_px() < 1.0 || before.length_px() < 1.0) continue;
    edges.push_back({now, std::abs(SignedDistance(before, 0.5 * (now.p1_px + now.p2_px)))});
  }
  return edges;
}

// Returns the range along `edge`, from its first end, that `line` covers; empty if `line` does not lie on `edge`.
std::pair<double, double> Covered(const ImageSegment& edge, const ImageSegment& line) {
  const Eigen::Vector2d along = Direction(edge), d = Direction(line);
  if (std::abs(along.x() * d.y() - along.y() * d.x()) > std::sin(kMaxAngleRad)) return {0.0, 0.0};
  double s1 = along.dot(line.p1_px - edge.p1_px), s2 = along.dot(line.p2_px - edge.p1_px);
  if (s1 > s2) std::swap(s1, s2);
  s1 = std::max(s1, 0.0);
  s2 = std::min(s2, edge.length_px());
  if (s1 >= s2) return {0.0, 0.0};
  for (const double s : {s1, s2}) {
    if (std::abs(SignedDistance(line, edge.p1_px + s * along)) > kMaxDistancePx) return {0.0, 0.0};
  }
  return {s1, s2};
}

double UnionLength(std::vector<std::pair<double, double>> pieces) {
  std::sort(pieces.begin(), pieces.end());
  double length = 0.0, reached = -1e9;
  for (const auto& [begin, end] : pieces) {
    length += std::max(0.0, end - std::max(begin, reached));
    reached = std::max(reached, end);
  }
  return length;
}

void ScoreLine(const std::vector<VisibleEdge>& edges, const DetectedLine& detected, DetectionScore& score) {
  const ImageSegment& line = detected.at_end;
  const VisibleEdge* best = nullptr;
  double best_px = 0.0;
  std::vector<std::pair<double, double>> on_line;
  for (const VisibleEdge& edge : edges) {
    const auto [begin, end] = Covered(edge.segment, line);
    if (end <= begin) continue;
    const Eigen::Vector2d along = Direction(edge.segment), d = Direction(line);
    double s1 = d.dot(edge.segment.p1_px + begin * along - line.p1_px);
    double s2 = d.dot(edge.segment.p1_px + end * along - line.p1_px);
    if (s1 > s2) std::swap(s1, s2);
    on_line.emplace_back(s1, s2);
    if (end - begin <= best_px) continue;
    best_px = end - begin;
    best = &edge;
  }
  ++score.num_detected;
  if (best == nullptr || UnionLength(on_line) < kMinOverlapRatio * line.length_px()) return;
  ++score.num_right;
  const double d1 = SignedDistance(best->segment, line.p1_px), d2 = SignedDistance(best->segment, line.p2_px);
  const bool same_way = Direction(best->segment).dot(Direction(line)) > 0.0;
  const double motion = detected.normal_velocity_px_per_s * (same_way ? 1.0 : -1.0);
  score.offset_px.push_back(0.5 * (d1 + d2) * (motion < 0.0 ? -1.0 : 1.0));
  score.error_px.push_back(std::sqrt(0.5 * (d1 * d1 + d2 * d2)));
  const Eigen::Vector2d along = Direction(best->segment);
  const double s1 = along.dot((same_way ? line.p1_px : line.p2_px) - best->segment.p1_px);
  const double s2 = along.dot((same_way ? line.p2_px : line.p1_px) - best->segment.p1_px);
  score.beyond_end_px.push_back(-s1);
  score.beyond_end_px.push_back(s2 - best->segment.length_px());
}

}  // namespace

ObjectRecording RecordObject(const std::string& object, double speed_scale, int64_t duration_us, uint64_t seed) {
  SimulationOptions options = SimulationPreset(object, "evk4", speed_scale).value();
  options.sensor.noise_ratio = 0.05;
  options.duration_us = duration_us;
  options.seed = seed;
  ObjectRecording recording = {options.camera, SimulatedModel(options).value(), SimulatedTruth(options), {}};
  const UndistortionTable table = UndistortionTable::Create(options.camera).value();
  const auto status = Simulate(options, [&](absl::Span<const Event> events) {
    for (const Event& event : events) {
      const Eigen::Vector2f& bearing = table.Bearing(event.x, event.y);
      recording.events.push_back(
          {event.t_us, static_cast<float>(options.camera.fx_px * bearing.x() + options.camera.cx_px),
           static_cast<float>(options.camera.fy_px * bearing.y() + options.camera.cy_px), event.polarity});
    }
    return absl::OkStatus();
  });
  if (!status.ok()) recording.events.clear();
  return recording;
}

absl::Span<const PixelEvent> EventsUntil(const ObjectRecording& recording, int64_t t_us, size_t max_events) {
  const auto end = std::upper_bound(recording.events.begin(), recording.events.end(), t_us,
                                    [](int64_t t, const PixelEvent& event) { return t < event.t_us; });
  const absl::Span<const PixelEvent> events =
      absl::MakeConstSpan(recording.events).subspan(0, end - recording.events.begin());
  return events.size() > max_events ? events.subspan(events.size() - max_events) : events;
}

void DetectionScore::Add(const DetectionScore& other) {
  visible_px += other.visible_px;
  covered_px += other.covered_px;
  num_detected += other.num_detected;
  num_right += other.num_right;
  offset_px.insert(offset_px.end(), other.offset_px.begin(), other.offset_px.end());
  error_px.insert(error_px.end(), other.error_px.begin(), other.error_px.end());
  beyond_end_px.insert(beyond_end_px.end(), other.beyond_end_px.begin(), other.beyond_end_px.end());
}

DetectionScore Score(const ObjectRecording& recording, const LineDetection& detection, int64_t t_begin_us) {
  DetectionScore score;
  const std::vector<VisibleEdge> edges = VisibleEdges(recording, t_begin_us, detection.t_end_us);
  for (const VisibleEdge& edge : edges) {
    if (edge.motion_px < kMinMotionPx || edge.segment.length_px() < kMinLengthPx) continue;
    std::vector<std::pair<double, double>> covered;
    for (const DetectedLine& line : detection.lines) covered.push_back(Covered(edge.segment, line.at_end));
    score.visible_px += edge.segment.length_px();
    score.covered_px += UnionLength(covered);
  }
  for (const DetectedLine& line : detection.lines) ScoreLine(edges, line, score);
  return score;
}

}  // namespace evpose::testing
