// SPDX-License-Identifier: Apache-2.0

// EVT 3.0: 16-bit words of a 4-bit type and 12 bits of content; time, row and vector base hold until another comes.
#include <bit>
#include <cstdint>
#include <type_traits>

#include "core/events/evt3_vector.h"
#include "core/events/sensor_clock.h"
#include "core/events/word_decoder.h"
#include "core/events/word_runs.h"
#include "core/events/word_types.h"

namespace evpose {
namespace {

// Most words are rows and columns, in an order that a branch predictor cannot learn. These two types, and no other,
// have none of the bits kNotAddress; one path without a branch decodes both.
constexpr uint32_t kNotAddress = 0xd000;
constexpr uint32_t kColumnBit = 0x2000;

constexpr uint32_t kTripleWords = 3;  // VECT_12, VECT_12 and VECT_8, which belong to one vector
// The largest value of the vector base: after a vector that began in the last addressable column.
constexpr uint32_t kMaxBase = 0x7ff + kEvt3MaskPixels;

// A row outside every sensor: no ADDR_Y so far, or a row of another kind.
constexpr uint32_t kNoRow = 0xffff;

struct Evt3State {
  Evt3Clock clock;
  uint32_t row = kNoRow;
  Evt3VectorBase base;

  static void VisitState(auto& archive, auto& self) {
    auto& [clock, row, base] = self;
    archive(clock, AtMost(row, kNoRow), base.is_set, AtMost(base.x, kMaxBase), AtMost(base.polarity, 1));
  }
};

template <bool kKeepOutside>
class Evt3Decoder final : public WordDecoder {
  static_assert(kMaxRunBlock <= EventSink::kMaxEventsOfWord);

 public:
  explicit Evt3Decoder(SensorGeometry geometry)
      : WordDecoder(2, geometry, kKeepOutside ? OutsideSensor::kKeep : OutsideSensor::kDrop) {}

  void SaveState(StateWriter& writer) const override { VisitState(writer, *this); }
  void LoadState(StateReader& reader) override { VisitState(reader, *this); }
  static void VisitState(auto& archive, auto& self) {
    VisitWords(archive, self);
    archive(self.state_, AtMost(self.wait_, Wait::kNothing), self.needs_time_low_, self.has_row_);
    if constexpr (std::remove_reference_t<decltype(archive)>::kReading) {
      if (archive.remaining() == 0) return;  // a state of a version that did not count padding words
    }
    archive(self.counts_.padding_words);
  }

 private:
  enum class Wait { kTimeHigh, kTimeLow, kNothing };

  size_t DecodeWords(const uint8_t* words, size_t count) override {
    size_t index = 0;
    while (index < count && wait_ != Wait::kNothing) WaitForTime(LoadWord<uint16_t>(words + 2 * index++));
    if (wait_ != Wait::kNothing) return index;
    if (!has_row_) index = Run<false>(words, index, count);
    if (has_row_) index = Run<true>(words, index, count);
    UpdateCounts(state_.clock);
    return index;
  }

  void DiscardState() override {
    // The clock stays, because the wrap rule needs the last TIME_HIGH; a TIME_LOW may be among the lost words.
    needs_time_low_ = true;
    wait_ = Wait::kTimeHigh;
    has_row_ = false;
    state_.row = kNoRow;
    state_.base.is_set = false;
  }

  void CountUnknown(uint32_t word) {
    ++(word == (evt3::kPadding << 12 | evt3::kPaddingContent) ? counts_.padding_words : counts_.unknown_words);
  }

  void WaitForTime(uint32_t word) {
    const uint32_t content = word & 0xfff;
    const bool was_started = state_.clock.started();
    switch (word >> 12) {
      case evt3::kTimeHigh:
        TimeIsSet(state_.clock.SetHigh(content) && was_started, sink_.begin());
        wait_ = needs_time_low_ ? Wait::kTimeLow : Wait::kNothing;
        return;
      case evt3::kTimeLow:
        if (wait_ != Wait::kTimeLow) return;
        TimeIsSet(state_.clock.SetLow(content), sink_.begin());
        wait_ = Wait::kNothing;
        return;
      case evt3::kAddrX:
      case evt3::kExtTrigger:
        ++counts_.dropped_before_time;
        return;
      case evt3::kVect12:
        counts_.dropped_before_time += static_cast<uint64_t>(std::popcount(content));
        return;
      case evt3::kVect8:
        counts_.dropped_before_time += static_cast<uint64_t>(std::popcount(content & 0xff));
        return;
      case evt3::kAddrY:
      case evt3::kVectBaseX:
      case evt3::kContinued4:
      case evt3::kOthers:
      case evt3::kContinued12:
        return;
      default:
        CountUnknown(word);
    }
  }

  // Decodes a run of words with vector instructions and returns their number. Inlined, so that the variables of Run()
  // stay in registers.
  [[gnu::always_inline]] size_t DecodeRun(const uint8_t* words, size_t count, int64_t mark_due_us, uint32_t& row,
                                          int64_t& t_us, Event*& cursor) {
    Evt3Run run = {.width_px = width_,
                   .height_px = height_,
                   .base_us = state_.clock.base_us(),
                   .mark_due_us = mark_due_us,
                   .low_us = t_us - state_.clock.base_us(),
                   .row = row,
                   .base = state_.base};
    const size_t num_words = runs_->evt3(words, count, run, cursor, sink_.limit());
    row = run.row;
    state_.base = run.base;
    t_us = run.base_us + run.low_us;
    if (cursor >= sink_.limit()) cursor = sink_.Flush(cursor);
    return num_words;
  }

