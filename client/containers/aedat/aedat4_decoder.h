// SPDX-License-Identifier: Apache-2.0

// AEDAT 4.0: a header, then packets of FlatBuffers (client/containers/aedat/README.md, section 4).
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "client/containers/aedat/aedat_decoder.h"
#include "client/containers/compression/frame_decompressor.h"

namespace evpose::client {

// Limit of the content of a packet, bytes: 4 million events. Larger packets are not read. DV cuts packets after 10 ms.
inline constexpr size_t kMaxAedat4PacketBytes = size_t{64} << 20;

struct Aedat4Header {
  std::optional<FrameFormat> compression;  // each packet is one frame of this format; nullopt: not compressed
  int event_stream = 0;                    // the first stream of events
  std::optional<int> trigger_stream;       // the first stream of triggers of the same camera
  SensorGeometry geometry;                 // size of the sensor of the stream of events; zero if not stated
  std::string source;                      // the name of the camera; empty if not stated
  size_t size_bytes = 0;                   // offset in the file of the first packet
  int64_t data_bytes = -1;                 // size of all packets; -1 until the end of the file
};

// Parses the header, which follows the first line of `prefix`. nullopt if it may continue beyond `prefix` and
// `is_whole_file` is false. Errors: INVALID_ARGUMENT if the header is damaged, too long or has no stream of events.
absl::StatusOr<std::optional<Aedat4Header>> ParseAedat4Header(absl::Span<const uint8_t> prefix, bool is_whole_file);

// Times of the output are those of the file, since 1970.
std::unique_ptr<AedatDecoder> MakeAedat4Decoder(const Aedat4Header& header);

}  // namespace evpose::client
