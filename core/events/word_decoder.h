// SPDX-License-Identifier: Apache-2.0

// The common part of the decoders: words that are cut by calls, the output buffer, time marks.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/events/decoder.h"
#include "core/events/event.h"

namespace evpose {

static_assert(std::endian::native == std::endian::little, "words are read as the little-endian machine stores them");

template <typename Word>
Word LoadWord(const uint8_t* bytes) {
  Word word;
  std::memcpy(&word, bytes, sizeof(Word));
  return word;
}

// Writes an event with two stores of 8 bytes. Four smaller stores would be the bottleneck of the inner loops.
inline void StoreEvent(Event* event, int64_t t_us, uint32_t x, uint32_t y, uint32_t polarity) {
  static_assert(sizeof(Event) == 16 && offsetof(Event, x) == 8 && offsetof(Event, y) == 10 &&
                offsetof(Event, polarity) == 12);
  const uint64_t rest =
      static_cast<uint64_t>(x) | static_cast<uint64_t>(y) << 16 | static_cast<uint64_t>(polarity) << 32;
  const uint64_t words[2] = {static_cast<uint64_t>(t_us), rest};
  std::memcpy(static_cast<void*>(event), words, sizeof(words));
}

// Appends events to the output. There is always room for the events of a few words, so that the inner loops write
// without a check of capacity for each event.
class EventSink {
 public:
  static constexpr size_t kRoom = 4096;           // events: 64 KiB, so that the output grows rarely
  static constexpr size_t kMaxEventsOfWord = 32;  // a vector of EVT2.1 or, as a triple, of EVT3

  // Starts a call that decodes `num_words` words; few words need little room.
  void Begin(DecodedEvents& out, size_t num_words) {
    out_ = &out;
    room_ = num_words < kRoom / kMaxEventsOfWord ? kMaxEventsOfWord * (num_words + 2) : kRoom;
    MakeRoom(out.events.size());
  }
  // Ends the call: the output has the flushed events.
  void End() { out_->events.resize(num_written()); }

  Event* begin() { return begin_; }
  // A cursor at or beyond the limit must be flushed before the next word.
  const Event* limit() const { return limit_; }

  // Adds the events before `cursor` to the output and makes room; returns the new cursor. Changes limit().
  Event* Flush(Event* cursor) {
    if (cursor != begin_) {
      last_event_us_ = cursor[-1].t_us;
      num_events_ += static_cast<uint64_t>(cursor - begin_);
      begin_ = cursor;
    }
    if (begin_ >= limit_) MakeRoom(num_written());
    return begin_;
  }

  void AddTrigger(const Trigger& trigger) { out_->triggers.push_back(trigger); }

  // Restarts the millisecond of time marks: the clock has started or stepped back.
  void RestartMarks(const Event* cursor, int64_t now_us) {
    events_at_mark_ = num_events_ + static_cast<uint64_t>(cursor - begin_);
    mark_due_us_ = now_us + kMarkPeriodUs;
  }

  // The earliest time of the next time mark.
  int64_t mark_due_us() const { return mark_due_us_; }

  // To be called after a time word; `continues` is false if the clock has started or stepped back. Returns the new
  // cursor.
  Event* SetTime(bool continues, int64_t now_us, Event* cursor) {
    if (continues && now_us >= mark_due_us_) return MarkTime(cursor, now_us);
    if (!continues) RestartMarks(cursor, now_us);
    return cursor;
  }

  // To be called when the time has reached mark_due_us(): adds a mark unless there was an event since. Returns the new
  // cursor.
  Event* MarkTime(Event* cursor, int64_t now_us) {
    Event* const flushed = Flush(cursor);
    if (num_events_ > events_at_mark_) {
      events_at_mark_ = num_events_;
      mark_due_us_ = last_event_us_ + kMarkPeriodUs;
    }
    if (now_us >= mark_due_us_) {
      out_->time_marks.push_back({num_written(), now_us});
      mark_due_us_ = now_us + kMarkPeriodUs;
    }
    return flushed;
  }

