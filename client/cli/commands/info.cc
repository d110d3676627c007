// SPDX-License-Identifier: Apache-2.0

// evpose info: describes the content of a recording.
#include <algorithm>
#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/recording_input.h"
#include "client/cli/console/wait_message.h"
#include "client/containers/open_recording.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/events/decoder.h"
#include "core/recordings/event_digest.h"
#include "core/recordings/event_reader.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {
namespace {

struct InfoArguments {
  std::string recording;
  bool is_json = false;
};

struct RecordingInfo {
  RecordingHeader header;
  DecodeCounts counts;
  std::vector<SkippedParts> skipped;
  int64_t metavision_zero_us = 0;  // EventReader::metavision_zero_us()
  uint64_t on_events = 0;
  int64_t t_first_us = 0;  // times of the first and the last event in the stream; meaningless without events
  int64_t t_last_us = 0;
  uint64_t data_bytes = 0;
  int truncated_bytes = 0;
  std::string sha256;
};

absl::StatusOr<RecordingInfo> ReadInfo(const std::string& path, const CliContext& context) {
  std::optional<WaitMessage> wait = WaitForRecording(context, path);
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> reader,
                          OpenRecording(path, {.stop = context.is_interrupted}));
  wait.reset();
  RecordingInfo info;
  info.header = reader->header();
  EVPOSE_ASSIGN_OR_RETURN(EventReader events, EventReader::Make(*reader, {.outside_sensor = OutsideSensor::kKeep}));
  EventDigest digest;
  uint64_t num_events = 0;
  ProgressLine progress(context);
  while (true) {
    ShowReading(events, *reader, progress);
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (!has_piece) break;
    const auto& piece = events.decoded().events;
    for (const Event& event : piece) {
      if (num_events++ == 0) info.t_first_us = event.t_us;
      info.on_events += event.polarity;
    }
    if (!piece.empty()) info.t_last_us = piece.back().t_us;
    digest.Add(piece);
  }
  info.data_bytes = events.data_bytes();
  info.truncated_bytes = events.pending_bytes();
  info.counts = events.counts();
  info.skipped = reader->skipped();
  info.metavision_zero_us = events.metavision_zero_us();
  info.sha256 = digest.FinishHex();
  return info;
}

