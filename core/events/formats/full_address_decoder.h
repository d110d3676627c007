// SPDX-License-Identifier: Apache-2.0

// Decoder of formats in which each word is a complete event: DAT and FLAT64.
#pragma once

#include <cstdint>

#include "core/events/formats/sensor_clock.h"
#include "core/events/formats/word_decoder.h"

namespace evpose {

// The fields of a word; `known` is false if reserved bits are set.
struct FullAddress {
  uint32_t t_us;
  uint32_t x;
  uint32_t y;
  uint8_t polarity;
  bool known;
};

// `Layout::Parse(uint64_t)` returns the fields of a word. There are no time words, hence no time marks; every word has
// a full time stamp, hence no wait after a loss.
template <typename Layout>
class FullAddressDecoder final : public WordDecoder {
 public:
  FullAddressDecoder(SensorGeometry geometry, OutsideSensor outside)
      : WordDecoder(8),
        width_(static_cast<uint32_t>(geometry.width_px)),
        height_(static_cast<uint32_t>(geometry.height_px)),
        keep_outside_(outside == OutsideSensor::kKeep) {}

  void SaveState(StateWriter& writer) const override { VisitState(writer, *this); }
  void LoadState(StateReader& reader) override { VisitState(reader, *this); }
  static void VisitState(auto& archive, auto& self) {
    VisitWords(archive, self);
    archive(self.clock_);
  }

 private:
  size_t DecodeWords(const uint8_t* words, size_t count) override {
    Clock32 clock = clock_;
    Event* cursor = sink_.begin();
    uint64_t num_outside = 0;
    const bool keep_outside = keep_outside_;
    for (size_t index = 0; index < count; ++index) {
      const FullAddress word = Layout::Parse(LoadWord<uint64_t>(words + 8 * index));
      if (!word.known) [[unlikely]] {
        ++counts_.unknown_words;
        continue;
      }
      clock.Set(word.t_us);
      const bool inside = (word.x < width_) & (word.y < height_);
      *cursor = {clock.now_us(), static_cast<uint16_t>(word.x), static_cast<uint16_t>(word.y), word.polarity};
      cursor += inside | keep_outside;
      num_outside += !inside;
      if (cursor >= sink_.limit()) [[unlikely]]
        cursor = sink_.Flush(cursor);
    }
    sink_.Flush(cursor);
    clock_ = clock;
    (keep_outside ? counts_.kept_outside_sensor : counts_.dropped_outside_sensor) += num_outside;
    counts_.cd_events = sink_.num_events();
    counts_.clock_wraps = clock.wraps();
    counts_.time_backsteps = clock.backsteps();
    return count;
  }

  void Forget() override {}

  const uint32_t width_;
  const uint32_t height_;
  const bool keep_outside_;
  Clock32 clock_;
};

}  // namespace evpose
