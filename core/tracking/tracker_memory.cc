// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/tracker_memory.h"

#include <algorithm>
#include <set>

#include "core/association/association.h"
#include "core/detection/line_detector.h"
#include "core/tracking/tracker_options.h"
#include "core/windows/pixel_history.h"

namespace evpose {
namespace {

// Detection, once for all objects: two hash tables of 1 MB, the points and neighbours of at most 5000 points of each
// polarity, and the events of the stretch.
constexpr uint64_t kDetectionBytes = 14u << 20;
// Pose search of an object: 24,000 rotations and 120,000 votes at most (PoseSearchOptions), the vectors that hold them
// with twice their capacity.
constexpr uint64_t kSearchBytes = 6u << 20;
// A hypothesis: observations of its events, the same by line, and the sums of its estimator.
constexpr uint64_t kTrackBytes = 400u << 10;
// A line of the model in a hypothesis: image lines with their Jacobians and statistics, twice the capacity.
constexpr uint64_t kTrackLineBytes = 2500;
// A line of the model in the past states of an object, which other objects need: 80 bytes in at most 400 windows of the
// search's memory, half of the lines being visible.
constexpr uint64_t kPastLineBytes = 16u << 10;
// A triangle in a search tree (VisibilityTester), and a line or a vertex with a triangle in a model.
constexpr uint64_t kTreeTriangleBytes = 160;
constexpr uint64_t kModelLineBytes = 400;
constexpr uint64_t kModelTriangleBytes = 40;
// The region and the normals of a triangle of a smooth surface, and a segment of a curved edge.
constexpr uint64_t kModelSurfaceBytes = 40;
constexpr uint64_t kModelSegmentBytes = 72;
// A cell of 64 x 64 pixels: its page in a grid, and its background rate.
constexpr uint64_t kCellBytes = 64;
constexpr uint64_t kPageBytes = 1024;

// Without the model itself.
uint64_t ObjectBytes(const ObjectModel& model, uint64_t num_cells, bool has_others, const TrackerOptions& options) {
  // Challengers are followed separately until they join.
  const auto num_tracks = static_cast<uint64_t>(std::max(1, 3 * options.initialization.max_candidates));
  const uint64_t num_lines = model.lines.size();
  uint64_t bytes = kSearchBytes + kTreeTriangleBytes * model.triangles.size();
  bytes += static_cast<uint64_t>(options.initialization.max_events) * sizeof(WindowEvent);
  bytes += num_tracks * (kTrackBytes + kTrackLineBytes * num_lines + kCellBytes * num_cells);
  bytes += 2 * kPageBytes * num_cells;
  if (has_others) bytes += kPastLineBytes * num_lines + (kCellBytes + kPageBytes) * num_cells;  // Competitors
  return bytes;
}

uint64_t ModelBytes(const ObjectModel& model) {
  uint64_t num_segments = 0;
  for (const EdgeCurve& curve : model.curves) num_segments += curve.points.size();
  // The second tree is that of the SearchModel.
  return kModelSurfaceBytes * model.surface.region_of.size() + kModelSegmentBytes * num_segments +
         kModelLineBytes * model.lines.size() + kModelTriangleBytes * (model.triangles.size() + model.vertices.size()) +
         kTreeTriangleBytes * model.triangles.size() + sizeof(RigidTransform) * model.symmetries.size();
}

}  // namespace

TrackerMemory EstimateTrackerMemory(const CameraModel& camera,
                                    const std::vector<std::shared_ptr<const ObjectModel>>& models,
                                    const TrackerOptions& options) {
  constexpr uint64_t kStateEventBytes = 8;  // of a window, with its time as a difference
  const auto num_pixels = static_cast<uint64_t>(camera.width_px) * static_cast<uint64_t>(camera.height_px);
  const auto search_events = static_cast<uint64_t>(options.initialization.max_events);
  const uint64_t num_cells = TileGrid(camera).num_cells();
  TrackerMemory memory;
  memory.max_bytes = num_pixels / 4 + (camera.HasDistortion() ? num_pixels * sizeof(Eigen::Vector2f) : 0);
  // The events of a search, before and after the removal of flicker, and the detector's index of them: 8 bytes for each
  // tile of an image that undistortion enlarges to 1.5 times its width and height.
  memory.max_bytes += kDetectionBytes + 2 * search_events * sizeof(PixelEvent) + num_pixels * 9 / 4 / 64 * 8;
  memory.max_bytes += 2 * static_cast<uint64_t>(options.windows.max_events) * (sizeof(WindowEvent) + sizeof(uint64_t));
  std::set<const ObjectModel*> distinct;
  for (const auto& model : models) {
    memory.max_bytes += ObjectBytes(*model, num_cells, models.size() > 1, options);
    if (distinct.insert(model.get()).second) memory.max_bytes += ModelBytes(*model);
  }
  memory.max_state_bytes = num_pixels / 5 + 2 * kStateEventBytes * static_cast<uint64_t>(options.windows.max_events) +
                           models.size() * (kStateEventBytes * search_events + kTrackBytes);
  return memory;
}

}  // namespace evpose
