// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/aedat4_decoder.h"

#include <algorithm>
#include <vector>

#include "client/containers/aedat/flat_table.h"
#include "client/containers/aedat/record_buffer.h"
#include "core/base/byte_order.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kStreamHeaderBytes = 8;      // head of a packet: number of the stream, size
constexpr size_t kEventBytes = 16;            // t i64, x i16, y i16, on, three bytes of padding
constexpr size_t kPacketSizePrefixBytes = 4;  // FlatBuffers with a size prefix
constexpr size_t kTableElementBytes = 4;      // of a vector of tables: the offset of one

// Events of a call of Decode() after which it begins no further packet: a packet of zeros is compressed to a few KiB,
// so that the packets of one read would fill the memory. Usual packets have fewer events by far.
constexpr size_t kEnoughEvents = size_t{1} << 17;

// Fields of tables.
constexpr int kElementsField = 0;
constexpr int kTriggerTimeField = 0;
constexpr int kTriggerSourceField = 1;

// Sources of triggers. The edges of the camera's own signal generator become those of a second input.
constexpr int8_t kExternalRising = 1;
constexpr int8_t kExternalFalling = 2;
constexpr int8_t kGeneratorRising = 4;
constexpr int8_t kGeneratorFalling = 5;

class Aedat4Decoder final : public AedatDecoder {
 public:
  explicit Aedat4Decoder(const Aedat4Header& header) : header_(header), rest_of_data_(header.data_bytes) {}

  void Decode(absl::Span<const uint8_t>& bytes, DecodedEvents& out) override {
    if (rest_of_data_ < 0) return DecodeData(bytes, out);
    const auto size = std::min<int64_t>(rest_of_data_, static_cast<int64_t>(bytes.size()));
    absl::Span<const uint8_t> data = bytes.first(static_cast<size_t>(size));
    DecodeData(data, out);
    const int64_t taken = size - static_cast<int64_t>(data.size());
    rest_of_data_ -= taken;
    bytes.remove_prefix(rest_of_data_ == 0 ? bytes.size() : static_cast<size_t>(taken));
  }

  void Finish() override {
    counts_.lost_bytes += header_buffer_.pending_bytes() + packet_.size();
    if (rest_of_packet_ > 0) ++counts_.damaged_packets;
  }

 private:
  void DecodeData(absl::Span<const uint8_t>& bytes, DecodedEvents& out) {
    const size_t enough = out.events.size() + out.triggers.size() + kEnoughEvents;
    while (!bytes.empty() && out.events.size() + out.triggers.size() < enough) {
      if (is_lost_) {
        counts_.lost_bytes += bytes.size();
        bytes = {};
      } else if (rest_of_packet_ > 0) {
        TakePacket(bytes, out);
      } else if (const uint8_t* const header = header_buffer_.Take(bytes)) {
        BeginPacket(header);
      }
    }
  }

  void BeginPacket(const uint8_t* header) {
    stream_ = LoadLittleEndian<int32_t>(header);
    const auto size = LoadLittleEndian<int32_t>(header + 4);
    if (size < 0) {
      is_lost_ = true;  // where the next packet begins is unknown
      ++counts_.damaged_packets;
      counts_.lost_bytes += kStreamHeaderBytes;
      return;
    }
    rest_of_packet_ = static_cast<size_t>(size);
    const bool is_wanted = stream_ == header_.event_stream || stream_ == header_.trigger_stream;
    is_taken_ = is_wanted && rest_of_packet_ <= kMaxAedat4PacketBytes;
    if (!is_taken_) ++(is_wanted ? counts_.oversized_packets : counts_.other_packets);
  }

  void TakePacket(absl::Span<const uint8_t>& bytes, DecodedEvents& out) {
    const absl::Span<const uint8_t> data = bytes.first(std::min(rest_of_packet_, bytes.size()));
    bytes.remove_prefix(data.size());
    rest_of_packet_ -= data.size();
    if (!is_taken_) return;
    packet_.insert(packet_.end(), data.begin(), data.end());
    if (rest_of_packet_ > 0) return;
    const absl::Status status = DecodePacket(packet_, out);
    if (!status.ok()) ++(absl::IsResourceExhausted(status) ? counts_.oversized_packets : counts_.damaged_packets);
    packet_.clear();
  }

