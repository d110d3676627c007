// SPDX-License-Identifier: Apache-2.0

// The messages of ROS bags, the headers of NumPy arrays, and the lines of text files, without the files around them.
#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

#include "client/containers/decimal.h"
#include "client/containers/npy_header.h"
#include "client/containers/ros_messages.h"
#include "client/containers/text_source.h"
#include "tests/fuzz/require.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose::client;
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  if (const auto packet = ParseEventPacket(bytes)) EVPOSE_FUZZ_REQUIRE(packet->events.size() < size);
  std::vector<SourceEvent> events;
  if (const auto array = ParseEventArray(bytes, events)) EVPOSE_FUZZ_REQUIRE(events.size() * 13 <= size);
  const auto header = ParseNpyHeader(bytes);
  if (header.ok() && header->has_value()) {
    std::vector<uint8_t> item((*header)->item_bytes);
    for (const NpyField& field : (*header)->fields) {
      EVPOSE_FUZZ_REQUIRE(field.offset + field.size <= item.size());
      if (field.kind != '?') ReadNumber(field, item.data());
    }
  }
  if (const auto layout = FindTextLayout(bytes)) EVPOSE_FUZZ_REQUIRE(layout->columns.num_columns() <= 16);
  ScaledDecimal(bytes, 6);
  return 0;
}
