// SPDX-License-Identifier: Apache-2.0

// Fuzz target for headers of recordings with arbitrary bytes: a header is read, rejected with an error, or reported as
// incomplete, with the same result for the whole file and for every prefix that contains the header.
#include <optional>

#include "core/recordings/recording_header.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  FuzzInput input(data, size);
  const size_t prefix_bytes = input.Word();
  const std::string file = input.RestAsText();
  const auto whole = ParseRecordingHeader(file, true);
  if (whole.ok()) {
    EVPOSE_FUZZ_REQUIRE(whole->has_value());
    const RecordingHeader& header = **whole;
    EVPOSE_FUZZ_REQUIRE(header.size_bytes <= file.size());
    EVPOSE_FUZZ_REQUIRE(ValidateGeometry(header.encoding, header.geometry).ok());
  } else {
    EVPOSE_FUZZ_REQUIRE(!whole.status().message().empty());
  }
  const auto prefix = ParseRecordingHeader(std::string_view(file).substr(0, prefix_bytes), false);
  if (!prefix.ok() || !prefix->has_value()) return 0;
  EVPOSE_FUZZ_REQUIRE(whole.ok());
  EVPOSE_FUZZ_REQUIRE((*prefix)->size_bytes == (*whole)->size_bytes && (*prefix)->encoding == (*whole)->encoding);
  return 0;
}
