// SPDX-License-Identifier: Apache-2.0

// Fuzz target for chunks of ECF and for the records between evpose and evpose-hdf5, with arbitrary bytes: a chunk is
// refused, or its events are encoded again and decoded to the same.
#include <vector>

#include "client/containers/hdf5/ecf_codec.h"
#include "client/containers/hdf5/event_pipe.h"
#include "tests/fuzz/require.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  using namespace evpose::client;
  const absl::Span<const uint8_t> bytes(data, size);
  EventVector events;
  if (DecodeEcfChunk(bytes, events).ok()) {
    EVPOSE_FUZZ_REQUIRE(events.size() <= kEcfMaxEvents);
    std::vector<uint8_t> chunk;
    // A mask can name a column beyond the last one that ECF has a number for.
    if (!events.empty() && EncodeEcfChunk(events, chunk).ok()) {
      EventVector again;
      EVPOSE_FUZZ_REQUIRE(DecodeEcfChunk(chunk, again).ok());
      EVPOSE_FUZZ_REQUIRE(again == events);
    }
  } else {
    EVPOSE_FUZZ_REQUIRE(events.empty());
  }
  absl::Span<const uint8_t> rest = bytes;
  PipeRecord record;
  for (absl::StatusOr<bool> taken = true; taken.ok() && *taken;) {
    const size_t former_size = rest.size();
    taken = TakePipeRecord(rest, record);
    EVPOSE_FUZZ_REQUIRE((taken.ok() && *taken) == (rest.size() < former_size));
  }
  return 0;
}
