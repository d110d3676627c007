// SPDX-License-Identifier: Apache-2.0

// evpose info: describes the content of a recording.
#include <algorithm>
#include <cstdint>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/commands.h"
#include "core/base/status_macros.h"
#include "core/events/decoder.h"
#include "core/events/event_reader.h"
#include "core/events/recording_reader.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

constexpr size_t kPackedEventBytes = 13;  // t u64, x u16, y u16, p u8, little-endian

struct InfoArguments {
  std::string recording;
  bool is_json = false;
};

struct RecordingInfo {
  RecordingHeader header;
  DecodeCounts counts;
  uint64_t on_events = 0;
  int64_t t_first_us = 0;  // of the first and the last event in the stream; meaningless without events
  int64_t t_last_us = 0;
  uint64_t data_bytes = 0;
  int truncated_bytes = 0;
  std::string sha256;
};

void Pack(const Event& event, std::vector<uint8_t>& packed) {
  const uint64_t t = static_cast<uint64_t>(event.t_us);
  for (int shift = 0; shift < 64; shift += 8) packed.push_back(static_cast<uint8_t>(t >> shift));
  for (const uint16_t value : {event.x, event.y}) {
    packed.push_back(static_cast<uint8_t>(value));
    packed.push_back(static_cast<uint8_t>(value >> 8));
  }
  packed.push_back(event.polarity);
}

absl::StatusOr<RecordingInfo> ReadInfo(const std::string& path, const std::function<bool()>& is_interrupted) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> reader,
                          RecordingReader::Open(path, {.stop = is_interrupted}));
  RecordingInfo info;
  info.header = reader->header();
  EVPOSE_ASSIGN_OR_RETURN(EventReader events, EventReader::Make(*reader, {.outside_sensor = OutsideSensor::kKeep}));
  Sha256 digest;
  std::vector<uint8_t> packed;
  uint64_t num_events = 0;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (!has_piece) break;
    const auto& piece = events.decoded().events;
    packed.clear();
    packed.reserve(piece.size() * kPackedEventBytes);
    for (const Event& event : piece) {
      if (num_events++ == 0) info.t_first_us = event.t_us;
      info.on_events += event.polarity;
      Pack(event, packed);
    }
    if (!piece.empty()) info.t_last_us = piece.back().t_us;
    digest.Update(packed);
  }
  info.data_bytes = events.data_bytes();
  info.truncated_bytes = events.pending_bytes();
  info.counts = events.counts();
  info.sha256 = digest.FinishHex();
  return info;
}

Json InfoJson(const RecordingInfo& info) {
  const DecodeCounts& counts = info.counts;
  const bool has_events = counts.cd_events > 0;
  Json json;
  json["format"] = std::string(EncodingName(info.header.encoding));
  json["width"] = info.header.geometry.width_px;
  json["height"] = info.header.geometry.height_px;
  json["cd_events"] = counts.cd_events;
  json["triggers"] = counts.triggers;
  json["t_first_us"] = has_events ? Json(info.t_first_us) : Json(nullptr);
  json["t_last_us"] = has_events ? Json(info.t_last_us) : Json(nullptr);
  json["invalid_words"] = counts.invalid_words();
  json["dropped_events"] = counts.dropped_events();
  json["sha256"] = info.sha256;
  json["on_events"] = info.on_events;
  json["off_events"] = counts.cd_events - info.on_events;
  json["unknown_words"] = counts.unknown_words;
  json["broken_vectors"] = counts.broken_vectors;
  json["dropped_before_time"] = counts.dropped_before_time;
  json["dropped_outside_sensor"] = counts.dropped_outside_sensor;
  json["kept_outside_sensor"] = counts.kept_outside_sensor;
  json["time_backsteps"] = counts.time_backsteps;
  json["clock_wraps"] = counts.clock_wraps;
  json["data_bytes"] = info.data_bytes;
  json["truncated_bytes"] = info.truncated_bytes;
  json["geometry_is_stated"] = info.header.geometry_is_stated;
  return json;
}

void PrintInfo(const std::string& path, const RecordingInfo& info, std::ostream& out) {
  const DecodeCounts& counts = info.counts;
  const double duration_s = static_cast<double>(info.t_last_us - info.t_first_us) * 1e-6;
  out << path << ": " << EncodingName(info.header.encoding) << " " << info.header.geometry.width_px << "x"
      << info.header.geometry.height_px << (info.header.geometry_is_stated ? "" : " (not stated by the header)")
      << "\n";
  out << absl::StrFormat("events     %d (%d ON, %d OFF), %d triggers\n", counts.cd_events, info.on_events,
                         counts.cd_events - info.on_events, counts.triggers);
  if (counts.cd_events > 0) {
    out << absl::StrFormat("time       %.6f to %.6f s, %.6f s", info.t_first_us * 1e-6, info.t_last_us * 1e-6,
                           duration_s);
    if (duration_s > 0.0)
      out << absl::StrFormat(", %.3f Mev/s", static_cast<double>(counts.cd_events) * 1e-6 / duration_s);
    out << "\n";
  }
  out << absl::StrFormat("clock      %d wraps, %d steps back\n", counts.clock_wraps, counts.time_backsteps);
  out << absl::StrFormat("invalid    %d words (%d unknown, %d broken vectors)\n", counts.invalid_words(),
                         counts.unknown_words, counts.broken_vectors);
  out << absl::StrFormat("dropped    %d events (%d before the first time stamp, %d with an unreadable address)\n",
                         counts.dropped_events(), counts.dropped_before_time, counts.dropped_outside_sensor);
  if (counts.kept_outside_sensor > 0) {
    out << absl::StrFormat("outside    %d events lie outside the sensor; replay leaves them out\n",
                           counts.kept_outside_sensor);
  }
  if (info.truncated_bytes > 0) out << "truncated  " << info.truncated_bytes << " bytes at the end are no whole word\n";
  out << "sha256     " << info.sha256 << "\n";
}

}  // namespace

CommandRunner AddInfoCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<InfoArguments>();
  AddFile(app, "recording", arguments->recording, "Prophesee RAW or DAT file; - for standard input")->required();
  app.add_flag("--json", arguments->is_json, "One JSON object on standard output");
  app.footer(
      "The SHA-256 covers the events as packed records of t u64 (microseconds, the sensor's clock), x u16, y u16,\n"
      "p u8, little-endian. It includes events outside the sensor whose address can be decoded.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose info cube/recording.raw --json");
  return [arguments, &context]() -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(const RecordingInfo info, ReadInfo(arguments->recording, context.is_interrupted));
    return PrintResult(context, arguments->is_json, InfoJson(info),
                       [&](std::ostream& out) { PrintInfo(arguments->recording, info, out); });
  };
}

}  // namespace evpose::client
