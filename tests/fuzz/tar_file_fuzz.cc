// SPDX-License-Identifier: Apache-2.0

// Fuzz target for archives with arbitrary bytes: an archive is read, with names that stay in it and contents of no more
// bytes than it has, or rejected with an error.
#include "client/diagnosis/tar_file.h"
#include "tests/fuzz/require.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::string_view archive(reinterpret_cast<const char*>(data), size);
  const auto files = evpose::client::ParseTar(archive);
  if (!files.ok()) {
    EVPOSE_FUZZ_REQUIRE(!files.status().message().empty());
    return 0;
  }
  size_t num_bytes = 0;
  for (const auto& [name, contents] : *files) {
    EVPOSE_FUZZ_REQUIRE(!name.empty() && name.front() != '/' && ("/" + name + "/").find("/../") == std::string::npos);
    num_bytes += contents.size();
  }
  EVPOSE_FUZZ_REQUIRE(num_bytes <= size);
  return 0;
}
