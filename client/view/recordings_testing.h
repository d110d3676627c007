// SPDX-License-Identifier: Apache-2.0

// Recordings of random events.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "core/events/encoder.h"
#include "core/recordings/recording_writer.h"

namespace evpose::client {

inline constexpr SensorGeometry kTestSensor{640, 480};

// `count` events with times in [from_us, to_us), in order.
inline std::vector<Event> RandomEvents(size_t count, int64_t from_us, int64_t to_us, uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<Event> events(count);
  for (Event& event : events) {
    event.t_us = std::uniform_int_distribution<int64_t>(from_us, to_us - 1)(random);
    event.x = static_cast<uint16_t>(random() % static_cast<uint32_t>(kTestSensor.width_px));
    event.y = static_cast<uint16_t>(random() % static_cast<uint32_t>(kTestSensor.height_px));
    event.polarity = random() % 2;
  }
  std::sort(events.begin(), events.end(), [](const Event& a, const Event& b) { return a.t_us < b.t_us; });
  return events;
}

inline std::vector<uint8_t> Encoded(const std::vector<Event>& events) {
  std::vector<uint8_t> bytes;
  const auto encoder = MakeEventEncoder(Encoding::kEvt3, kTestSensor);
  EXPECT_TRUE((*encoder)->Encode(events, bytes).ok());
  return bytes;
}

// The extension is that of the format: .raw (EVT3), .dat or .csv.
inline void WriteRecording(const std::string& path, const std::vector<Event>& events) {
  if (absl::EndsWith(path, ".csv")) {
    std::ofstream file(path);
    file << "t_us,x,y,p\n";
    for (const Event& e : events) file << e.t_us << ',' << e.x << ',' << e.y << ',' << int{e.polarity} << '\n';
    return;
  }
  const Encoding encoding = absl::EndsWith(path, ".dat") ? Encoding::kDat : Encoding::kEvt3;
  auto writer = RecordingWriter::Create(path, encoding, kTestSensor);
  ASSERT_TRUE(writer.ok()) << writer.status();
  ASSERT_TRUE((*writer)->Write(events).ok());
  ASSERT_TRUE((*writer)->Close().ok());
}

}  // namespace evpose::client
