// SPDX-License-Identifier: Apache-2.0

// The polarity of the last event of each pixel. A second event of the same polarity needs a smaller brightness change
// than an event of the other polarity, by one contrast threshold. The distance between an event and its edge therefore
// depends on the previous polarity (core/estimation/edge_bias.h).
#pragma once

#include <cstdint>
#include <vector>

#include "core/base/state_io.h"
#include "core/events/event.h"

namespace evpose {

// The polarity of the previous event of a pixel, however old, relative to that of the current event.
enum class PreviousPolarity : uint8_t { kUnknown, kSame, kOther };

struct WindowEvent : Event {
  PreviousPolarity previous = PreviousPolarity::kUnknown;
};

// Memory: two bits per pixel.
class PixelHistory {
 public:
  explicit PixelHistory(SensorGeometry sensor) : sensor_(sensor), last_((num_pixels() + 3) / 4, kNothingYet) {}

  // Fast access for loops: holds the history's address and size in local variables. The history must outlive it.
  class Writer {
   public:
    explicit Writer(PixelHistory& history)
        : width_px_(history.sensor_.width_px), height_px_(history.sensor_.height_px), last_(history.last_.data()) {}

    // Stores the event's polarity and returns the relation to the previous event of its pixel. Events outside the
    // sensor are not stored and yield kUnknown.
    PreviousPolarity Exchange(const Event& event) {
      using enum PreviousPolarity;
      // A table instead of branches, which the processor could not predict. Index: 2 * stored state + polarity.
      static constexpr PreviousPolarity kPrevious[] = {kSame, kOther, kOther, kSame, kUnknown, kUnknown};
      if (event.x >= width_px_ || event.y >= height_px_) return kUnknown;
      const uint32_t pixel = event.y * width_px_ + event.x;
      uint8_t& four_pixels = last_[pixel / 4];
      const uint32_t shift = 2 * (pixel % 4);
      const uint32_t last = four_pixels >> shift & 3u;
      const uint32_t polarity = event.polarity != 0 ? 1 : 0;
      four_pixels = static_cast<uint8_t>(four_pixels ^ (last ^ polarity) << shift);
      return kPrevious[2 * last + polarity];
    }

   private:
    const uint32_t width_px_;
    const uint32_t height_px_;
    uint8_t* const last_;
  };
  PreviousPolarity Exchange(const Event& event) { return Writer(*this).Exchange(event); }
  // Returns the event with its previous polarity, and stores its polarity.
  WindowEvent Next(const Event& event) { return {event, Exchange(event)}; }

  // LoadState() requires a history of the same sensor. After a failure (reader.status()) the object must not be used.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  static constexpr uint8_t kNothingYet = 0xaa;  // four pixels in state 2

  size_t num_pixels() const { return static_cast<size_t>(sensor_.width_px) * sensor_.height_px; }
  uint32_t StateOf(size_t pixel) const { return last_[pixel / 4] >> 2 * (pixel % 4) & 3u; }

  const SensorGeometry sensor_;
  // Two bits for each pixel, the first pixel of a byte in its lowest bits: the polarity, or 2 while the pixel has
  // produced no event.
  std::vector<uint8_t> last_;
};

}  // namespace evpose