  uint64_t num_events() const { return num_events_; }

  // Only between calls, when all events are flushed.
  static void VisitState(auto& archive, auto& self) {
    auto& [out, room, begin, limit, num_events, events_at_mark, last_event_us, mark_due_us] = self;
    archive(num_events, events_at_mark, InRange(last_event_us, -kMaxStateTimeUs, kMaxStateTimeUs),
            InRange(mark_due_us, -kMaxStateTimeUs, kMaxStateTimeUs));
  }

 private:
  static constexpr int64_t kMarkPeriodUs = 1000;  // event.h

  size_t num_written() const { return static_cast<size_t>(begin_ - out_->events.data()); }

  // Makes room after the first `num_written` events.
  void MakeRoom(size_t num_written) {
    EventVector& events = out_->events;
    events.resize(num_written + room_);
    begin_ = events.data() + num_written;
    limit_ = events.data() + events.size() - kMaxEventsOfWord;
  }

  DecodedEvents* out_ = nullptr;
  size_t room_ = kRoom;
  Event* begin_ = nullptr;        // the first event that is not flushed
  const Event* limit_ = nullptr;  // room remains after it for the events of a word or of a block of a run
  uint64_t num_events_ = 0;
  uint64_t events_at_mark_ = 0;
  int64_t last_event_us_ = 0;
  int64_t mark_due_us_ = 0;
};

// Joins the bytes of calls to whole words.
class WordDecoder : public EventDecoder {
 public:
  void Decode(absl::Span<const uint8_t> bytes, DecodedEvents& out) final;
  void ResetAfterLoss() final;
  int pending_bytes() const final { return static_cast<int>(num_pending_); }

 protected:
  WordDecoder(size_t word_bytes, SensorGeometry geometry, OutsideSensor outside)
      : width_(static_cast<uint32_t>(geometry.width_px)),
        height_(static_cast<uint32_t>(geometry.height_px)),
        keep_outside_(outside == OutsideSensor::kKeep),
        word_bytes_(word_bytes) {}

  // Decodes `count` words and returns the number of decoded ones. Fewer than `count` only at the end of an incomplete
  // vector triple, at most two; they are passed again together with the next word.
  virtual size_t DecodeWords(const uint8_t* words, size_t count) = 0;
  // Discards the state that a lost word may have changed.
  virtual void DiscardState() = 0;

  // The state of this base class; `self` is a WordDecoder.
  static void VisitWords(auto& archive, auto& self) {
    archive(self.counts_, self.sink_, AtMost(self.num_pending_, kMaxPending - 1), self.pending_);
  }

  // Sets the counts that the sink and the clock contain, at the end of DecodeWords().
  void UpdateCounts(const auto& clock) {
    counts_.cd_events = sink_.num_events();
    counts_.clock_wraps = clock.wraps();
    counts_.time_backsteps = clock.backsteps();
  }
  void CountOutside(uint64_t num_events) {
    (keep_outside_ ? counts_.kept_outside_sensor : counts_.dropped_outside_sensor) += num_events;
  }

  const uint32_t width_;
  const uint32_t height_;
  const bool keep_outside_;
  EventSink sink_;

 private:
  static constexpr size_t kMaxPending = 8;  // bytes: a word of 64 bits, or a triple of EVT3

  const size_t word_bytes_;
  size_t num_pending_ = 0;
  std::array<uint8_t, kMaxPending> pending_{};
};

std::unique_ptr<EventDecoder> MakeEvt3Decoder(SensorGeometry geometry, OutsideSensor outside);
std::unique_ptr<EventDecoder> MakeEvt21Decoder(SensorGeometry geometry, OutsideSensor outside);
std::unique_ptr<EventDecoder> MakeEvt2Decoder(SensorGeometry geometry, OutsideSensor outside);
std::unique_ptr<EventDecoder> MakeDatDecoder(SensorGeometry geometry, OutsideSensor outside);
std::unique_ptr<EventDecoder> MakeFlat64Decoder(SensorGeometry geometry, OutsideSensor outside);

}  // namespace evpose
