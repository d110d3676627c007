// SPDX-License-Identifier: Apache-2.0

// Fuzz target for AEDAT recordings of all versions with arbitrary bytes. The events do not depend on the cuts of the
// bytes; headers are the same for the whole file and for a prefix that contains them.
#include <algorithm>
#include <functional>
#include <memory>
#include <string>

#include "client/containers/aedat/aedat4_decoder.h"
#include "client/containers/aedat/aedat_decoder.h"
#include "client/containers/aedat/aedat_header.h"
#include "core/base/byte_order.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

using namespace client;
using Maker = std::function<std::unique_ptr<AedatDecoder>()>;

struct Result {
  DecodedEvents out;
  AedatCounts counts;
};

Result DecodeInPiecesOf(const Maker& make, absl::Span<const uint8_t> bytes, size_t piece_bytes) {
  const std::unique_ptr<AedatDecoder> decoder = make();
  Result result;
  for (; !bytes.empty(); bytes.remove_prefix(std::min(piece_bytes, bytes.size()))) {
    absl::Span<const uint8_t> piece = bytes.subspan(0, piece_bytes);
    while (!piece.empty()) decoder->Decode(piece, result.out);
  }
  decoder->Finish();
  result.counts = decoder->counts();
  return result;
}

void CheckCuts(const Maker& make, absl::Span<const uint8_t> bytes, size_t piece_bytes) {
  const Result whole = DecodeInPiecesOf(make, bytes, std::max<size_t>(1, bytes.size()));
  const Result pieces = DecodeInPiecesOf(make, bytes, piece_bytes);
  EVPOSE_FUZZ_REQUIRE(whole.out.events == pieces.out.events && whole.out.triggers == pieces.out.triggers);
  EVPOSE_FUZZ_REQUIRE(whole.counts == pieces.counts);
  EVPOSE_FUZZ_REQUIRE(whole.counts.cd_events == whole.out.events.size());
  for (const Event& event : whole.out.events) {
    EVPOSE_FUZZ_REQUIRE(event.t_us >= 0 && event.t_us <= kMaxStateTimeUs && event.polarity <= 1);
  }
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  using namespace evpose::client;
  FuzzInput input(data, size);
  const size_t piece_bytes = 1u + input.Byte();
  const std::string file = input.RestAsText();
  const absl::Span<const uint8_t> bytes = AsBytes(file);
  const auto header = ParseAedatHeader(file, true);
  if (!header.ok()) return 0;
  EVPOSE_FUZZ_REQUIRE(header->has_value() && (*header)->size_bytes <= file.size());
  const auto prefix = ParseAedatHeader(absl::string_view(file).substr(0, piece_bytes), false);
  if (prefix.ok() && prefix->has_value()) EVPOSE_FUZZ_REQUIRE((*prefix)->size_bytes == (*header)->size_bytes);
  const absl::Span<const uint8_t> rest = bytes.subspan((*header)->size_bytes);
  if ((*header)->version == AedatVersion::k4) {
    const auto header4 = ParseAedat4Header(bytes, true);
    if (!header4.ok()) return 0;
    CheckCuts([&] { return MakeAedat4Decoder(**header4); }, bytes.subspan((*header4)->size_bytes), piece_bytes);
  } else if ((*header)->version == AedatVersion::k31) {
    CheckCuts([&] { return MakeAedat3Decoder((*header)->geometry); }, rest, piece_bytes);
  } else {
    const bool is_known = (*header)->layout != Aedat2Layout::kUnknown;
    const Aedat2Layout layout = is_known ? (*header)->layout : Aedat2Layout::kDvs128;
    const SensorGeometry geometry = is_known ? (*header)->geometry : SensorGeometry{128, 128};
    CheckCuts([&] { return MakeAedat2Decoder(layout, geometry); }, rest, piece_bytes);
  }
  return 0;
}
