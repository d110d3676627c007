// SPDX-License-Identifier: Apache-2.0

// The unwrapped clocks of the encodings (core/events/README.md, section 2). Decoders and the chunker share them, so
// that both have the same time.
#pragma once

#include <algorithm>
#include <cstdint>

#include "core/base/state_io.h"
#include "core/events/event.h"

namespace evpose {

// No time of a clock is larger, whatever the words: a state that is saved can be loaded, and no sum overflows. A range
// of wraps below kMaxStateTimeUs, so that times that are derived from it stay below that limit, too.
constexpr int64_t MaxClockTimeUs(int64_t range_us) { return kMaxStateTimeUs - range_us; }

// EVT3: 12 bits of TIME_HIGH and 12 of TIME_LOW; wraps every 16.8 s.
class Evt3Clock {
 public:
  static constexpr int64_t kRangeUs = int64_t{1} << 24;

  bool started() const { return has_started_; }
  int64_t now_us() const { return base_us_ + low_us_; }
  // The time of TIME_HIGH alone.
  int64_t base_us() const { return base_us_; }
  uint64_t wraps() const { return wraps_; }
  uint64_t backsteps() const { return backsteps_; }

  // Returns false if the time stepped back. A step back by half the counter's range or more is a wrap, except beyond
  // the largest time. A new TIME_HIGH sets TIME_LOW to 0; the same one again changes nothing.
  bool SetHigh(int64_t high) {
    const int64_t previous_high = (base_us_ >> 12) & 0xfff;
    if (has_started_ && high == previous_high) return true;
    const int64_t before_us = has_started_ ? now_us() : 0;
    const bool wraps = has_started_ && previous_high >= 2048 + high && base_us_ < MaxClockTimeUs(2 * kRangeUs);
    wraps_ += wraps;
    base_us_ = (((base_us_ >> 24) + wraps) << 24) | (high << 12);
    low_us_ = 0;
    has_started_ = true;
    backsteps_ += base_us_ < before_us;
    return base_us_ >= before_us;
  }

  // Returns false if the time stepped back, which is never a wrap.
  bool SetLow(int64_t low_us) {
    const bool is_forward = low_us >= low_us_;
    backsteps_ += !is_forward;
    low_us_ = low_us;
    return is_forward;
  }

  static void VisitState(auto& archive, auto& self) {
    auto& [base_us, low_us, wraps, backsteps, started] = self;
    archive(InRange(base_us, 0, kMaxStateTimeUs), InRange(low_us, 0, 0xfff), wraps, backsteps, started);
  }

 private:
  int64_t base_us_ = 0;
  int64_t low_us_ = 0;
  uint64_t wraps_ = 0;
  uint64_t backsteps_ = 0;
  bool has_started_ = false;
};

// EVT2 and EVT2.1: 28 bits of TIME_HIGH above the 6 bits that every event carries; wraps every 4.77 hours.
class Evt2Clock {
 public:
  // A step back is a wrap if it is at least the range less this: a camera sends a TIME_HIGH more often, so that a wrap
  // is recognised also when words were lost.
  static constexpr int64_t kWrapToleranceUs = 10000;
  static constexpr int64_t kRangeUs = int64_t{1} << 34;

  bool started() const { return has_started_; }
  int64_t now_us() const { return now_us_; }
  int64_t base_us() const { return base_us_; }
  uint64_t wraps() const { return wraps_; }
  uint64_t backsteps() const { return backsteps_; }

  // Returns false if the time stepped back.
  bool SetHigh(int64_t high) {
    int64_t base_us = epoch_us_ + (high << 6);
    if (has_started_ && base_us == base_us_) return true;
    if (has_started_ && base_us_ - base_us >= kRangeUs - 64 - kWrapToleranceUs &&
        base_us_ < MaxClockTimeUs(2 * kRangeUs)) {
      epoch_us_ += kRangeUs;
      base_us += kRangeUs;
      ++wraps_;
    }
    base_us_ = base_us;
    return Advance(base_us);
  }

  // Sets the low bits from an event or trigger; returns false if the time stepped back.
  bool SetLow(int64_t low_us) { return Advance(base_us_ + low_us); }

  static void VisitState(auto& archive, auto& self) {
    auto& [epoch_us, base_us, now_us, wraps, backsteps, started] = self;
    archive(InRange(epoch_us, 0, kMaxStateTimeUs), InRange(base_us, 0, kMaxStateTimeUs),
            InRange(now_us, 0, kMaxStateTimeUs), wraps, backsteps, started);
  }

 private:
  bool Advance(int64_t now_us) {
    const bool is_forward = !has_started_ || now_us >= now_us_;
    backsteps_ += !is_forward;
    now_us_ = now_us;
    has_started_ = true;
    return is_forward;
  }

  int64_t epoch_us_ = 0;
  int64_t base_us_ = 0;
  int64_t now_us_ = 0;
  uint64_t wraps_ = 0;
  uint64_t backsteps_ = 0;
  bool has_started_ = false;
};

// DAT and FLAT64: 32 bits in every word; wraps every 71.6 minutes.
class Clock32 {
 public:
  static constexpr int64_t kRangeUs = int64_t{1} << 32;

  bool started() const { return has_started_; }
  int64_t now_us() const { return now_us_; }
  uint64_t wraps() const { return wraps_; }
  uint64_t backsteps() const { return backsteps_; }

  // Chooses, among the times with these low 32 bits, the one nearest to the last time, so that a late word after a wrap
  // remains late. Returns false if the time stepped back.
  bool Set(uint32_t t_us) {
    if (!has_started_) {
      has_started_ = true;
      now_us_ = t_us;
      return true;
    }
    const auto step_us = static_cast<int32_t>(t_us - static_cast<uint32_t>(now_us_));
    int64_t next_us = now_us_ + step_us;
    if (next_us < 0) next_us += kRangeUs;                         // no time is negative: a large step forward instead
    if (next_us > MaxClockTimeUs(kRangeUs)) next_us -= kRangeUs;  // or beyond the largest time: a step back instead
    const bool is_forward = next_us >= now_us_;
    backsteps_ += !is_forward;
    wraps_ = std::max(wraps_, static_cast<uint64_t>(next_us >> 32));
    now_us_ = next_us;
    return is_forward;
  }

  static void VisitState(auto& archive, auto& self) {
    auto& [now_us, wraps, backsteps, started] = self;
    archive(InRange(now_us, 0, kMaxStateTimeUs), wraps, backsteps, started);
  }

 private:
  int64_t now_us_ = 0;
  uint64_t wraps_ = 0;
  uint64_t backsteps_ = 0;
  bool has_started_ = false;
};

}  // namespace evpose
