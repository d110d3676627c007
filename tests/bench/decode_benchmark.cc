// SPDX-License-Identifier: Apache-2.0

// Benchmarks, for use with a profiler, of decoding each format that can be written, and of copying the same bytes: the
// two terms of the ratio in `evpose bench speed`.
//   build/release/tests/bench/decode_benchmark --benchmark_filter=EVT3
#include <benchmark/benchmark.h>

#include <cstring>
#include <string>
#include <vector>

#include "tests/bench/benchmark_recordings.h"

namespace evpose::bench {
namespace {

constexpr size_t kPieceBytes = size_t{256} * 1024;

void Copy(benchmark::State& state, const std::string& scene, Encoding encoding) {
  const std::vector<uint8_t>& bytes = BytesOf(scene, encoding);
  std::vector<uint8_t> copy(bytes.size());
  for ([[maybe_unused]] auto _ : state) {
    std::memcpy(copy.data(), bytes.data(), bytes.size());
    benchmark::DoNotOptimize(copy.data());
    benchmark::ClobberMemory();
  }
  state.SetBytesProcessed(static_cast<int64_t>(state.iterations() * bytes.size()));
}

void Decode(benchmark::State& state, const std::string& scene, Encoding encoding) {
  const std::vector<uint8_t>& bytes = BytesOf(scene, encoding);
  const absl::Span<const uint8_t> all = bytes;
  const uint64_t num_events = RecordingOf(scene).events.size();
  DecodedEvents decoded;
  for ([[maybe_unused]] auto _ : state) {
    const auto decoder = MakeEventDecoder(encoding, RecordingOf(scene).geometry).value();
    for (size_t begin = 0; begin < all.size(); begin += kPieceBytes) {
      decoded.events.clear();
      decoded.time_marks.clear();
      decoder->Decode(all.subspan(begin, kPieceBytes), decoded);
    }
    if (decoder->counts().cd_events != num_events) state.SkipWithError("not all events were decoded");
  }
  state.SetBytesProcessed(static_cast<int64_t>(state.iterations() * bytes.size()));
  state.SetItemsProcessed(static_cast<int64_t>(state.iterations() * num_events));
}

BENCHMARK_CAPTURE(Copy, EVT3_4, "4", Encoding::kEvt3);
BENCHMARK_CAPTURE(Decode, EVT3_4, "4", Encoding::kEvt3);
BENCHMARK_CAPTURE(Copy, EVT21_4, "4", Encoding::kEvt21);
BENCHMARK_CAPTURE(Decode, EVT21_4, "4", Encoding::kEvt21);
BENCHMARK_CAPTURE(Copy, EVT2_4, "4", Encoding::kEvt2);
BENCHMARK_CAPTURE(Decode, EVT2_4, "4", Encoding::kEvt2);
BENCHMARK_CAPTURE(Copy, FLAT64_4, "4", Encoding::kFlat64);
BENCHMARK_CAPTURE(Decode, FLAT64_4, "4", Encoding::kFlat64);

}  // namespace
}  // namespace evpose::bench

BENCHMARK_MAIN();
