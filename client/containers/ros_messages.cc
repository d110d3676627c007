// SPDX-License-Identifier: Apache-2.0
#include "client/containers/ros_messages.h"

#include "core/base/byte_order.h"

namespace evpose::client {
namespace {

constexpr size_t kEncapsulationBytes = 4;
constexpr int64_t kNanosecondsPerSecond = 1'000'000'000;

class CdrReader {
 public:
  explicit CdrReader(std::string_view message) {
    is_ok_ = message.size() >= kEncapsulationBytes && message[0] == 0 && (message[1] == 0 || message[1] == 1);
    if (!is_ok_) return;
    is_little_ = message[1] == 1;
    bytes_ = message.substr(kEncapsulationBytes);
  }

  bool ok() const { return is_ok_; }

  template <typename Number>
  Number Take() {
    position_ += (sizeof(Number) - position_ % sizeof(Number)) % sizeof(Number);
    const std::string_view field = TakeBytes(sizeof(Number));
    if (!is_ok_) return 0;
    const auto* const bytes = reinterpret_cast<const uint8_t*>(field.data());
    return is_little_ ? LoadLittleEndian<Number>(bytes) : LoadBigEndian<Number>(bytes);
  }
  std::string_view TakeBytes(size_t size) {
    is_ok_ = is_ok_ && position_ <= bytes_.size() && size <= bytes_.size() - position_;
    if (!is_ok_) return {};
    const std::string_view field = bytes_.substr(position_, size);
    position_ += size;
    return field;
  }
  // The length of a string counts its final zero.
  std::string_view TakeString() {
    const std::string_view text = TakeBytes(Take<uint32_t>());
    return text.substr(0, text.find('\0'));
  }
  int64_t TakeTimeNs() {
    const auto seconds = Take<int32_t>();
    return seconds * kNanosecondsPerSecond + Take<uint32_t>();
  }

 private:
  std::string_view bytes_;
  size_t position_ = 0;
  bool is_little_ = true;
  bool is_ok_ = false;
};

}  // namespace

std::optional<EventPacket> ParseEventPacket(std::string_view message) {
  CdrReader reader(message);
  EventPacket packet;
  reader.TakeTimeNs();
  reader.TakeString();  // frame_id
  packet.height = reader.Take<uint32_t>();
  packet.width = reader.Take<uint32_t>();
  packet.seq = reader.Take<uint64_t>();
  reader.Take<uint64_t>();  // time_base, which EVT3 does not use
  packet.encoding = reader.TakeString();
  packet.is_big_endian = reader.Take<uint8_t>() != 0;
  packet.events = reader.TakeBytes(reader.Take<uint32_t>());
  if (!reader.ok()) return std::nullopt;
  return packet;
}

std::optional<EventArray> ParseEventArray(std::string_view message, std::vector<SourceEvent>& events) {
  CdrReader reader(message);
  EventArray array;
  reader.TakeTimeNs();
  reader.TakeString();  // frame_id
  array.height = reader.Take<uint32_t>();
  array.width = reader.Take<uint32_t>();
  const auto count = reader.Take<uint32_t>();
  if (!reader.ok()) return std::nullopt;
  for (uint32_t i = 0; i < count; ++i) {
    SourceEvent event;
    event.x = reader.Take<uint16_t>();
    event.y = reader.Take<uint16_t>();
    event.t_us = (reader.TakeTimeNs() + 500) / 1000;
    event.is_on = reader.Take<uint8_t>() != 0;
    if (!reader.ok()) {
      array.num_missing = count - i;
      break;
    }
    events.push_back(event);
  }
  return array;
}

}  // namespace evpose::client
