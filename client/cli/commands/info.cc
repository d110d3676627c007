// SPDX-License-Identifier: Apache-2.0

// evpose info: describes the content of a recording.
#include <algorithm>
#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/commands.h"
#include "core/base/counted.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"
#include "core/events/decoder.h"
#include "core/events/event_reader.h"
#include "core/events/recording_reader.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

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

absl::StatusOr<RecordingInfo> ReadInfo(const std::string& path, const std::function<bool()>& is_interrupted) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> reader,
                          RecordingReader::Open(path, {.stop = is_interrupted}));
  RecordingInfo info;
  info.header = reader->header();
  EVPOSE_ASSIGN_OR_RETURN(EventReader events, EventReader::Make(*reader, {.outside_sensor = OutsideSensor::kKeep}));
  Sha256 digest;
  uint64_t num_events = 0;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (!has_piece) break;
    const auto& piece = events.decoded().events;
    StateWriter packed;  // t u64, x u16, y u16, p u8, little-endian
    for (const Event& event : piece) {
      if (num_events++ == 0) info.t_first_us = event.t_us;
      info.on_events += event.polarity;
      packed(event.t_us, event.x, event.y, event.polarity);
    }
    if (!piece.empty()) info.t_last_us = piece.back().t_us;
    const std::string bytes = packed.Take();
    digest.Update({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()});
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
  return {{"format", std::string(EncodingName(info.header.encoding))},
          {"width", info.header.geometry.width_px},
          {"height", info.header.geometry.height_px},
          {"cd_events", counts.cd_events},
          {"triggers", counts.triggers},
          {"t_first_us", has_events ? Json(info.t_first_us) : Json(nullptr)},
          {"t_last_us", has_events ? Json(info.t_last_us) : Json(nullptr)},
          {"invalid_words", counts.invalid_words()},
          {"dropped_events", counts.dropped_events()},
          {"sha256", info.sha256},
          {"on_events", info.on_events},
          {"off_events", counts.cd_events - info.on_events},
          {"unknown_words", counts.unknown_words},
          {"broken_vectors", counts.broken_vectors},
          {"dropped_before_time", counts.dropped_before_time},
          {"dropped_outside_sensor", counts.dropped_outside_sensor},
          {"kept_outside_sensor", counts.kept_outside_sensor},
          {"time_backsteps", counts.time_backsteps},
          {"clock_wraps", counts.clock_wraps},
          {"data_bytes", info.data_bytes},
          {"truncated_bytes", info.truncated_bytes},
          {"geometry_is_stated", info.header.geometry_is_stated}};
}

void PrintInfo(const std::string& path, const RecordingInfo& info, std::ostream& out) {
  const DecodeCounts& counts = info.counts;
  const double duration_s = static_cast<double>(info.t_last_us - info.t_first_us) * 1e-6;
  out << path << ": " << EncodingName(info.header.encoding) << " " << info.header.geometry.width_px << "x"
      << info.header.geometry.height_px << (info.header.geometry_is_stated ? "" : " (not stated by the header)")
      << "\n";
  out << absl::StrFormat("events     %d (%d ON, %d OFF), %s\n", counts.cd_events, info.on_events,
                         counts.cd_events - info.on_events, Counted(counts.triggers, "trigger"));
  if (counts.cd_events > 0) {
    out << absl::StrFormat("time       %.6f to %.6f s, %.6f s", info.t_first_us * 1e-6, info.t_last_us * 1e-6,
                           duration_s);
    if (duration_s > 0.0)
      out << absl::StrFormat(", %.3f Mev/s", static_cast<double>(counts.cd_events) * 1e-6 / duration_s);
    out << "\n";
  }
  out << absl::StrFormat("clock      %s, %s\n", Counted(counts.clock_wraps, "wrap"),
                         Counted(counts.time_backsteps, "step back", "steps back"));
  out << absl::StrFormat("invalid    %s (%d unknown, %s)\n", Counted(counts.invalid_words(), "word"),
                         counts.unknown_words, Counted(counts.broken_vectors, "broken vector"));
  out << absl::StrFormat("dropped    %s (%d before the first time stamp, %d with an unreadable address)\n",
                         Counted(counts.dropped_events(), "event"), counts.dropped_before_time,
                         counts.dropped_outside_sensor);
  if (counts.kept_outside_sensor > 0) {
    out << absl::StrFormat("outside    %s outside the sensor; replay leaves such events out\n",
                           Counted(counts.kept_outside_sensor, "event"));
  }
  if (info.truncated_bytes > 0)
    out << "truncated  " << Counted(info.truncated_bytes, "byte") << " at the end: no whole word\n";
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
