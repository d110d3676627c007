// SPDX-License-Identifier: Apache-2.0

// The common part of the decoders of EVT 2.0 and EVT 2.1: the clock, the words other than events, and runs of events.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "core/events/formats/sensor_clock.h"
#include "core/events/formats/word_decoder.h"
#include "core/events/formats/word_runs.h"
#include "core/events/formats/word_types.h"

namespace evpose {

class Evt2WordDecoder : public WordDecoder {
  static_assert(kMaxRunBlock <= EventSink::kMaxEventsOfWord);

 public:
  void SaveState(StateWriter& writer) const override { VisitState(writer, *this); }
  void LoadState(StateReader& reader) override { VisitState(reader, *this); }
  static void VisitState(auto& archive, auto& self) {
    VisitWords(archive, self);
    archive(self.clock_, self.has_time_);
  }

 protected:
  // `runs` is a member of WordRuns, or null.
  Evt2WordDecoder(int word_bytes, SensorGeometry geometry, OutsideSensor outside, DecodeRunOf<Evt2Run> runs)
      : WordDecoder(word_bytes),
        width_(static_cast<uint32_t>(geometry.width_px)),
        height_(static_cast<uint32_t>(geometry.height_px)),
        keep_outside_(outside == OutsideSensor::kKeep),
        runs_(runs) {}

  // Decodes the run that begins at word `index`, if any, and moves `index`. Returns the index of the word, at most
  // `count`, at which to look for the next run (RunPause).
  size_t DecodeRun(const uint8_t* words, size_t count, size_t& index, Evt2Clock& clock, Event*& cursor) {
    constexpr int64_t kMaxLow_us = 63;
    if (runs_ == nullptr) return count;
    Evt2Run run = {width_, height_, clock.base_us(), sink_.mark_due_us(), clock.now_us() - clock.base_us()};
    size_t num_words = 0;
    // A loaded state may have any times.
    const bool is_of_base = run.low_us >= 0 && run.low_us <= kMaxLow_us && (run.base_us & kMaxLow_us) == 0;
    if (has_time_ && is_of_base) {
      num_words = runs_(words + word_bytes() * index, count - index, run, cursor, sink_.limit());
      clock.SetLow(run.low_us);
      if (cursor >= sink_.limit()) cursor = sink_.Flush(cursor);
    }
    index += num_words;
    return index + std::min(pause_.WordsAfter(num_words), count - index);
  }

  // Decodes a word (EVT2.1: the upper half of a word) that is not an event.
  Event* DecodeRareWord(uint32_t type, uint32_t content, Evt2Clock& clock, Event* cursor) {
    switch (type) {
      case evt2::kTimeHigh: {
        const bool was_started = clock.started();
        has_time_ = true;
        if (!clock.SetHigh(content) || !was_started) {
          sink_.RestartMarks(cursor, clock.now_us());
        } else if (clock.now_us() >= sink_.mark_due_us()) {
          return sink_.MarkTime(cursor, clock.now_us());
        }
        return cursor;
      }
      case evt2::kExtTrigger:
        if (!has_time_) {
          ++counts_.dropped_before_time;
          return cursor;
        }
        if (!clock.SetLow((content >> 22) & 0x3f)) sink_.RestartMarks(cursor, clock.now_us());
        sink_.AddTrigger(
            {clock.now_us(), static_cast<uint8_t>((content >> 8) & 0x1f), static_cast<uint8_t>(content & 1)});
        ++counts_.triggers;
        return cursor;
      case evt2::kOthers:
      case evt2::kContinued:
        return cursor;
      default:
        ++counts_.unknown_words;
        return cursor;
    }
  }

  // Ends a call after its last word.
  void Finish(const Evt2Clock& clock, Event* cursor) {
    sink_.Flush(cursor);
    clock_ = clock;
    counts_.cd_events = sink_.num_events();
    counts_.clock_wraps = clock.wraps();
    counts_.time_backsteps = clock.backsteps();
  }

  void Forget() override { has_time_ = false; }

  const uint32_t width_;
  const uint32_t height_;
  const bool keep_outside_;
  const DecodeRunOf<Evt2Run> runs_;
  Evt2Clock clock_;
  bool has_time_ = false;
  RunPause pause_;  // not saved: it does not influence the events
};

}  // namespace evpose
