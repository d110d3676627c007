// SPDX-License-Identifier: Apache-2.0
#include <pugixml.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/containers/aedat/aedat4_decoder.h"
#include "client/containers/aedat/aedat_header.h"
#include "client/containers/aedat/flat_table.h"
#include "core/base/byte_order.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kSizePrefixBytes = 4;  // FlatBuffers with a size prefix

// Fields of the table IOHeader.
constexpr int kCompressionField = 0;
constexpr int kDataTableField = 1;
constexpr int kInfoField = 2;

struct Stream {
  int id = 0;
  std::string type;  // "EVTS"
  std::string source;
  SensorGeometry geometry;
};

pugi::xml_node ChildNamed(const pugi::xml_node& parent, const char* name) {
  return parent.find_child_by_attribute("node", "name", name);
}

const char* Attribute(const pugi::xml_node& node, const char* key) {
  return node.find_child_by_attribute("attr", "key", key).text().get();
}

// <dv><node name="outInfo"><node name="0"><attr key="typeIdentifier">EVTS</attr><node name="info"><attr key="sizeX">...
absl::StatusOr<std::vector<Stream>> ParseStreams(absl::string_view xml) {
  pugi::xml_document document;
  const pugi::xml_parse_result result =
      document.load_buffer(xml.data(), xml.size(), pugi::parse_default, pugi::encoding_utf8);
  if (!result) {
    return absl::InvalidArgumentError(
        absl::StrCat("the description of the streams is no XML: ", result.description(), " at byte ", result.offset));
  }
  std::vector<Stream> streams;
  for (const pugi::xml_node& node : ChildNamed(document.child("dv"), "outInfo").children("node")) {
    Stream stream;
    if (!absl::SimpleAtoi(node.attribute("name").value(), &stream.id)) continue;
    stream.type = Attribute(node, "typeIdentifier");
    const pugi::xml_node info = ChildNamed(node, "info");
    stream.source = Attribute(info, "source");
    if (!absl::SimpleAtoi(Attribute(info, "sizeX"), &stream.geometry.width_px) ||
        !absl::SimpleAtoi(Attribute(info, "sizeY"), &stream.geometry.height_px) || stream.geometry.width_px <= 0 ||
        stream.geometry.height_px <= 0) {
      stream.geometry = {};
    }
    streams.push_back(std::move(stream));
  }
  return streams;
}

absl::StatusOr<std::optional<FrameFormat>> CompressionOf(int32_t number) {
  switch (number) {
    case 0:
      return std::nullopt;
    case 1:  // the second number of each stands for a higher level
    case 2:
      return FrameFormat::kLz4;
    case 3:
    case 4:
      return FrameFormat::kZstd;
    default:
      return absl::InvalidArgumentError(
          absl::StrCat("the compression ", number, " is not known, only LZ4 and Zstandard"));
  }
}

absl::Status SelectStreams(const std::vector<Stream>& streams, Aedat4Header& header) {
  bool has_events = false;
  for (const Stream& stream : streams) {
    if (stream.type != "EVTS" || std::exchange(has_events, true)) continue;
    header.event_stream = stream.id;
    header.geometry = stream.geometry;
    header.source = stream.source;
  }
  if (!has_events) return absl::InvalidArgumentError("the recording has no stream of events");
  for (const Stream& stream : streams) {
    if (stream.type != "TRIG" || stream.source != header.source || header.trigger_stream.has_value()) continue;
    header.trigger_stream = stream.id;
  }
  return absl::OkStatus();
}

absl::StatusOr<Aedat4Header> ParseIoHeader(absl::Span<const uint8_t> buffer) {
  EVPOSE_ASSIGN_OR_RETURN(const FlatTable table, FlatTable::Root(buffer, "IOHE"));
  Aedat4Header header;
  EVPOSE_ASSIGN_OR_RETURN(const int32_t compression, table.Number<int32_t>(kCompressionField, 0));
  EVPOSE_ASSIGN_OR_RETURN(header.compression, CompressionOf(compression));
  EVPOSE_ASSIGN_OR_RETURN(header.data_bytes, table.Number<int64_t>(kDataTableField, -1));
  EVPOSE_ASSIGN_OR_RETURN(const absl::string_view info, table.String(kInfoField));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<Stream> streams, ParseStreams(info));
  EVPOSE_RETURN_IF_ERROR(SelectStreams(streams, header));
  return header;
}

absl::Status DamagedHeader(absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("the header of the AEDAT 4.0 recording is damaged: ", what));
}

}  // namespace

absl::StatusOr<std::optional<Aedat4Header>> ParseAedat4Header(absl::Span<const uint8_t> prefix, bool is_whole_file) {
  const absl::string_view text(reinterpret_cast<const char*>(prefix.data()), prefix.size());
  EVPOSE_ASSIGN_OR_RETURN(const std::optional<AedatHeader> first_line, ParseAedatHeader(text, is_whole_file));
  if (!first_line.has_value()) return std::nullopt;
  if (first_line->version != AedatVersion::k4) return DamagedHeader("it is of another version");
  const absl::Span<const uint8_t> rest = prefix.subspan(first_line->size_bytes);
  const auto incomplete = [&]() -> absl::StatusOr<std::optional<Aedat4Header>> {
    if (is_whole_file) return DamagedHeader("it is incomplete");
    return std::nullopt;
  };
  if (rest.size() < kSizePrefixBytes) return incomplete();
  const size_t size = LoadLittleEndian<uint32_t>(rest.data());
  if (size > kMaxAedatHeaderBytes) return DamagedHeader(absl::StrCat("it has ", size, " bytes"));
  if (rest.size() - kSizePrefixBytes < size) return incomplete();
  absl::StatusOr<Aedat4Header> header = ParseIoHeader(rest.subspan(kSizePrefixBytes, size));
  if (!header.ok()) return DamagedHeader(header.status().message());
  header->size_bytes = first_line->size_bytes + kSizePrefixBytes + size;
  // The file has the position of the table behind the packets; -1 if the recording was not finished.
  if (header->data_bytes >= 0) header->data_bytes -= static_cast<int64_t>(header->size_bytes);
  if (header->data_bytes < 0) header->data_bytes = -1;
  return *std::move(header);
}

}  // namespace evpose::client
