// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <optional>

#include "client/containers/aedat/aedat_decoder.h"
#include "client/containers/aedat/record_buffer.h"
#include "core/base/byte_order.h"

namespace evpose::client {
namespace {

constexpr size_t kPacketHeaderBytes = 28;
constexpr size_t kAedat3RecordBytes = 8;  // size of polarity and special events
constexpr int kSpecialPacket = 0;
constexpr int kPolarityPacket = 1;

// libcaer's types of special events that are edges of an input; each input has a rising edge, a falling edge and a
// pulse.
constexpr uint32_t kExternalInput = 2;
constexpr uint32_t kExternalInput1 = 6;
constexpr uint32_t kEndOfInputs = 12;

struct PacketHeader {
  int type = 0, source = 0;
  int64_t record_bytes = 0, time_overflow = 0, num_records = 0;

  int64_t data_bytes() const { return record_bytes * num_records; }
};

std::optional<PacketHeader> ParsePacketHeader(const uint8_t* bytes) {
  PacketHeader header;
  header.type = LoadLittleEndian<int16_t>(bytes);
  header.source = LoadLittleEndian<int16_t>(bytes + 2);
  header.record_bytes = LoadLittleEndian<int32_t>(bytes + 4);
  const auto time_offset = LoadLittleEndian<int32_t>(bytes + 8);
  header.time_overflow = LoadLittleEndian<int32_t>(bytes + 12);
  const auto capacity = LoadLittleEndian<int32_t>(bytes + 16);
  header.num_records = LoadLittleEndian<int32_t>(bytes + 20);
  const auto valid = LoadLittleEndian<int32_t>(bytes + 24);
  const bool is_plausible = header.type >= 0 && header.source >= 0 && header.record_bytes > 0 && time_offset >= 0 &&
                            time_offset < header.record_bytes && header.time_overflow >= 0 && valid >= 0 &&
                            valid <= header.num_records && header.num_records <= capacity;
  const bool has_small_records = header.type == kSpecialPacket || header.type == kPolarityPacket;
  if (!is_plausible || (has_small_records && header.record_bytes != kAedat3RecordBytes)) return std::nullopt;
  return header;
}

class Aedat3Decoder final : public AedatDecoder {
 public:
  explicit Aedat3Decoder(SensorGeometry geometry) : geometry_(geometry) {}

  void Decode(absl::Span<const uint8_t>& bytes, DecodedEvents& out) override {
    while (!bytes.empty()) {
      if (is_lost_) {
        counts_.lost_bytes += bytes.size();
        bytes = {};
      } else if (rest_bytes_ > 0) {
        DecodePacket(bytes, out);
      } else if (const uint8_t* const header = header_buffer_.Take(bytes)) {
        BeginPacket(header);
      }
    }
  }

  void Finish() override {
    counts_.lost_bytes += header_buffer_.pending_bytes() + record_buffer_.pending_bytes();
    if (rest_bytes_ > 0) ++counts_.damaged_packets;
  }

 private:
  void BeginPacket(const uint8_t* header) {
    const std::optional<PacketHeader> packet = ParsePacketHeader(header);
    if (!packet.has_value()) {
      is_lost_ = true;  // where the next packet begins is unknown
      ++counts_.damaged_packets;
      counts_.lost_bytes += kPacketHeaderBytes;
      return;
    }
    packet_ = *packet;
    rest_bytes_ = packet_.data_bytes();
    if (packet_.type == kPolarityPacket && !source_.has_value()) source_ = packet_.source;
    // Special events before the first polarity packet belong to the only camera of nearly all recordings.
    is_taken_ = (packet_.type == kPolarityPacket || packet_.type == kSpecialPacket) &&
                packet_.source == source_.value_or(packet_.source);
    if (!is_taken_) ++counts_.other_packets;
  }

  void DecodePacket(absl::Span<const uint8_t>& bytes, DecodedEvents& out) {
    absl::Span<const uint8_t> data = bytes.first(static_cast<size_t>(std::min<int64_t>(rest_bytes_, bytes.size())));
    bytes.remove_prefix(data.size());
    rest_bytes_ -= static_cast<int64_t>(data.size());
    if (!is_taken_) return;
    while (const uint8_t* const record = record_buffer_.Take(data)) {
      const auto bits = LoadLittleEndian<uint32_t>(record);
      const auto time = LoadLittleEndian<int32_t>(record + 4);
      if ((bits & 1) == 0 || time < 0) {
        ++counts_.invalid_events;
        continue;
      }
      // Both numbers have 31 bits, so the time is below 2^62, but it may exceed kMaxStateTimeUs.
      const int64_t t_us = packet_.time_overflow << 31 | time;
      if (t_us > kMaxStateTimeUs) {
        ++counts_.invalid_events;
      } else if (packet_.type == kSpecialPacket) {
        AppendSpecial(bits >> 1 & 127, t_us, out);
      } else {
        Append({t_us, static_cast<uint16_t>(bits >> 17), static_cast<uint16_t>(bits >> 2 & 0x7fff),
                static_cast<uint8_t>(bits >> 1 & 1)},
               geometry_, out);
      }
    }
  }

  void AppendSpecial(uint32_t type, int64_t t_us, DecodedEvents& out) {
    const bool is_first_input = type >= kExternalInput && type < kExternalInput + 3;
    const bool is_other_input = type >= kExternalInput1 && type < kEndOfInputs;
    const uint32_t edge = is_first_input ? type - kExternalInput : (type - kExternalInput1) % 3;
    if ((!is_first_input && !is_other_input) || edge == 2) {
      ++counts_.other_records;
      return;
    }
    const uint32_t input = is_first_input ? 0 : 1 + (type - kExternalInput1) / 3;
    out.triggers.push_back({t_us, static_cast<uint8_t>(input), static_cast<uint8_t>(1 - edge)});
    ++counts_.triggers;
  }

  const SensorGeometry geometry_;
  RecordBuffer<kPacketHeaderBytes> header_buffer_;
  RecordBuffer<kAedat3RecordBytes> record_buffer_;
  std::optional<int> source_;
  PacketHeader packet_;
  int64_t rest_bytes_ = 0;  // bytes of the packet that have not arrived
  bool is_taken_ = false;
  bool is_lost_ = false;
};

}  // namespace

std::unique_ptr<AedatDecoder> MakeAedat3Decoder(SensorGeometry geometry) {
  return std::make_unique<Aedat3Decoder>(geometry);
}

}  // namespace evpose::client
