// SPDX-License-Identifier: Apache-2.0

// What each pixel sent last. A pixel that answers once more in the same direction needs less of a change than one that
// turns round, by a whole threshold: where its event lies about an edge depends on it (core/estimation/edge_bias.h).
#pragma once

#include <cstdint>
#include <vector>

#include "core/base/state_io.h"
#include "core/events/event.h"

namespace evpose {

// An event's polarity against that of the event before it at the same pixel, however long ago.
enum class PreviousPolarity : uint8_t { kUnknown, kSame, kOther };

struct WindowEvent : Event {
  PreviousPolarity previous = PreviousPolarity::kUnknown;
};

// One byte per pixel.
class PixelHistory {
 public:
  explicit PixelHistory(SensorGeometry sensor)
      : sensor_(sensor), last_(static_cast<size_t>(sensor.width_px) * sensor.height_px, kNothing) {}

  // In a loop, whose memory it keeps at hand. The history must outlive it.
  class Writer {
   public:
    explicit Writer(PixelHistory& history)
        : width_px_(history.sensor_.width_px), height_px_(history.sensor_.height_px), last_(history.last_.data()) {}

    // What the event's pixel sent before it, which is forgotten for it. Events outside the sensor: kUnknown.
    PreviousPolarity Exchange(const Event& event) {
      using enum PreviousPolarity;
      // From a table: what comes next no branch can foretell.
      static constexpr PreviousPolarity kPrevious[] = {kSame, kOther, kOther, kSame, kUnknown, kUnknown};
      if (event.x >= width_px_ || event.y >= height_px_) return kUnknown;
      uint8_t& last = last_[event.y * width_px_ + event.x];
      const uint8_t polarity = event.polarity != 0 ? 1 : 0;
      const PreviousPolarity previous = kPrevious[2u * last + polarity];
      last = polarity;
      return previous;
    }

   private:
    const uint32_t width_px_;
    const uint32_t height_px_;
    uint8_t* const last_;
  };
  PreviousPolarity Exchange(const Event& event) { return Writer(*this).Exchange(event); }
  // The event with that.
  WindowEvent Next(const Event& event) { return {event, Exchange(event)}; }

  // Into a history of the same sensor; after a failure (reader.status()) it must not be used.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  static constexpr uint8_t kNothing = 2;

  const SensorGeometry sensor_;
  std::vector<uint8_t> last_;  // polarity, or kNothing
};

}  // namespace evpose
