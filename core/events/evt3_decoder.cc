// EVT 3.0: 16-bit words of a 4-bit type and 12 bits of content; time, row and vector base hold until another comes.
#include <bit>
#include <cstdint>

#include "core/events/sensor_clock.h"
#include "core/events/word_decoder.h"

namespace evpose {
namespace {

enum Evt3Type : uint32_t {
  kAddrY = 0x0,
  kReservedRow = 0x1,
  kAddrX = 0x2,
  kVectBaseX = 0x3,
  kVect12 = 0x4,
  kVect8 = 0x5,
  kTimeLow = 0x6,
  kContinued4 = 0x7,
  kTimeHigh = 0x8,
  kExtTrigger = 0xA,
  kOthers = 0xE,
  kContinued12 = 0xF,
};

// Nearly all words of a recording are of these types, in an order that no branch predictor learns: they take one path
// without a branch.
constexpr uint32_t kFrequentTypes = 1u << kAddrY | 1u << kAddrX | 1u << kTimeLow;

constexpr uint32_t kTripleWords = 3;

struct Evt3State {
  Evt3Clock clock;
  uint32_t row = 0;
  bool row_valid = false;  // a row of the sensor was named
  bool has_base = false;
  uint32_t vector_base = 0;
  uint8_t vector_polarity = 0;
};

template <bool kKeepOutside>
class Evt3Decoder final : public WordDecoder {
 public:
  explicit Evt3Decoder(SensorGeometry geometry)
      : WordDecoder(2),
        width_(static_cast<uint32_t>(geometry.width_px)),
        height_(static_cast<uint32_t>(geometry.height_px)) {}

 private:
  enum class Wait { kTimeHigh, kTimeLow, kNothing };

  size_t DecodeWords(const uint8_t* words, size_t count) override {
    size_t index = 0;
    while (index < count && wait_ != Wait::kNothing) WaitForTime(LoadWord<uint16_t>(words + 2 * index++));
    if (wait_ != Wait::kNothing) return index;
    if (!has_row_) index = Run<false>(words, index, count);
    if (has_row_) index = Run<true>(words, index, count);
    counts_.cd_events = sink_.num_events();
    counts_.clock_wraps = state_.clock.wraps();
    counts_.time_backsteps = state_.clock.backsteps();
    return index;
  }

  void Forget() override {
    // The wrap rule still needs the last TIME_HIGH, but a TIME_LOW may be among what was lost.
    needs_time_low_ = true;
    wait_ = Wait::kTimeHigh;
    has_row_ = false;
    state_.row_valid = false;
    state_.has_base = false;
  }

  void WaitForTime(uint32_t word) {
    const uint32_t content = word & 0xfff;
    switch (word >> 12) {
      case kTimeHigh:
        SetTimeHigh(content);
        wait_ = needs_time_low_ ? Wait::kTimeLow : Wait::kNothing;
        return;
      case kTimeLow:
        if (wait_ != Wait::kTimeLow) return;
        SetTimeLow(content);
        wait_ = Wait::kNothing;
        return;
      case kAddrX:
      case kExtTrigger:
        ++counts_.dropped_before_time;
        return;
      case kVect12:
        counts_.dropped_before_time += static_cast<uint64_t>(std::popcount(content));
        return;
      case kVect8:
        counts_.dropped_before_time += static_cast<uint64_t>(std::popcount(content & 0xff));
        return;
      case kAddrY:
      case kVectBaseX:
      case kContinued4:
      case kOthers:
      case kContinued12:
        return;
      default:
        ++counts_.unknown_words;
    }
  }

  // For words outside Run(), when no event waits in the buffer.
  void SetTimeHigh(uint32_t high) {
    const bool was_started = state_.clock.started();
    const bool forward = state_.clock.SetHigh(high);
    TimeIsSet(was_started && forward);
  }
  void SetTimeLow(uint32_t low) { TimeIsSet(state_.clock.SetLow(low)); }
  void TimeIsSet(bool forward) {
    const int64_t now_us = state_.clock.now_us();
    if (!forward) {
      sink_.RestartMarks(sink_.begin(), now_us);
    } else if (now_us >= sink_.mark_due_us()) {
      sink_.MarkTime(sink_.begin(), now_us);
    }
  }