Json InfoJson(const RecordingInfo& info) {
  const DecodeCounts& counts = info.counts;
  const bool has_events = counts.cd_events > 0;
  const std::string encoding(EncodingName(info.header.encoding));
  return {{"format", info.header.container.empty() ? encoding : info.header.container},
          {"encoding", encoding},
          {"width", info.header.geometry.width_px},
          {"height", info.header.geometry.height_px},
          {"cd_events", counts.cd_events},
          {"triggers", counts.triggers},
          {"t_first_us", has_events ? Json(info.t_first_us) : Json(nullptr)},
          {"t_last_us", has_events ? Json(info.t_last_us) : Json(nullptr)},
          {"metavision_zero_us", info.metavision_zero_us},
          {"t_first_metavision_us", has_events ? Json(info.t_first_us - info.metavision_zero_us) : Json(nullptr)},
          {"time_offset_us", info.header.time_offset_us},
          {"invalid_words", counts.invalid_words()},
          {"dropped_events", counts.dropped_events()},
          {"sha256", info.sha256},
          {"on_events", info.on_events},
          {"off_events", counts.cd_events - info.on_events},
          {"unknown_words", counts.unknown_words},
          {"padding_words", counts.padding_words},
          {"skipped", SkippedJson(info.skipped)},
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

std::string DescribeFormat(const RecordingHeader& header) {
  const std::string encoding(EncodingName(header.encoding));
  return header.container.empty() ? encoding : absl::StrCat(header.container, ", read as ", encoding, ",");
}

std::string DescribeSizeSource(const std::string& path, const RecordingHeader& header) {
  if (header.geometry_is_stated) return "";
  if (header.container.empty() || path == "-") return " (not stated by the header)";
  return " (not stated: the smallest known sensor that contains all events)";
}

std::string DescribeSensorZero(const RecordingHeader& header) {
  if (header.encoding != Encoding::kFlat64) return "the sensor's start";
  return header.time_offset_us == 0 ? "the zero of the file" : "the offset below";
}

// Metavision reads no ROS bags: it counts from the first time word of a RAW file with the same packets.
std::string DescribeMetavisionFile(const RecordingHeader& header) {
  const bool is_raw = header.container.empty() || header.encoding == Encoding::kFlat64;
  return is_raw ? "" : ", in a RAW file of these packets,";
}

// Prints the zeros of the clocks of other programs.
void PrintTimeZeros(const RecordingInfo& info, std::ostream& out) {
  // Metavision takes the times of formats without time words as they are, unless an HDF5 file states another zero.
  const bool has_time_words = info.header.encoding != Encoding::kDat && info.header.encoding != Encoding::kFlat64;
  if (info.counts.cd_events > 0 && (has_time_words || info.metavision_zero_us != 0)) {
    out << absl::StrFormat(
        "zero       times count from %s; Metavision's zero%s is at %.6f s, its first event at %.6f s\n",
        DescribeSensorZero(info.header), DescribeMetavisionFile(info.header), info.metavision_zero_us * 1e-6,
        (info.t_first_us - info.metavision_zero_us) * 1e-6);
  }
  if (info.header.time_offset_us != 0) {
    out << absl::StrFormat("offset     time 0 is %d us on the recording's own clock\n", info.header.time_offset_us);
  }
}

void PrintInfo(const std::string& path, const RecordingInfo& info, std::ostream& out) {
  const DecodeCounts& counts = info.counts;
  const double duration_s = static_cast<double>(info.t_last_us - info.t_first_us) * 1e-6;
  out << path << ": " << DescribeFormat(info.header) << " " << info.header.geometry.width_px << "x"
      << info.header.geometry.height_px << DescribeSizeSource(path, info.header) << "\n";
  out << absl::StrFormat("events     %d (%d ON, %d OFF), %s\n", counts.cd_events, info.on_events,
                         counts.cd_events - info.on_events, Counted(counts.triggers, "trigger"));
  if (counts.cd_events > 0) {
    out << absl::StrFormat("time       %.6f to %.6f s, %.6f s", info.t_first_us * 1e-6, info.t_last_us * 1e-6,
                           duration_s);
    if (duration_s > 0.0)
      out << absl::StrFormat(", %.3f Mev/s", static_cast<double>(counts.cd_events) * 1e-6 / duration_s);
    out << "\n";
  }
  PrintTimeZeros(info, out);
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
  if (counts.padding_words > 0) out << "padding    " << Counted(counts.padding_words, "word") << "\n";
  if (!info.skipped.empty()) out << "left out   " << DescribeSkipped(info.skipped) << "\n";
  if (info.truncated_bytes > 0)
    out << "truncated  " << Counted(info.truncated_bytes, "byte") << " at the end: no whole word\n";
  out << "sha256     " << info.sha256 << "\n";
}

}  // namespace

CommandRunner AddInfoCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<InfoArguments>();
  AddFile(app, "recording", arguments->recording, absl::StrCat("Recording: ", kRecordingFormats))
      ->required()
      ->group(kInputGroup);
  AddJson(app, arguments->is_json);
  app.footer(
      "The SHA-256 covers the events as packed little-endian records: t as 64 bits (microseconds on the sensor's "
      "clock), x and y as 16 bits each, and the polarity as 8 bits. It includes events outside the sensor whose "
      "address can be decoded.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose info cube/recording.raw --json");
  return [arguments, &context]() -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(const RecordingInfo info, ReadInfo(arguments->recording, context));
    return PrintResult(context, arguments->is_json, InfoJson(info),
                       [&](std::ostream& out) { PrintInfo(arguments->recording, info, out); });
  };
}

}  // namespace evpose::client
