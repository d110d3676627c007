// SPDX-License-Identifier: Apache-2.0

// Encoders of formats in which each word is a complete event: DAT and FLAT64.
#include <cstdint>

#include "core/events/word_encoder.h"

namespace evpose {
namespace {

// A decoder finds the right wrap only for steps within half the range of 32 bits, and there are no time words in
// between.
constexpr TimeLimits FullAddressLimits(int num_trigger_inputs) {
  return {.max_first_us = (int64_t{1} << 32) - 1,
          .max_gap_us = (int64_t{1} << 31) - 1,
          .has_time_words = false,
          .num_trigger_inputs = num_trigger_inputs};
}

struct DatFields {
  static constexpr int kNumTriggerInputs = 0;
  static constexpr uint64_t kTrigger = 0;
  static uint64_t Pack(uint64_t t_us, uint64_t x, uint64_t y, uint64_t polarity) {
    return polarity << 60 | y << 46 | x << 32 | t_us;
  }
};

struct Flat64Fields {
  static constexpr int kNumTriggerInputs = 256;
  static constexpr uint64_t kTrigger = 2;
  static uint64_t Pack(uint64_t t_us, uint64_t x, uint64_t y, uint64_t polarity) {
    return t_us << 32 | x << 18 | y << 4 | polarity;
  }
};

template <typename Fields>
class FullAddressEncoder final : public WordEncoder {
 public:
  explicit FullAddressEncoder(SensorGeometry geometry)
      : WordEncoder(geometry, FullAddressLimits(Fields::kNumTriggerInputs)) {}

 private:
  void EncodeChecked(absl::Span<const Event> events, std::vector<uint8_t>& out) override {
    for (const Event& event : events) {
      const auto t_us = static_cast<uint64_t>(event.t_us & 0xffffffff);
      AppendWord(Fields::Pack(t_us, event.x, event.y, event.polarity), out);
    }
  }

  void EncodeCheckedTime(int64_t /*t_us*/, std::vector<uint8_t>& /*out*/) override {}

  void EncodeCheckedTrigger(const Trigger& trigger, std::vector<uint8_t>& out) override {
    const auto t_us = static_cast<uint64_t>(trigger.t_us & 0xffffffff);
    AppendWord(Fields::Pack(t_us, trigger.id, 0, trigger.polarity) | Fields::kTrigger, out);
  }
};

}  // namespace

std::unique_ptr<EventEncoder> MakeDatEncoder(SensorGeometry geometry) {
  return std::make_unique<FullAddressEncoder<DatFields>>(geometry);
}
std::unique_ptr<EventEncoder> MakeFlat64Encoder(SensorGeometry geometry) {
  return std::make_unique<FullAddressEncoder<Flat64Fields>>(geometry);
}

}  // namespace evpose
