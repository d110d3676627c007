// SPDX-License-Identifier: Apache-2.0

// Helpers of the tests of recordings in the formats of other programs.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <fstream>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "client/containers/open_recording.h"
#include "core/recordings/event_reader.h"

namespace evpose::client {

struct ReadRecording {
  RecordingHeader header;
  std::vector<Event> events;
  std::vector<evpose::Trigger> triggers;
  DecodeCounts counts;
  std::vector<SkippedParts> skipped;
  std::vector<size_t> losses;  // the number of events before each loss

  uint64_t num_skipped(const std::string& what) const {
    for (const SkippedParts& parts : skipped) {
      if (parts.what == what) return parts.count;
    }
    return 0;
  }
};

inline absl::StatusOr<ReadRecording> ReadAll(const std::string& path, const OpenRecordingOptions& options = {}) {
  auto reader = OpenRecording(path, options);
  if (!reader.ok()) return reader.status();
  ReadRecording result;
  result.header = (*reader)->header();
  auto events = EventReader::Make(**reader, {.outside_sensor = OutsideSensor::kKeep, .max_piece_bytes = 1000});
  if (!events.ok()) return events.status();
  while (true) {
    const auto has_piece = events->Next();
    if (!has_piece.ok()) return has_piece.status();
    if (!*has_piece) break;
    if ((*reader)->follows_loss()) result.losses.push_back(result.events.size());
    const auto& piece = events->decoded().events;
    result.events.insert(result.events.end(), piece.begin(), piece.end());
    const auto& triggers = events->decoded().triggers;
    result.triggers.insert(result.triggers.end(), triggers.begin(), triggers.end());
  }
  result.counts = events->counts();
  result.skipped = (*reader)->skipped();
  return result;
}

// The events of all files in tests/data/containers, `offset_us` earlier.
inline std::vector<Event> FileEvents(int64_t offset_us = 0) {
  std::vector<Event> events;
  for (int i = 0; i < 300; ++i) {
    events.push_back({5000 + 37 * i + i % 3 - offset_us, static_cast<uint16_t>(7 * i % 346),
                      static_cast<uint16_t>(11 * i % 260), static_cast<uint8_t>(i % 2)});
  }
  return events;
}

inline std::string WriteBytes(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
  return path;
}

}  // namespace evpose::client
