// SPDX-License-Identifier: Apache-2.0
#include "core/events/event_bitmap.h"

#include <algorithm>

namespace evpose {
namespace {

constexpr uint8_t kOn = 1, kOff = 2;
constexpr size_t kCellsPerByte = 4;  // two bits for each cell

int NumCells(int size_px, int cell_px) { return (size_px + cell_px - 1) / cell_px; }

}  // namespace

EventBitmap::EventBitmap(const SensorGeometry& sensor, int cell_px)
    : sensor_(sensor),
      shift_(cell_px / 2),  // the logarithm of 1, 2 and 4
      width_(NumCells(sensor.width_px, cell_px)),
      height_(NumCells(sensor.height_px, cell_px)),
      bytes_(NumBytes(sensor, cell_px), 0) {}

size_t EventBitmap::NumBytes(const SensorGeometry& sensor, int cell_px) {
  const size_t cells = static_cast<size_t>(NumCells(sensor.width_px, cell_px)) *
                       static_cast<size_t>(NumCells(sensor.height_px, cell_px));
  return (cells + kCellsPerByte - 1) / kCellsPerByte;
}

void EventBitmap::Add(absl::Span<const Event> events) {
  uint8_t* const bytes = bytes_.data();
  const auto width = static_cast<size_t>(width_);
  for (const Event& event : events) {
    if (event.x >= sensor_.width_px || event.y >= sensor_.height_px) continue;
    const size_t cell = static_cast<size_t>(event.y >> shift_) * width + static_cast<size_t>(event.x >> shift_);
    const uint8_t bit = event.polarity != 0 ? kOn : kOff;
    bytes[cell / kCellsPerByte] |= static_cast<uint8_t>(bit << (2 * (cell % kCellsPerByte)));
  }
}

void EventBitmap::Add(const EventBitmap& other) {
  std::transform(bytes_.begin(), bytes_.end(), other.bytes_.begin(), bytes_.begin(),
                 [](uint8_t a, uint8_t b) { return static_cast<uint8_t>(a | b); });
}

void EventBitmap::Clear() { std::fill(bytes_.begin(), bytes_.end(), uint8_t{0}); }

}  // namespace evpose
