// SPDX-License-Identifier: Apache-2.0

// Fuzz target for all decoders with arbitrary bytes: events are inside the sensor, time marks are in the order of the
// events, and a stream that is split anywhere, or after a loss, decodes as in one piece.
#include <iterator>
#include <memory>

#include "core/events/decoder.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

constexpr Encoding kEncodings[] = {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat,
                                   Encoding::kFlat64};

struct Decoded {
  DecodedEvents events;
  DecodeCounts counts;
  int pending_bytes = 0;
};

bool SameEvent(const Event& a, const Event& b) {
  return a.t_us == b.t_us && a.x == b.x && a.y == b.y && a.polarity == b.polarity;
}

void Feed(EventDecoder& decoder, absl::Span<const uint8_t> bytes, size_t piece_bytes, DecodedEvents& events) {
  while (!bytes.empty()) {
    const absl::Span<const uint8_t> piece = bytes.subspan(0, piece_bytes);
    decoder.Decode(piece, events);
    bytes.remove_prefix(piece.size());
  }
}

Decoded Decode(Encoding encoding, SensorGeometry sensor, absl::Span<const uint8_t> before_loss,
               absl::Span<const uint8_t> after_loss, size_t piece_bytes) {
  const std::unique_ptr<EventDecoder> decoder = MakeEventDecoder(encoding, sensor).value();
  Decoded decoded;
  Feed(*decoder, before_loss, piece_bytes, decoded.events);
  if (!after_loss.empty()) decoder->ResetAfterLoss();
  Feed(*decoder, after_loss, piece_bytes, decoded.events);
  decoded.counts = decoder->counts();
  decoded.pending_bytes = decoder->pending_bytes();
  return decoded;
}

void Check(const Decoded& decoded, SensorGeometry sensor) {
  size_t index = 0;
  for (const TimeMark& mark : decoded.events.time_marks) {
    EVPOSE_FUZZ_REQUIRE(mark.event_index >= index && mark.event_index <= decoded.events.events.size());
    index = mark.event_index;
  }
  for (const Event& event : decoded.events.events) {
    EVPOSE_FUZZ_REQUIRE(event.t_us >= 0 && event.polarity <= 1);
    EVPOSE_FUZZ_REQUIRE(event.x < sensor.width_px && event.y < sensor.height_px);
  }
  EVPOSE_FUZZ_REQUIRE(decoded.events.events.size() == decoded.counts.cd_events);
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  FuzzInput input(data, size);
  const Encoding encoding = kEncodings[input.Choice(std::size(kEncodings))];
  const SensorGeometry sensor = input.Choice(2) == 0 ? SensorGeometry{1280, 720} : SensorGeometry{640, 480};
  const size_t piece_bytes = 1 + input.Choice(16);
  const size_t loss_at = input.Word();
  const absl::Span<const uint8_t> bytes = input.Rest();
  const absl::Span<const uint8_t> before = bytes.subspan(0, loss_at);
  const absl::Span<const uint8_t> after = bytes.subspan(before.size());

  const Decoded whole = Decode(encoding, sensor, before, after, absl::Span<const uint8_t>::npos);
  const Decoded cut = Decode(encoding, sensor, before, after, piece_bytes);
  Check(whole, sensor);
  EVPOSE_FUZZ_REQUIRE(whole.counts == cut.counts && whole.pending_bytes == cut.pending_bytes);
  EVPOSE_FUZZ_REQUIRE(whole.events.events.size() == cut.events.events.size());
  for (size_t i = 0; i < whole.events.events.size(); ++i) {
    EVPOSE_FUZZ_REQUIRE(SameEvent(whole.events.events[i], cut.events.events[i]));
  }
  return 0;
}
