// SPDX-License-Identifier: Apache-2.0

// Pixels that emit too many events or none, from the number of events of each pixel (core/diagnosis/README.md, section
// 1, and section 7).
#pragma once

#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/diagnosis/diagnosis_options.h"
#include "core/events/event.h"

namespace evpose {

class PixelCounts {
 public:
  explicit PixelCounts(SensorGeometry geometry);

  // Events inside the geometry.
  void Add(absl::Span<const Event> events);
  uint64_t num_events() const { return num_events_; }

  struct HotPixel {
    int x = 0;
    int y = 0;
    uint64_t events = 0;
  };
  // Returns the hot pixels in descending order of their numbers of events.
  std::vector<HotPixel> FindHot(const DiagnosisOptions& options) const;

  // An area without events whose surroundings have many.
  struct DeadArea {
    int x_min = 0, y_min = 0, x_max = 0, y_max = 0;  // its box, inclusive
    uint64_t pixels = 0;
  };
  // Median of the events of the pixels at the rim of an area, from which on the area is dead and not merely at rest.
  // With fewer, an area without events may be one through which no edge has moved yet.
  static constexpr uint32_t kMinRimEvents = 16;
  // Share of the pixels with kMinRimEvents or more.
  double BusyShare() const;
  // Returns the dead areas in descending order of their numbers of pixels. `noise_per_pixel` is the expected number of
  // noise events of a pixel.
  std::vector<DeadArea> FindDead(double noise_per_pixel, const DiagnosisOptions& options) const;

  // The box of all pixels with events, inclusive; all -1 without events.
  struct Box {
    int x_min = -1, y_min = -1, x_max = -1, y_max = -1;
  };
  Box Extent() const;

 private:
  uint32_t At(int x, int y) const {
    return counts_[static_cast<size_t>(y) * static_cast<size_t>(geometry_.width_px) + static_cast<size_t>(x)];
  }

  const SensorGeometry geometry_;
  std::vector<uint32_t> counts_;
  uint64_t num_events_ = 0;
};

}  // namespace evpose
