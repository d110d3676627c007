// SPDX-License-Identifier: Apache-2.0
#include "core/detection/plane_detector.h"

#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"

namespace evpose {
namespace {

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

absl::Status PlaneDetectorOptions::Validate() const {
  absl::Status status = stretch.Validate();
  status.Update(segmentation.Validate());
  status.Update(lines.Validate());
  return status;
}

absl::StatusOr<std::unique_ptr<LineDetector>> MakePlaneLineDetector(const PlaneDetectorOptions& options,
                                                                    SensorGeometry geometry) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  if (geometry.width_px <= 0 || geometry.height_px <= 0) {
    return absl::InvalidArgumentError(
        absl::StrFormat("the sensor has %d x %d pixels; both must be positive", geometry.width_px, geometry.height_px));
  }
  return std::make_unique<PlaneLineDetector>(options, geometry);
}

}  // namespace evpose
