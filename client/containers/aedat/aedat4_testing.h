// SPDX-License-Identifier: Apache-2.0

// Writes recordings in AEDAT 4.0 with the FlatBuffers library, for tests.
#pragma once

#include <flatbuffers/flatbuffers.h>
#include <lz4frame.h>
#include <zstd.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "client/containers/aedat/aedat_decoder.h"
#include "core/base/byte_order.h"

namespace evpose::client {

class Aedat4File {
 public:
  enum class Frames { kNone = 0, kLz4 = 1, kZstd = 3 };  // the numbers of the file's header

  // Streams: 0 events, 1 frames, 2 triggers, all of one camera; 3 events of another one.
  explicit Aedat4File(Frames frames, int64_t data_table_position = -1) : frames_(frames) {
    const std::string line = "#!AER-DAT4.0\r\n";
    bytes_.assign(line.begin(), line.end());
    flatbuffers::FlatBufferBuilder builder;
    const auto info = builder.CreateString(
        R"(<dv version="2.0"><node name="outInfo" path="/mainloop/Recorder/outInfo/">)" + Stream("0", "EVTS", "A") +
        Stream("1", "FRME", "A") + Stream("2", "TRIG", "A") + Stream("3", "EVTS", "B") + "</node></dv>");
    const auto table = builder.StartTable();
    builder.AddElement<int32_t>(FieldOffset(0), static_cast<int32_t>(frames), 0);
    builder.AddElement<int64_t>(FieldOffset(1), data_table_position, -1);
    builder.AddOffset(FieldOffset(2), info);
    Finish(builder, builder.EndTable(table), "IOHE");
    bytes_.insert(bytes_.end(), builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize());
  }

  void AddEvents(int32_t stream, const std::vector<Event>& events) {
    struct alignas(8) Element {
      int64_t t;
      int16_t x, y;
      uint8_t on;
      uint8_t padding[3];
    };
    std::vector<Element> elements;
    for (const Event& event : events) {
      elements.push_back(
          {event.t_us, static_cast<int16_t>(event.x), static_cast<int16_t>(event.y), event.polarity, {}});
    }
    flatbuffers::FlatBufferBuilder builder;
    const auto vector = builder.CreateVectorOfStructs(elements);
    const auto table = builder.StartTable();
    builder.AddOffset(FieldOffset(0), vector);
    Finish(builder, builder.EndTable(table), "EVTS");
    AddPacket(stream, builder);
  }

  void AddTriggers(int32_t stream, const std::vector<std::pair<int64_t, int8_t>>& times_and_sources) {
    flatbuffers::FlatBufferBuilder builder;
    std::vector<flatbuffers::Offset<flatbuffers::Table>> triggers;
    for (const auto& [t_us, source] : times_and_sources) {
      const auto trigger = builder.StartTable();
      builder.AddElement<int64_t>(FieldOffset(0), t_us, 0);
      builder.AddElement<int8_t>(FieldOffset(1), source, 0);
      triggers.emplace_back(builder.EndTable(trigger));
    }
    const auto vector = builder.CreateVector(triggers);
    const auto table = builder.StartTable();
    builder.AddOffset(FieldOffset(0), vector);
    Finish(builder, builder.EndTable(table), "TRIG");
    AddPacket(stream, builder);
  }

  // Adds a packet with this content.
  void AddContent(int32_t stream, std::vector<uint8_t> content) {
    if (frames_ == Frames::kLz4) {
      std::vector<uint8_t> frame(LZ4F_compressFrameBound(content.size(), nullptr));
      frame.resize(LZ4F_compressFrame(frame.data(), frame.size(), content.data(), content.size(), nullptr));
      content = frame;
    } else if (frames_ == Frames::kZstd) {
      std::vector<uint8_t> frame(ZSTD_compressBound(content.size()));
      frame.resize(ZSTD_compress(frame.data(), frame.size(), content.data(), content.size(), 1));
      content = frame;
    }
    AppendLittleEndian(stream, bytes_);
    AppendLittleEndian(static_cast<int32_t>(content.size()), bytes_);
    AddBytes(content);
  }

  void AddBytes(const std::vector<uint8_t>& bytes) { bytes_.insert(bytes_.end(), bytes.begin(), bytes.end()); }
  std::vector<uint8_t>& bytes() { return bytes_; }

 private:
  static flatbuffers::voffset_t FieldOffset(int field) { return static_cast<flatbuffers::voffset_t>(4 + 2 * field); }

  static void Finish(flatbuffers::FlatBufferBuilder& builder, flatbuffers::uoffset_t table, const char* identifier) {
    builder.FinishSizePrefixed(flatbuffers::Offset<flatbuffers::Table>(table), identifier);
  }

  static std::string Stream(const std::string& id, const std::string& type, const std::string& source) {
    return "<node name=\"" + id + R"("><attr key="typeIdentifier" type="string">)" + type +
           R"(</attr><node name="info"><attr key="sizeX" type="int">346</attr>)" +
           R"(<attr key="sizeY" type="int">260</attr><attr key="source" type="string">)" + source +
           "</attr></node></node>";
  }

  void AddPacket(int32_t stream, const flatbuffers::FlatBufferBuilder& builder) {
    AddContent(stream, {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()});
  }

  const Frames frames_;
  std::vector<uint8_t> bytes_;
};

}  // namespace evpose::client
