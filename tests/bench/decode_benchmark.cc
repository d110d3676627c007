// SPDX-License-Identifier: Apache-2.0

// Benchmarks, for use with a profiler, of decoding each format that can be written, and of copying the same bytes: the
// two terms of the ratio in `evpose bench speed`. EVT3_vectors is a recording of a driving car with many vector words;
// it is left out where the test data do not contain it.
//   build/release/tests/bench/decode_benchmark --benchmark_filter=EVT3
#include <benchmark/benchmark.h>

#include <cstring>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "core/events/decoder.h"
#include "core/recordings/recording_reader.h"
#include "tests/bench/benchmark_recordings.h"
#include "tests/data/test_data.h"

namespace evpose::bench {
namespace {

constexpr size_t kPieceBytes = size_t{256} * 1024;

constexpr char kVectors[] = "evt3_driving_gen41/evt3_sample.raw";

struct VectorRecording {
  std::vector<uint8_t> bytes;
  SensorGeometry geometry;
  uint64_t num_events = 0;
};

const VectorRecording& Vectors() {
  static const auto* const read = new VectorRecording([] {
    VectorRecording recording;
    const auto reader = RecordingReader::Open(FindTestData(kVectors)).value();
    recording.geometry = reader->header().geometry;
    recording.bytes.resize(static_cast<size_t>(reader->data_size_bytes()));
    for (size_t size = 0; size < recording.bytes.size();) {
      size += reader->Read(absl::MakeSpan(recording.bytes).subspan(size)).value();
    }
    const auto decoder = MakeEventDecoder(Encoding::kEvt3, recording.geometry).value();
    DecodedEvents decoded;
    decoder->Decode(recording.bytes, decoded);
    recording.num_events = decoded.events.size();
    return recording;
  }());
  return *read;
}

void CopyBytes(benchmark::State& state, absl::Span<const uint8_t> bytes) {
  std::vector<uint8_t> copy(bytes.size());
  for ([[maybe_unused]] auto _ : state) {
    std::memcpy(copy.data(), bytes.data(), bytes.size());
    benchmark::DoNotOptimize(copy.data());
    benchmark::ClobberMemory();
  }
  state.SetBytesProcessed(static_cast<int64_t>(state.iterations() * bytes.size()));
}

void DecodeBytes(benchmark::State& state, absl::Span<const uint8_t> bytes, Encoding encoding, SensorGeometry geometry,
                 uint64_t num_events) {
  DecodedEvents decoded;
  for ([[maybe_unused]] auto _ : state) {
    const auto decoder = MakeEventDecoder(encoding, geometry).value();
    for (size_t begin = 0; begin < bytes.size(); begin += kPieceBytes) {
      decoded.events.clear();
      decoded.time_marks.clear();
      decoder->Decode(bytes.subspan(begin, kPieceBytes), decoded);
    }
    if (decoder->counts().cd_events != num_events) state.SkipWithError("not all events were decoded");
  }
  state.SetBytesProcessed(static_cast<int64_t>(state.iterations() * bytes.size()));
  state.SetItemsProcessed(static_cast<int64_t>(state.iterations() * num_events));
}

void Copy(benchmark::State& state, const std::string& scene, Encoding encoding) {
  CopyBytes(state, BytesOf(scene, encoding));
}

void Decode(benchmark::State& state, const std::string& scene, Encoding encoding) {
  const SpeedRecording& recording = RecordingOf(scene);
  DecodeBytes(state, BytesOf(scene, encoding), encoding, recording.geometry, recording.events.size());
}

BENCHMARK_CAPTURE(Copy, EVT3_4, "4", Encoding::kEvt3);
BENCHMARK_CAPTURE(Decode, EVT3_4, "4", Encoding::kEvt3);
BENCHMARK_CAPTURE(Copy, EVT21_4, "4", Encoding::kEvt21);
BENCHMARK_CAPTURE(Decode, EVT21_4, "4", Encoding::kEvt21);
BENCHMARK_CAPTURE(Copy, EVT2_4, "4", Encoding::kEvt2);
BENCHMARK_CAPTURE(Decode, EVT2_4, "4", Encoding::kEvt2);
BENCHMARK_CAPTURE(Copy, FLAT64_4, "4", Encoding::kFlat64);
BENCHMARK_CAPTURE(Decode, FLAT64_4, "4", Encoding::kFlat64);

void DecodeVectors(benchmark::State& state) {
  DecodeBytes(state, Vectors().bytes, Encoding::kEvt3, Vectors().geometry, Vectors().num_events);
}
void CopyVectors(benchmark::State& state) { CopyBytes(state, Vectors().bytes); }

}  // namespace
}  // namespace evpose::bench

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  if (!evpose::FindTestData(evpose::bench::kVectors).empty()) {
    benchmark::RegisterBenchmark("Copy/EVT3_vectors", evpose::bench::CopyVectors);
    benchmark::RegisterBenchmark("Decode/EVT3_vectors", evpose::bench::DecodeVectors);
  }
  benchmark::RunSpecifiedBenchmarks();
}
