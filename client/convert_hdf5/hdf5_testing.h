// SPDX-License-Identifier: Apache-2.0

// For tests: reads and writes whole files.
#pragma once

#include <string>
#include <vector>

#include "client/convert_hdf5/hdf5_reader.h"
#include "client/convert_hdf5/hdf5_writer.h"

namespace evpose::client {

struct Hdf5Contents {
  PipeHeader header;
  std::vector<Event> events;
  std::vector<Trigger> triggers;
  PipeLosses losses;
};

inline absl::StatusOr<Hdf5Contents> ReadHdf5(const std::string& path) {
  auto reader = Hdf5Reader::Open(path);
  if (!reader.ok()) return reader.status();
  Hdf5Contents contents;
  std::vector<Event> events;
  std::vector<Trigger> triggers;
  while ((*reader)->Next(events, triggers)) {
    contents.events.insert(contents.events.end(), events.begin(), events.end());
    contents.triggers.insert(contents.triggers.end(), triggers.begin(), triggers.end());
  }
  contents.header = (*reader)->header();
  contents.losses = (*reader)->losses();
  return contents;
}

inline absl::Status WriteHdf5(const std::string& path, const Hdf5Contents& contents) {
  auto writer = Hdf5Writer::Create(path, contents.header);
  if (!writer.ok()) return writer.status();
  if (absl::Status status = (*writer)->Write(absl::MakeConstSpan(contents.events)); !status.ok()) return status;
  if (absl::Status status = (*writer)->Write(absl::MakeConstSpan(contents.triggers)); !status.ok()) return status;
  return (*writer)->Close();
}

// Events at every 20 us, with pauses; times step back a little after each thousand.
inline std::vector<Event> TestEvents(size_t count) {
  std::vector<Event> events;
  for (size_t i = 0; i < count; ++i) {
    events.push_back({static_cast<int64_t>(6'384 + 20 * i + i / 5000 * 1'000'000 - (i % 1000 == 999 ? 30 : 0)),
                      static_cast<uint16_t>(i * 7 % 1280), static_cast<uint16_t>(i / 50 * 11 % 720),
                      static_cast<uint8_t>(i / 3 % 2)});
  }
  return events;
}

}  // namespace evpose::client
