// SPDX-License-Identifier: Apache-2.0

// Files in all formats that the client reads: opened by their content, and read to the end. HDF5 is only recognised
// (client/convert_hdf5/README.md, "No fuzz target").
#include <sys/mman.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "client/containers/open_recording.h"
#include "core/recordings/event_reader.h"
#include "tests/fuzz/require.h"

namespace evpose::client {
namespace {

constexpr int kMaxPieces = 100;  // number of pieces of an archive that inflates to a large array

void ReadRecording(const std::string& path) {
  const auto reader = OpenRecording(path);
  if (!reader.ok()) {
    EVPOSE_FUZZ_REQUIRE(!reader.status().message().empty());
    return;
  }
  const RecordingHeader& header = (*reader)->header();
  EVPOSE_FUZZ_REQUIRE(ValidateGeometry(header.encoding, header.geometry).ok());
  auto events = EventReader::Make(**reader);
  EVPOSE_FUZZ_REQUIRE(events.ok());
  for (int i = 0; i < kMaxPieces; ++i) {
    const auto has_piece = events->Next();
    if (!has_piece.ok() || !*has_piece) break;
    for (const Event& event : events->decoded().events) {
      EVPOSE_FUZZ_REQUIRE(event.t_us >= 0 && event.x < header.geometry.width_px && event.y < header.geometry.height_px);
    }
  }
  for (const SkippedParts& parts : (*reader)->skipped()) EVPOSE_FUZZ_REQUIRE(parts.count > 0);
}

}  // namespace
}  // namespace evpose::client

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const int file = memfd_create("input", MFD_CLOEXEC);
  EVPOSE_FUZZ_REQUIRE(file >= 0 && write(file, data, size) == static_cast<ssize_t>(size));
  evpose::client::ReadRecording("/proc/self/fd/" + std::to_string(file));
  close(file);
  return 0;
}
