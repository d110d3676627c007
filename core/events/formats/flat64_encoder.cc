// SPDX-License-Identifier: Apache-2.0
#include <cstdint>

#include "core/events/formats/word_encoder.h"

namespace evpose {
namespace {

// A decoder finds the right wrap only for steps within half the range of 32 bits, and there are no time words in
// between.
constexpr TimeLimits kFlat64Limits = {
    .max_first_us = (int64_t{1} << 32) - 1, .max_gap_us = (int64_t{1} << 31) - 1, .has_time_words = false};

class Flat64Encoder final : public WordEncoder {
 public:
  explicit Flat64Encoder(SensorGeometry geometry) : WordEncoder(geometry, kFlat64Limits) {}

 private:
  void EncodeChecked(absl::Span<const Event> events, std::vector<uint8_t>& out) override {
    for (const Event& event : events) {
      const auto t = static_cast<uint64_t>(event.t_us & 0xffffffff);
      AppendWord(t << 32 | static_cast<uint64_t>(event.x) << 18 | static_cast<uint64_t>(event.y) << 4 | event.polarity,
                 out);
    }
  }

  void EncodeCheckedTime(int64_t /*t_us*/, std::vector<uint8_t>& /*out*/) override {}
};

}  // namespace

std::unique_ptr<EventEncoder> MakeFlat64Encoder(SensorGeometry geometry) {
  return std::make_unique<Flat64Encoder>(geometry);
}

}  // namespace evpose