  // Decodes from `index` on. Without a row so far it stops behind the first one.
  template <bool kHasRow>
  size_t Run(const uint8_t* words, size_t index, size_t count) {
    // The loop works on copies that the compiler can keep in registers.
    Evt3State state = state_;
    const uint32_t width = width_;
    const uint32_t height = height_;
    Event* cursor = sink_.begin();
    const Event* const limit = sink_.limit();
    uint64_t dropped = 0;
    uint64_t kept_outside = 0;
    int64_t low_us = state.clock.low_us();
    int64_t t_us = state.clock.now_us();
    int64_t mark_due_us = sink_.mark_due_us();
    while (index < count) {
      const uint32_t word = LoadWord<uint16_t>(words + 2 * index);
      const uint32_t type = word >> 12;
      const uint32_t content = word & 0xfff;
      if ((kFrequentTypes >> type) & 1) [[likely]] {
        ++index;
        const bool is_row = type == kAddrY;
        state.row = is_row ? content : state.row;
        state.row_valid = is_row ? content < height : state.row_valid;
        if (type == kTimeLow && content < low_us) [[unlikely]] {
          state.clock.SetLow(low_us);  // what it missed so far
          state.clock.SetLow(content);
          sink_.RestartMarks(cursor, state.clock.now_us());
          mark_due_us = sink_.mark_due_us();
        }
        low_us = type == kTimeLow ? content : low_us;
        t_us = state.clock.base_us() + low_us;
        if (t_us >= mark_due_us) [[unlikely]] {
          cursor = sink_.MarkTime(cursor, t_us);
          mark_due_us = sink_.mark_due_us();
        }
        const uint32_t x = content & 0x7ff;
        const bool is_event = type == kAddrX;
        const bool inside = x < width;
        const bool emitted = is_event & state.row_valid & (kKeepOutside | inside);
        *cursor = {t_us, static_cast<uint16_t>(x), static_cast<uint16_t>(state.row),
                   static_cast<uint8_t>(content >> 11)};
        cursor += emitted;
        dropped += is_event & !emitted;
        if constexpr (kKeepOutside) kept_outside += emitted & !inside;
        if (cursor >= limit) [[unlikely]]
          cursor = sink_.Flush(cursor);
        if constexpr (!kHasRow) {
          if (is_row) {
            has_row_ = true;
            break;
          }
        }
        continue;
      }
      if (type == kVect12) {
        if (count - index < kTripleWords) break;
        cursor = DecodeTriple(words + 2 * index, t_us, state, cursor, dropped);
        index += kTripleWords;
        continue;
      }
      ++index;
      state.clock.SetLow(low_us);
      cursor = DecodeRareWord(type, content, state, cursor);
      low_us = state.clock.low_us();
      t_us = state.clock.now_us();
      mark_due_us = sink_.mark_due_us();
    }
    state.clock.SetLow(low_us);
    sink_.Flush(cursor);
    (kHasRow ? counts_.dropped_outside_sensor : counts_.dropped_before_time) += dropped;
    counts_.kept_outside_sensor += kept_outside;
    state_ = state;
    return index;
  }

  // The 12 + 12 + 8 pixels from the base on. Whatever the types of the second and third word, they are taken as masks,
  // as OpenEB does.
  Event* DecodeTriple(const uint8_t* words, int64_t t_us, Evt3State& state, Event* cursor, uint64_t& dropped) {
    const uint32_t first = LoadWord<uint16_t>(words);
    const uint32_t second = LoadWord<uint16_t>(words + 2);
    const uint32_t third = LoadWord<uint16_t>(words + 4);
    uint32_t mask = (first & 0xfff) | (second & 0xfff) << 12 | (third & 0xff) << 24;
    const bool broken = second >> 12 != kVect12 || third >> 12 != kVect8;
    if (!state.row_valid) {
      counts_.broken_vectors += broken;
      dropped += static_cast<uint64_t>(std::popcount(mask));
      return cursor;
    }
    counts_.broken_vectors += broken | !state.has_base;
    if (!state.has_base) return cursor;
    const uint32_t base = state.vector_base;
    state.vector_base += 32;
    if (base + 32 > width_) {
      dropped += static_cast<uint64_t>(std::popcount(mask));
      return cursor;
    }
    for (; mask != 0; mask &= mask - 1) {
      const auto x = static_cast<uint16_t>(base + static_cast<uint32_t>(std::countr_zero(mask)));
      *cursor++ = {t_us, x, static_cast<uint16_t>(state.row), state.vector_polarity};
    }
    return cursor >= sink_.limit() ? sink_.Flush(cursor) : cursor;
  }

  Event* DecodeRareWord(uint32_t type, uint32_t content, Evt3State& state, Event* cursor) {
    switch (type) {
      case kTimeHigh: {
        const bool forward = state.clock.SetHigh(content);
        const int64_t now_us = state.clock.now_us();
        if (!forward) {
          sink_.RestartMarks(cursor, now_us);
        } else if (now_us >= sink_.mark_due_us()) {
          return sink_.MarkTime(cursor, now_us);
        }
        return cursor;
      }
      case kVectBaseX:
        state.vector_base = content & 0x7ff;
        state.vector_polarity = static_cast<uint8_t>(content >> 11);
        state.has_base = true;
        return cursor;
      case kExtTrigger:
        sink_.AddTrigger({state.clock.now_us(), static_cast<uint8_t>(content >> 8), static_cast<uint8_t>(content & 1)});
        ++counts_.triggers;
        return cursor;
      case kVect8:  // the end of a triple whose beginning is missing
        ++counts_.broken_vectors;
        return cursor;
      case kOthers:
      case kContinued4:
      case kContinued12:
        return cursor;
      case kReservedRow:  // addresses of another kind follow, until the next row
        state.row_valid = false;
        [[fallthrough]];
      default:
        ++counts_.unknown_words;
        return cursor;
    }
  }

  const uint32_t width_;
  const uint32_t height_;
  Evt3State state_;
  Wait wait_ = Wait::kTimeHigh;
  bool needs_time_low_ = false;
  bool has_row_ = false;
};

}  // namespace

std::unique_ptr<EventDecoder> MakeEvt3Decoder(SensorGeometry geometry, OutsideSensor outside) {
  if (outside == OutsideSensor::kKeep) return std::make_unique<Evt3Decoder<true>>(geometry);
  return std::make_unique<Evt3Decoder<false>>(geometry);
}

}  // namespace evpose
