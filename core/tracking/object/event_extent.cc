// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/event_extent.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "core/base/yield_point.h"
#include "core/numerics/connected_cells.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Side of the cells in which events are counted: a moving edge has many events in each cell that it crosses.
constexpr int kCellPx = 8;
// The density of a cell exceeds that of the noise, the median over all cells, by this many standard deviations of a
// Poisson count. A lower limit would join cells of noise to the region; with a higher one faint edges lie outside.
constexpr double kSignificanceSigma = 5.0;
// A region of fewer pixels consists of defective ones.
constexpr int kMinPixels = 8;
// Events for one box, so that its tail (kTail) is one event; and the largest number of boxes, enough for the median of
// their sizes.
constexpr size_t kBoxEvents = 50;
constexpr size_t kMaxBoxes = 16;
// Share of the events of a box beyond either side: noise inside the region must not enlarge it.
constexpr double kTail = 0.02;

class CellMap {
 public:
  CellMap(int width_px, int height_px)
      : width_px_(width_px),
        height_px_(height_px),
        columns_((width_px + kCellPx - 1) / kCellPx),
        rows_((height_px + kCellPx - 1) / kCellPx),
        counts_(static_cast<size_t>(columns_) * static_cast<size_t>(rows_), 0),
        regions_(counts_.size(), -1) {}

  bool Contains(const PixelEvent& event) const {
    return event.u_px >= 0.0f && event.v_px >= 0.0f && event.u_px < static_cast<float>(width_px_) &&
           event.v_px < static_cast<float>(height_px_);
  }
  size_t CellOf(const PixelEvent& event) const {
    return static_cast<size_t>(static_cast<int>(event.v_px) / kCellPx) * static_cast<size_t>(columns_) +
           static_cast<size_t>(static_cast<int>(event.u_px) / kCellPx);
  }
  size_t PixelOf(const PixelEvent& event) const {
    return static_cast<size_t>(static_cast<int>(event.v_px)) * static_cast<size_t>(width_px_) +
           static_cast<size_t>(static_cast<int>(event.u_px));
  }
  void Count(const PixelEvent& event) { ++counts_[CellOf(event)]; }
  // Region of an event; -1 outside all of them.
  int RegionOf(const PixelEvent& event) const { return regions_[CellOf(event)]; }

  // Divides the cells above the noise into connected regions (8 neighbours); returns their number.
  int FindRegions() {
    std::vector<int> counts = counts_;
    YieldPoint();
    const double noise = UpperMedian(counts) + 1.0;
    YieldPoint();
    const double least = noise + kSignificanceSigma * std::sqrt(noise);
    std::vector<bool> is_above(counts_.size());
    for (size_t cell = 0; cell < counts_.size(); ++cell) is_above[cell] = counts_[cell] >= least;
    const std::vector<std::vector<size_t>> regions = ConnectedCells(columns_, rows_, is_above);
    for (size_t region = 0; region < regions.size(); ++region) {
      for (const size_t cell : regions[region]) regions_[cell] = static_cast<int>(region);
    }
    return static_cast<int>(regions.size());
  }

 private:
  const int width_px_;
  const int height_px_;
  const int columns_;
  const int rows_;
  std::vector<int> counts_;
  std::vector<int> regions_;
};

// Returns the region with the most events among those of enough pixels; -1 if there is none.
int LargestRegion(absl::Span<const PixelEvent> events, const CellMap& map, int num_regions, size_t num_pixels) {
  std::vector<int> num_events(static_cast<size_t>(num_regions), 0);
  std::vector<int> num_region_pixels(static_cast<size_t>(num_regions), 0);
  std::vector<bool> is_seen(num_pixels, false);
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    if (!map.Contains(events[k])) continue;
    const int region = map.RegionOf(events[k]);
    if (region < 0) continue;
    ++num_events[static_cast<size_t>(region)];
    const size_t pixel = map.PixelOf(events[k]);
    if (!is_seen[pixel]) ++num_region_pixels[static_cast<size_t>(region)];
    is_seen[pixel] = true;
  }
  int largest = -1;
  for (int region = 0; region < num_regions; ++region) {
    const auto index = static_cast<size_t>(region);
    if (num_region_pixels[index] < kMinPixels) continue;
    if (largest < 0 || num_events[index] > num_events[static_cast<size_t>(largest)]) largest = region;
  }
  return largest;
}

// Returns the distance between the two tails; `values` are reordered.
float Spread(std::vector<float>& values) {
  const auto tail = static_cast<size_t>(kTail * static_cast<double>(values.size()));
  const float low = SelectNth(values, tail);
  return SelectNth(values, values.size() - 1 - tail) - low;
}

}  // namespace

int EventExtentPx(absl::Span<const PixelEvent> events, int width_px, int height_px) {
  CellMap map(width_px, height_px);
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    if (map.Contains(events[k])) map.Count(events[k]);
  }
  const int num_regions = map.FindRegions();
  const int largest =
      LargestRegion(events, map, num_regions, static_cast<size_t>(width_px) * static_cast<size_t>(height_px));
  if (largest < 0) return 0;
  std::vector<PixelEvent> inside;
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    if (map.Contains(events[k]) && map.RegionOf(events[k]) == largest) inside.push_back(events[k]);
  }
  const size_t num_boxes = std::clamp<size_t>(inside.size() / kBoxEvents, 1, kMaxBoxes);
  std::vector<float> sides;
  for (size_t box = 0; box < num_boxes; ++box) {
    YieldPoint();
    std::array<std::vector<float>, 2> positions;
    for (size_t k = box * inside.size() / num_boxes; k < (box + 1) * inside.size() / num_boxes; ++k) {
      positions[0].push_back(inside[k].u_px);
      positions[1].push_back(inside[k].v_px);
    }
    sides.push_back(std::max(Spread(positions[0]), Spread(positions[1])));
  }
  // A region of one column or row of pixels has the extent 1.
  return static_cast<int>(UpperMedian(sides)) + 1;
}

}  // namespace evpose
