// SPDX-License-Identifier: Apache-2.0
#include <cstdint>

#include "core/events/word_encoder.h"
#include "core/events/word_types.h"

namespace evpose {
namespace {

constexpr int64_t kEvt3HighRange = 4096;  // values of TIME_HIGH, which has 12 bits
// A quarter of the counter's range: decoders take a step back by half the range or more as a wrap, so that steps
// forward up to a quarter are unambiguous.
constexpr int64_t kMaxHighStep = 1024;

class Evt3Encoder final : public WordEncoder {
 public:
  explicit Evt3Encoder(SensorGeometry geometry) : WordEncoder(geometry, {.num_trigger_inputs = 16}) {}

 private:
  void EncodeChecked(absl::Span<const Event> events, std::vector<uint8_t>& out) override {
    while (!events.empty()) {
      const Event& first = events.front();
      if (first.t_us != t_us_) WriteTime(first.t_us, out);
      if (first.y != row_) {
        row_ = first.y;
        Append(evt3::kAddrY, first.y, out);
      }
      const size_t length = VectorRunLength(events);
      if (!WriteVector(events.subspan(0, length), out)) {
        for (const Event& event : events.subspan(0, length)) {
          Append(evt3::kAddrX, static_cast<uint32_t>(event.polarity) << 11 | event.x, out);
        }
      }
      events.remove_prefix(length);
    }
  }

  void EncodeCheckedTime(int64_t t_us, std::vector<uint8_t>& out) override {
    if (t_us != t_us_) WriteTime(t_us, out);
  }

  void EncodeCheckedTrigger(const Trigger& trigger, std::vector<uint8_t>& out) override {
    EncodeCheckedTime(trigger.t_us, out);
    Append(evt3::kExtTrigger, static_cast<uint32_t>(trigger.id) << 8 | trigger.polarity, out);
  }

  // Writes a TIME_HIGH in each period of 16 us that has a time, as a camera does, and further ones over a gap, so that
  // a decoder misses no wrap. The row is written again after each time, which limits the damage of a lost word.
  void WriteTime(int64_t t_us, std::vector<uint8_t>& out) {
    const int64_t high = t_us >> 12;
    int64_t written = t_us_ < 0 ? high : t_us_ >> 12;
    if (t_us_ < 0 && high >= kEvt3HighRange) {
      // A decoder starts without wraps: a first time after a wrap needs the TIME_HIGHs before it.
      written = 0;
      Append(evt3::kTimeHigh, 0, out);
    }
    while (high - written > kMaxHighStep) {
      written += kMaxHighStep;
      Append(evt3::kTimeHigh, static_cast<uint32_t>(written & 0xfff), out);
    }
    if (t_us_ < 0 || t_us / kTimeWordPeriodUs != t_us_ / kTimeWordPeriodUs) {
      Append(evt3::kTimeHigh, static_cast<uint32_t>(high & 0xfff), out);
    }
    Append(evt3::kTimeLow, static_cast<uint32_t>(t_us & 0xfff), out);
    t_us_ = t_us;
    row_ = -1;
    vector_end_ = -1;
  }

  // Writes a run as a vector. Returns false, without writing, if single events are not longer, or if the vector would
  // reach over the right edge of the sensor, where decoders drop it.
  bool WriteVector(absl::Span<const Event> run, std::vector<uint8_t>& out) {
    const Event& first = run.front();
    const int base = first.x / kVectorPixels * kVectorPixels;
    // A triple advances the base to its end: a vector that continues there needs no VECT_BASE_X.
    const bool continues = vector_end_ == base && vector_row_ == first.y && vector_polarity_ == first.polarity;
    const size_t num_words = continues ? 3 : 4;
    if (run.size() <= num_words || base + kVectorPixels > geometry_.width_px) return false;
    if (!continues)
      Append(evt3::kVectBaseX, static_cast<uint32_t>(first.polarity) << 11 | static_cast<uint32_t>(base), out);
    const uint32_t mask = VectorMask(run);
    Append(evt3::kVect12, mask & 0xfff, out);
    Append(evt3::kVect12, mask >> 12 & 0xfff, out);
    Append(evt3::kVect8, mask >> 24, out);
    vector_end_ = base + kVectorPixels;
    vector_row_ = first.y;
    vector_polarity_ = first.polarity;
    return true;
  }

  static void Append(uint32_t type, uint32_t content, std::vector<uint8_t>& out) {
    AppendWord(static_cast<uint16_t>(type << 12 | content), out);
  }

  int64_t t_us_ = -1;
  int row_ = -1;
  int vector_end_ = -1;
  int vector_row_ = -1;
  int vector_polarity_ = 0;
};

}  // namespace

std::unique_ptr<EventEncoder> MakeEvt3Encoder(SensorGeometry geometry) {
  return std::make_unique<Evt3Encoder>(geometry);
}

}  // namespace evpose