  // Decodes from word `index` on and returns the index of the first word that is not decoded. Without a row (kHasRow
  // false) it stops after the first ADDR_Y.
  template <bool kHasRow>
  size_t Run(const uint8_t* words, size_t index, size_t count) {
    const uint32_t width = width_;
    const uint32_t height = height_;
    Event* cursor = sink_.begin();
    uint64_t num_dropped = 0;
    uint64_t num_kept_outside = 0;
    int64_t t_us = state_.clock.now_us();
    int64_t mark_due_us = sink_.mark_due_us();
    uint32_t row = state_.row;
    while (index < count) {
      const uint32_t word = LoadWord<uint16_t>(words + 2 * index);
      if (kHasRow && runs_ != nullptr && (word & kNotAddress) == 0 && row < height) {
        const size_t num_words = DecodeRun(words + 2 * index, count - index, mark_due_us, row, t_us, cursor);
        index += num_words;
        if (num_words > 0) continue;
      }
      if ((word & kNotAddress) != 0) {
        const uint32_t type = word >> 12;
        const int64_t low_time_us = state_.clock.base_us() + (word & 0xfff);
        if (type == evt3::kTimeLow && low_time_us >= t_us && low_time_us < mark_due_us) [[likely]] {
          t_us = low_time_us;
          ++index;
          continue;
        }
        if (type == evt3::kVect12 && count - index < kTripleWords) break;
        state_.row = row;
        state_.clock.SetLow(t_us - state_.clock.base_us());
        cursor = type == evt3::kVect12 ? DecodeTriple(words + 2 * index, cursor)
                                       : DecodeOtherWord(type, word & 0xfff, cursor);
        row = state_.row;
        t_us = state_.clock.now_us();
        mark_due_us = sink_.mark_due_us();
        index += type == evt3::kVect12 ? kTripleWords : 1;
        continue;
      }
      ++index;
      const bool is_event = (word & kColumnBit) != 0;
      row = is_event ? row : word;
      const uint32_t x = word & 0x7ff;
      const bool inside = x < width;
      const bool emitted = is_event & (row < height) & (kKeepOutside | inside);
      StoreEvent(cursor, t_us, x, row, (word >> 11) & 1);
      cursor += emitted;
      num_dropped += is_event ^ emitted;
      if constexpr (kKeepOutside) num_kept_outside += emitted & !inside;
      if (cursor >= sink_.limit()) [[unlikely]]
        cursor = sink_.Flush(cursor);
      if constexpr (!kHasRow) {
        has_row_ = !is_event;
        if (has_row_) break;
      }
    }
    state_.row = row;
    state_.clock.SetLow(t_us - state_.clock.base_us());
    sink_.Flush(cursor);
    (kHasRow ? counts_.dropped_outside_sensor : counts_.dropped_before_time) += num_dropped;
    counts_.kept_outside_sensor += num_kept_outside;
    return index;
  }

  // Decodes a triple: masks of 12 + 12 + 8 pixels from the base on. The second and third word count as masks whatever
  // their types, as in OpenEB.
  Event* DecodeTriple(const uint8_t* words, Event* cursor) {
    const uint32_t first = LoadWord<uint16_t>(words);
    const uint32_t second = LoadWord<uint16_t>(words + 2);
    const uint32_t third = LoadWord<uint16_t>(words + 4);
    const uint32_t mask = (first & 0xfff) | (second & 0xfff) << 12 | (third & 0xff) << 24;
    const bool broken = second >> 12 != evt3::kVect12 || third >> 12 != evt3::kVect8;
    counts_.broken_vectors += broken || (state_.row < height_ && !state_.base.is_set);
    if (state_.row >= height_) {
      (has_row_ ? counts_.dropped_outside_sensor : counts_.dropped_before_time) +=
          static_cast<uint64_t>(std::popcount(mask));
      return cursor;
    }
    if (!state_.base.is_set) return cursor;
    const uint32_t x = state_.base.x;
    // A base outside the sensor stays unchanged, so that it cannot overflow.
    if (x < width_) state_.base.x += kEvt3MaskPixels;
    if (x + kEvt3MaskPixels > width_) {
      counts_.dropped_outside_sensor += static_cast<uint64_t>(std::popcount(mask));
      return cursor;
    }
    cursor = StorePixels(mask, state_.clock.now_us(), x, state_.row, state_.base.polarity, cursor);
    return cursor >= sink_.limit() ? sink_.Flush(cursor) : cursor;
  }

  Event* DecodeOtherWord(uint32_t type, uint32_t content, Event* cursor) {
    switch (type) {
      case evt3::kTimeHigh:
        return TimeIsSet(state_.clock.SetHigh(content), cursor);
      case evt3::kTimeLow:
        return TimeIsSet(state_.clock.SetLow(content), cursor);
      case evt3::kVectBaseX:
        state_.base = {true, content & 0x7ff, static_cast<uint8_t>(content >> 11)};
        return cursor;
      case evt3::kExtTrigger:
        sink_.AddTrigger(
            {state_.clock.now_us(), static_cast<uint8_t>(content >> 8), static_cast<uint8_t>(content & 1)});
        ++counts_.triggers;
        return cursor;
      case evt3::kVect8:  // the end of a triple without its beginning
        ++counts_.broken_vectors;
        return cursor;
      case evt3::kOthers:
      case evt3::kContinued4:
      case evt3::kContinued12:
        return cursor;
      case evt3::kReservedRow:  // the addresses until the next row are of another kind
        state_.row = kNoRow;
        [[fallthrough]];
      default:
        CountUnknown(type << 12 | content);
        return cursor;
    }
  }

  Event* TimeIsSet(bool continues, Event* cursor) { return sink_.SetTime(continues, state_.clock.now_us(), cursor); }

  const WordRuns* const runs_ = BestWordRuns();
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
