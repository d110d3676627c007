// SPDX-License-Identifier: Apache-2.0

// Decoders of formats in which each word is a complete event: DAT and FLAT64.
#include <cstdint>

#include "core/events/sensor_clock.h"
#include "core/events/word_decoder.h"
#include "core/events/word_types.h"

namespace evpose {
namespace {

// The fields of a word. The column of a trigger is the number of its input.
struct FullAddress {
  uint32_t t_us;
  uint32_t x;
  uint32_t y;
  uint8_t polarity;
  WordKind kind;
};

// DAT version 2, 2D events: 32 bits of time, then x:14, y:14 and polarity in 32 bits.
struct DatLayout {
  static FullAddress Parse(uint64_t word) {
    // The three bits above the polarity have no meaning in 2D events.
    return {static_cast<uint32_t>(word), static_cast<uint32_t>(word >> 32) & 0x3fff,
            static_cast<uint32_t>(word >> 46) & 0x3fff, static_cast<uint8_t>((word >> 60) & 1), WordKind::kEvent};
  }
};

struct Flat64Layout {
  static FullAddress Parse(uint64_t word) {
    return {static_cast<uint32_t>(word >> 32), static_cast<uint32_t>(word >> 18) & 0x3fff,
            static_cast<uint32_t>(word >> 4) & 0x3fff, static_cast<uint8_t>(word & 1), Flat64Kind(word)};
  }
};

// There are no time words, hence no time marks; every word has a full time stamp, hence no wait after a loss.
template <typename Layout>
class FullAddressDecoder final : public WordDecoder {
 public:
  FullAddressDecoder(SensorGeometry geometry, OutsideSensor outside) : WordDecoder(8, geometry, outside) {}

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
      if (word.kind == WordKind::kUnknown) [[unlikely]] {
        ++counts_.unknown_words;
        continue;
      }
      clock.Set(word.t_us);
      if (word.kind == WordKind::kTrigger) [[unlikely]] {
        sink_.AddTrigger({clock.now_us(), static_cast<uint8_t>(word.x), word.polarity});
        ++counts_.triggers;
        continue;
      }
      const bool inside = (word.x < width_) & (word.y < height_);
      *cursor = {clock.now_us(), static_cast<uint16_t>(word.x), static_cast<uint16_t>(word.y), word.polarity};
      cursor += inside | keep_outside;
      num_outside += !inside;
      if (cursor >= sink_.limit()) [[unlikely]]
        cursor = sink_.Flush(cursor);
    }
    sink_.Flush(cursor);
    clock_ = clock;
    CountOutside(num_outside);
    UpdateCounts(clock);
    return count;
  }

  void DiscardState() override {}

  Clock32 clock_;
};

}  // namespace

std::unique_ptr<EventDecoder> MakeDatDecoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<FullAddressDecoder<DatLayout>>(geometry, outside);
}
std::unique_ptr<EventDecoder> MakeFlat64Decoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<FullAddressDecoder<Flat64Layout>>(geometry, outside);
}

}  // namespace evpose
