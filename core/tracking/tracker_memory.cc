// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/tracker_memory.h"

#include <algorithm>

#include "core/association/association.h"
#include "core/association/tile_table.h"
#include "core/association/visible_edges.h"
#include "core/detection/line_detector.h"
#include "core/detection/plane_detector.h"
#include "core/initialization/check_lines.h"
#include "core/initialization/pose_search.h"
#include "core/tracking/lens_views.h"
#include "core/tracking/object/object_tracker.h"
#include "core/tracking/object/tracker_options.h"
#include "core/windows/pixel_history.h"

namespace evpose {
namespace {

// Detection, once for all objects: two hash tables of 1 MB, the points and neighbours of at most 5000 points of each
// polarity, and the events of the stretch.
constexpr uint64_t kDetectionBytes = 14u << 20;
// What each further line detector keeps between its calls beside its copy of the events: two hash tables of 1 MB.
constexpr uint64_t kFurtherDetectorBytes = 2'200'000;
// Pose search of an object: 24,000 rotations and 120,000 votes at most (PoseSearchOptions), the vectors that hold them
// with twice their capacity.
constexpr uint64_t kSearchBytes = 6u << 20;
// Views of a model with curved edges: 642 with 120 points of 68 bytes, and their boxes at 48 turns.
constexpr uint64_t kTemplateModelBytes = 7u << 20;
// Views of the search for lines: 20,000 lines of 32 bytes.
constexpr uint64_t kSearchModelBytes = 640'000;
// Template search of an object: sums of 20,000 pixels, distance maps of three boxes, a hash table of 2 MB, and a grid
// with two bytes for each pixel.
constexpr uint64_t kTemplateSearchBytes = 14u << 20;
constexpr uint64_t kTemplateSearchPixelBytes = 2;
// A hypothesis: observations of its events, the same by line, and the sums of its estimator.
constexpr uint64_t kTrackBytes = 440u << 10;
// A visible line or element in a hypothesis: image lines with their Jacobians and sums, twice the capacity.
constexpr uint64_t kTrackLineBytes = 2200;
// Statistics of a hypothesis about an edge curve.
constexpr uint64_t kTrackCurveBytes = 700;
// A visible line or element in the past states of an object, which other objects need, and the bytes of it that are
// saved.
constexpr uint64_t kPastLineBytes = ObjectTracker::kMaxPastStates * sizeof(TrackedLine);
constexpr uint64_t kStatePastLineBytes = ObjectTracker::kMaxPastStates * 70;
// A triangle in the search tree (SurfaceTables), and a line or a vertex with a triangle in a model.
constexpr uint64_t kTreeTriangleBytes = 160;
constexpr uint64_t kModelLineBytes = 400;
constexpr uint64_t kModelTriangleBytes = 40;
// A point of a curve with its normals, and a triangle of a curved surface with the normals at its corners.
constexpr uint64_t kCurvePointBytes = 72;
constexpr uint64_t kSurfaceTriangleBytes = 40;
// A triangle of a curved surface in the tables of contours (SurfaceTables).
constexpr uint64_t kElementTriangleBytes = 200;
// A triangle of a model with contours between facets in these tables, and one of its facet edges in the model.
constexpr uint64_t kFacetTriangleBytes = 48;
constexpr uint64_t kFacetEdgeBytes = 8;
// A cell of 64 x 64 pixels: its entry in a grid and its background rate; and its page, if it has lines.
constexpr uint64_t kCellBytes = 64;
constexpr uint64_t kPageBytes = 1280;

// Upper bounds of the lines and elements that a hypothesis sees in a window.
uint64_t VisibleLinesOf(const ObjectModel& model, const TrackerOptions& options) {
  // Half of the lines of a small model are visible; a line of a large one may have two visible parts.
  const bool has_many_lines = model.lines.size() > ModelEdges::kMaxLines;
  const uint64_t lines = has_many_lines ? 2 * ModelEdges::kMaxLines : model.lines.size();
  return lines + (HasCurvedEdges(model) ? static_cast<uint64_t>(options.elements.max_elements) : 0);
}

uint64_t CurvesOf(const ObjectModel& model) {
  constexpr uint64_t kArcsOfRegion = 8;  // octants of the image normal (EdgeElement::curve)
  const uint64_t curves = model.lines.size() + model.curves.size() +
                          kArcsOfRegion * (model.surface.regions.size() + (model.facet_edges.empty() ? 0 : 1));
  return std::min<uint64_t>(curves, ModelEdges::kMaxCurves);
}

// Returns the memory of CameraTables with an entry for each pixel.
uint64_t PixelTablesBytes(const CameraModel& camera) {
  return static_cast<uint64_t>(camera.width_px) * camera.height_px *
         (sizeof(Eigen::Vector2f) + TileTable::BytesPerPixel(camera));
}

// Returns the memory of an object without the model itself and its tables.
uint64_t ObjectBytes(const ObjectModel& model, uint64_t num_cells, bool has_others, const TrackerOptions& options) {
  // Challengers are followed separately until they join. Contours give twice as many.
  const int searches = HasCurvedEdges(model) ? 4 : 3;
  const auto num_tracks = static_cast<uint64_t>(std::max(1, searches * options.initialization.max_candidates));
  const uint64_t num_lines = VisibleLinesOf(model, options);
  uint64_t bytes = kSearchBytes;
  bytes += static_cast<uint64_t>(options.initialization.max_events) * sizeof(WindowEvent);
  bytes += num_tracks *
           (kTrackBytes + kTrackLineBytes * num_lines + kTrackCurveBytes * CurvesOf(model) + kCellBytes * num_cells);
  if (HasCurvedEdges(model)) bytes += kTemplateSearchBytes;
  bytes += 2 * kPageBytes * num_cells;
  if (has_others) bytes += kPastLineBytes * num_lines + (kCellBytes + kPageBytes) * num_cells;  // OtherObjects
  return bytes;
}

}  // namespace

TrackerMemory EstimateTrackerMemory(const CameraModel& camera,
                                    const std::vector<std::shared_ptr<const ObjectModel>>& models,
                                    const TrackerOptions& options) {
  if (camera.lens_model == LensModel::kFisheye) {
    const std::vector<LensView> views = MakeLensViews(camera);
    // A lost object is searched for in several views, and its trackers in the view that it was lost in and in the one
    // that was to take it over are kept meanwhile.
    const auto is_searched = [](const LensView& view) { return view.is_searched; };
    const uint64_t num_searched = std::count_if(views.begin(), views.end(), is_searched);
    const uint64_t num_trackers = std::min<uint64_t>(views.size(), num_searched + 2);
    TrackerMemory memory;
    for (const auto& model : models) {
      TrackerMemory largest;
      for (const LensView& view : views) {
        const TrackerMemory of_view = EstimateTrackerMemory(view.camera, {model}, options);
        largest.max_bytes = std::max(largest.max_bytes, of_view.max_bytes);
        largest.max_state_bytes = std::max(largest.max_state_bytes, of_view.max_state_bytes);
      }
      memory.max_bytes += num_trackers * largest.max_bytes;
      memory.max_state_bytes += num_trackers * largest.max_state_bytes;
    }
    memory.max_bytes += views.size() * PixelTablesBytes(camera);
    return memory;
  }
  constexpr uint64_t kStateEventBytes = 8;  // size of an event of a window, with its time as a difference
  const auto num_pixels = static_cast<uint64_t>(camera.width_px) * static_cast<uint64_t>(camera.height_px);
  const auto search_events = static_cast<uint64_t>(options.initialization.max_events);
  const uint64_t num_cells = TileGrid(camera).num_cells();
  TrackerMemory memory;
  memory.max_bytes = num_pixels / 4 + (camera.HasDistortion() ? PixelTablesBytes(camera) : 0);
  // The events of a search, before and after the removal of flicker, and the detector's index of them: 8 bytes for each
  // tile of an image that undistortion enlarges to 1.5 times its width and height.
  memory.max_bytes += kDetectionBytes + 2 * search_events * sizeof(PixelEvent) + num_pixels * 9 / 4 / 64 * 8;
  if (!options.initialization.detector_factory) {
    const size_t num_detectors = PlaneDetectorOptions::ForSearch({camera.width_px, camera.height_px}).size();
    memory.max_bytes += (num_detectors - 1) * (kFurtherDetectorBytes + search_events * sizeof(PixelEvent));
  }
  // Objects search in turn.
  if (std::any_of(models.begin(), models.end(), [](const auto& model) { return HasCurvedEdges(*model); })) {
    memory.max_bytes += kTemplateSearchPixelBytes * num_pixels;
  }
  memory.max_bytes += 2 * static_cast<uint64_t>(options.windows.max_events) * (sizeof(WindowEvent) + sizeof(uint64_t));
  for (const auto& model : models) memory.max_bytes += ObjectBytes(*model, num_cells, models.size() > 1, options);
  // PixelHistory saves five pixels in a byte.
  memory.max_state_bytes = num_pixels / 5 + 2 * kStateEventBytes * static_cast<uint64_t>(options.windows.max_events) +
                           models.size() * (kStateEventBytes * search_events + kTrackBytes);
  for (const auto& model : models) {
    if (models.size() > 1) memory.max_state_bytes += kStatePastLineBytes * VisibleLinesOf(*model, options);
  }
  return memory;
}

uint64_t EstimateModelMemory(const ObjectModel& model) {
  uint64_t bytes = kTreeTriangleBytes * model.triangles.size();
  if (!model.surface.empty()) bytes += (kSurfaceTriangleBytes + kElementTriangleBytes) * model.triangles.size();
  if (!model.facet_edges.empty()) bytes += kFacetTriangleBytes * model.triangles.size();
  for (const EdgeCurve& curve : model.curves) bytes += kCurvePointBytes * curve.points.size();
  if (HasCurvedEdges(model)) bytes += kTemplateModelBytes;
  if (!model.lines.empty()) bytes += kSearchModelBytes;
  return bytes + kFacetEdgeBytes * model.facet_edges.size() + kModelLineBytes * model.lines.size() +
         kModelTriangleBytes * (model.triangles.size() + model.vertices.size()) +
         sizeof(RigidTransform) * model.symmetries.size();
}

}  // namespace evpose
