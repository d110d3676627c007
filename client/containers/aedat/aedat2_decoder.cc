// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/aedat_decoder.h"
#include "client/containers/aedat/record_buffer.h"
#include "core/base/byte_order.h"

namespace evpose::client {
namespace {

constexpr size_t kAedat2RecordBytes = 8;  // address and time, 32 bits each

// The layouts are those of jAER's classes DVS128 and DavisBaseCamera.
constexpr uint32_t kDvs128Addresses = 0x10000;
constexpr uint32_t kDvs128Special = 0x8000;
// Marks a sample of an image, or, if all bits of kDavisImu are set, too, one of the inertial sensor.
constexpr uint32_t kDavisSample = 0x80000000;
constexpr uint32_t kDavisImu = 0xc00;
constexpr uint32_t kDavisTrigger = 0x400;

class Aedat2Decoder final : public AedatDecoder {
 public:
  Aedat2Decoder(Aedat2Layout layout, SensorGeometry geometry) : layout_(layout), geometry_(geometry) {}

  void Decode(absl::Span<const uint8_t>& bytes, DecodedEvents& out) override {
    while (const uint8_t* const record = buffer_.Take(bytes)) {
      const auto address = LoadBigEndian<uint32_t>(record);
      const int64_t t_us = Unwrap(LoadBigEndian<uint32_t>(record + 4));
      layout_ == Aedat2Layout::kDvs128 ? DecodeDvs128(address, t_us, out) : DecodeDavis(address, t_us, out);
    }
  }
  void Finish() override { counts_.lost_bytes += buffer_.pending_bytes(); }

 private:
  // Returns the time nearest to the last one, of all times with these low bits.
  int64_t Unwrap(uint32_t t_us) {
    if (!has_time_) {
      has_time_ = true;
      return last_us_ = t_us;
    }
    const auto step_us = static_cast<int32_t>(t_us - static_cast<uint32_t>(last_us_));
    last_us_ += step_us;
    if (last_us_ < 0) last_us_ += int64_t{1} << 32;
    return last_us_;
  }

  void DecodeDvs128(uint32_t address, int64_t t_us, DecodedEvents& out) {
    if (address >= kDvs128Addresses) {
      ++counts_.outside_sensor;
    } else if ((address & kDvs128Special) != 0) {
      ++counts_.other_records;
    } else {
      Append({t_us, static_cast<uint16_t>(127 - (address >> 1 & 127)),
              static_cast<uint16_t>(127 - (address >> 8 & 127)), static_cast<uint8_t>(1 - (address & 1))},
             geometry_, out);
    }
  }

  void DecodeDavis(uint32_t address, int64_t t_us, DecodedEvents& out) {
    if ((address & kDavisSample) != 0) {
      ++((address & kDavisImu) == kDavisImu ? counts_.imu_samples : counts_.image_samples);
    } else if ((address & kDavisTrigger) != 0) {
      out.triggers.push_back({t_us, 0, 1});  // the record does not state the edge, rising or falling
      ++counts_.triggers;
    } else {
      // A column or row beyond the sensor becomes a large number, which Append() refuses.
      Append({t_us, static_cast<uint16_t>(geometry_.width_px - 1 - static_cast<int>(address >> 12 & 0x3ff)),
              static_cast<uint16_t>(geometry_.height_px - 1 - static_cast<int>(address >> 22 & 0x1ff)),
              static_cast<uint8_t>(address >> 11 & 1)},
             geometry_, out);
    }
  }

  const Aedat2Layout layout_;
  const SensorGeometry geometry_;
  RecordBuffer<kAedat2RecordBytes> buffer_;
  int64_t last_us_ = 0;
  bool has_time_ = false;
};

}  // namespace

std::unique_ptr<AedatDecoder> MakeAedat2Decoder(Aedat2Layout layout, SensorGeometry geometry) {
  return std::make_unique<Aedat2Decoder>(layout, geometry);
}

Aedat2Layout GuessAedat2Layout(absl::Span<const uint8_t> records) {
  for (; records.size() >= kAedat2RecordBytes; records.remove_prefix(kAedat2RecordBytes)) {
    if (LoadBigEndian<uint32_t>(records.data()) >= kDvs128Addresses) return Aedat2Layout::kUnknown;
  }
  return Aedat2Layout::kDvs128;
}

}  // namespace evpose::client
