// SPDX-License-Identifier: Apache-2.0
#include "core/detection/plane_detector.h"

#include <algorithm>
#include <cmath>

#include "core/base/status_macros.h"
#include "core/base/yield_point.h"

namespace evpose {
namespace {

// Width of the sensors on which the default options are validated, and the smallest scale: an edge is about a pixel
// wide on any sensor, so that cells below a pixel and neighbours within two of them would separate its own events.
constexpr double kFullWidthPx = 640.0;
constexpr double kMinScale = 0.5;
constexpr double kMinGatePx = 2.0;

class PlaneLineDetector : public LineDetector {
 public:
  PlaneLineDetector(const PlaneDetectorOptions& options, SensorGeometry geometry)
      : options_(options), selector_(options.stretch, geometry.width_px, geometry.height_px) {}

  LineDetection Detect(absl::Span<const PixelEvent> events) override {
    const EventStretch stretch = selector_.Select(events);
    YieldPoint();
    const std::vector<MovingLine> candidates = SegmentPlanes(stretch, options_.segmentation);
    return {stretch.t_begin_us, stretch.t_end_us, SelectLines(stretch, candidates, options_.lines)};
  }

 private:
  const PlaneDetectorOptions options_;
  StretchSelector selector_;
};

}  // namespace

PlaneDetectorOptions PlaneDetectorOptions::ForSensor(SensorGeometry geometry) {
  PlaneDetectorOptions options;
  const double scale = std::clamp(geometry.width_px / kFullWidthPx, kMinScale, 1.0);
  if (scale >= 1.0) return options;
  for (double* length_px :
       {&options.stretch.motion_px, &options.segmentation.cell_px, &options.segmentation.neighbour_radius_px,
        &options.lines.min_length_px, &options.lines.merge_px, &options.lines.stripe_px, &options.lines.corner_px}) {
    *length_px *= scale;
  }
  // The width of an edge is that of a pixel and does not scale: its gate shrinks less, and the normals of smaller cells
  // scatter more.
  options.lines.fit.gate_px = std::max(kMinGatePx, options.lines.fit.gate_px * scale);
  options.segmentation.max_curvature *= 1.0 / std::sqrt(scale);
  return options;
}

std::vector<PlaneDetectorOptions> PlaneDetectorOptions::ForSearch(SensorGeometry geometry) {
  std::vector<PlaneDetectorOptions> options = {ForSensor(geometry)};
  const PlaneDetectorOptions full;
  if (options[0].lines.min_length_px != full.lines.min_length_px) options.push_back(full);
  return options;
}

absl::Status PlaneDetectorOptions::Validate() const {
  absl::Status status = stretch.Validate();
  status.Update(segmentation.Validate());
  status.Update(lines.Validate());
  return status;
}

absl::StatusOr<std::unique_ptr<LineDetector>> MakePlaneLineDetector(const PlaneDetectorOptions& options,
                                                                    SensorGeometry geometry) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckSensor(geometry));
  return std::make_unique<PlaneLineDetector>(options, geometry);
}

}  // namespace evpose