  absl::Status DecodePacket(absl::Span<const uint8_t> packet, DecodedEvents& out) {
    absl::Span<const uint8_t> content = packet;
    if (header_.compression.has_value()) {
      decompressor_.Clear();
      EVPOSE_RETURN_IF_ERROR(decompressor_.Append(*header_.compression, packet, kMaxAedat4PacketBytes));
      content = decompressor_.content();
    }
    if (content.size() < kPacketSizePrefixBytes ||
        LoadLittleEndian<uint32_t>(content.data()) > content.size() - kPacketSizePrefixBytes) {
      return absl::DataLossError("a packet is shorter than its FlatBuffer");
    }
    const absl::Span<const uint8_t> buffer =
        content.subspan(kPacketSizePrefixBytes, LoadLittleEndian<uint32_t>(content.data()));
    return stream_ == header_.event_stream ? DecodeEvents(buffer, out) : DecodeTriggers(buffer, out);
  }

  absl::Status DecodeEvents(absl::Span<const uint8_t> buffer, DecodedEvents& out) {
    EVPOSE_ASSIGN_OR_RETURN(const FlatTable table, FlatTable::Root(buffer, "EVTS"));
    EVPOSE_ASSIGN_OR_RETURN(const FlatTable::Elements elements, table.Vector(kElementsField, kEventBytes));
    out.events.reserve(out.events.size() + elements.count);
    for (size_t i = 0; i < elements.count; ++i) {
      const uint8_t* const event = buffer.data() + elements.begin + i * kEventBytes;
      const auto t_us = LoadLittleEndian<int64_t>(event);
      if (t_us < 0 || t_us > kMaxStateTimeUs) {
        ++counts_.invalid_events;
        continue;
      }
      Append({t_us, LoadLittleEndian<uint16_t>(event + 8), LoadLittleEndian<uint16_t>(event + 10),
              static_cast<uint8_t>(event[12] != 0 ? 1 : 0)},
             header_.geometry, out);
    }
    return absl::OkStatus();
  }

  absl::Status DecodeTriggers(absl::Span<const uint8_t> buffer, DecodedEvents& out) {
    EVPOSE_ASSIGN_OR_RETURN(const FlatTable table, FlatTable::Root(buffer, "TRIG"));
    EVPOSE_ASSIGN_OR_RETURN(const FlatTable::Elements elements, table.Vector(kElementsField, kTableElementBytes));
    for (size_t i = 0; i < elements.count; ++i) {
      EVPOSE_ASSIGN_OR_RETURN(const FlatTable trigger, table.TableAt(elements, i));
      EVPOSE_ASSIGN_OR_RETURN(const int64_t t_us, trigger.Number<int64_t>(kTriggerTimeField, 0));
      EVPOSE_ASSIGN_OR_RETURN(const int8_t source, trigger.Number<int8_t>(kTriggerSourceField, 0));
      const bool is_external = source == kExternalRising || source == kExternalFalling;
      if (t_us < 0 || t_us > kMaxStateTimeUs) {
        ++counts_.invalid_events;
      } else if (is_external || source == kGeneratorRising || source == kGeneratorFalling) {
        const bool is_rising = source == kExternalRising || source == kGeneratorRising;
        out.triggers.push_back(
            {t_us, static_cast<uint8_t>(is_external ? 0 : 1), static_cast<uint8_t>(is_rising ? 1 : 0)});
        ++counts_.triggers;
      } else {
        ++counts_.other_records;
      }
    }
    return absl::OkStatus();
  }

  const Aedat4Header header_;
  FrameDecompressor decompressor_;
  RecordBuffer<kStreamHeaderBytes> header_buffer_;
  std::vector<uint8_t> packet_;  // what has arrived of it
  int64_t rest_of_data_;         // -1: until the end of the file
  size_t rest_of_packet_ = 0;
  int32_t stream_ = 0;
  bool is_taken_ = false;
  bool is_lost_ = false;
};

}  // namespace

std::unique_ptr<AedatDecoder> MakeAedat4Decoder(const Aedat4Header& header) {
  return std::make_unique<Aedat4Decoder>(header);
}

}  // namespace evpose::client
