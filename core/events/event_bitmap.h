// SPDX-License-Identifier: Apache-2.0

// Images of events: which cells of a sensor have had events of which polarity.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose {

// Two bits for each cell, row by row without padding between rows; four cells in a byte, the first in the lowest bits.
// 1: the cell has had ON events, 2: OFF events, 3: both.
class EventBitmap {
 public:
  // `cell_px`, the width and height of a cell, is 1, 2 or 4. Cells at the right and lower borders of the sensor may be
  // incomplete.
  EventBitmap(const SensorGeometry& sensor, int cell_px);
  static size_t NumBytes(const SensorGeometry& sensor, int cell_px);

  const SensorGeometry& sensor() const { return sensor_; }
  int cell_px() const { return 1 << shift_; }
  int width() const { return width_; }    // cells
  int height() const { return height_; }  // cells
  absl::Span<const uint8_t> bytes() const { return bytes_; }

  // Events outside the sensor are ignored.
  void Add(absl::Span<const Event> events);
  // Adds the events of a bitmap of the same sensor and with the same cells.
  void Add(const EventBitmap& other);
  void Clear();

 private:
  SensorGeometry sensor_;
  int shift_;
  int width_;
  int height_;
  std::vector<uint8_t> bytes_;
};

}  // namespace evpose
