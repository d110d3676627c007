// SPDX-License-Identifier: Apache-2.0

// evpose convert: writes the events of a recording in another format.
#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/recording_input.h"
#include "client/cli/console/wait_message.h"
#include "client/containers/event_file_writer.h"
#include "client/containers/open_recording.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/events/image_size.h"
#include "core/recordings/event_digest.h"
#include "core/recordings/event_reader.h"

namespace evpose::client {
namespace {

struct ConvertArguments {
  std::string recording;
  std::string out;
  std::string to;
  std::string size;
  double start_s = 0.0;
  double duration_s = std::numeric_limits<double>::infinity();
  bool drops_outside = false;
  bool drops_triggers = false;
  bool is_json = false;
};

struct ConvertedEvents {
  EventFileHeader header;
  bool has_stated_size = false;  // the recording or --size states the size of the sensor
  std::string format;            // name of the format of the recording
  DecodeCounts counts;
  std::vector<SkippedParts> skipped;
  uint64_t num_events = 0;    // written
  uint64_t num_triggers = 0;  // between --start and --start + --duration
  int64_t t_first_us = 0;
  int64_t t_last_us = 0;
  std::string sha256;
};

constexpr double kMaxSeconds = 1e9;  // of --start and --duration, 31 years: their sum is a time in microseconds

// "640x480"
absl::StatusOr<std::optional<SensorGeometry>> ParseSize(const std::string& text) {
  if (text.empty()) return std::nullopt;
  if (const std::optional<SensorGeometry> size = ParseImageSize(text)) return size;
  return UsageError(absl::StrCat("--size: \"", text, "\" is not WIDTHxHEIGHT in pixels, such as 640x480"));
}

// False for standard input and for a pipe that has a name.
bool CanBeReadTwice(const std::string& path) {
  std::error_code error;
  const std::filesystem::file_type type = std::filesystem::status(path, error).type();
  return path != "-" && type != std::filesystem::file_type::fifo && type != std::filesystem::file_type::character &&
         type != std::filesystem::file_type::socket;
}

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenInput(const ConvertArguments& arguments,
                                                           const CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::optional<SensorGeometry> size, ParseSize(arguments.size));
  const std::optional<WaitMessage> wait = WaitForRecording(context, arguments.recording);
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<RecordingReader> reader,
                          OpenRecording(arguments.recording, {.stop = context.is_interrupted, .geometry = size}));
  const RecordingHeader& header = reader->header();
  if (size && header.geometry != *size) {
    return absl::InvalidArgumentError(absl::StrCat(arguments.recording, ": is of ", header.geometry.width_px, "x",
                                                   header.geometry.height_px, " pixels, but --size is ",
                                                   arguments.size));
  }
  if (!header.geometry_is_known && !CanBeReadTwice(arguments.recording)) {
    const std::string name = arguments.recording == "-" ? "standard input" : arguments.recording;
    return absl::InvalidArgumentError(absl::StrCat(name, ": states no size of the sensor: give it with --size"));
  }
  return reader;
}

EventFileHeader HeaderOf(const RecordingReader& reader) {
  const RecordingHeader& header = reader.header();
  return {header.geometry, header.time_offset_us, header.metavision_zero_us.value_or(0)};
}

using TakeEvents = std::function<absl::Status(absl::Span<const Event>, absl::Span<const evpose::Trigger>)>;

// Passes the events between --start and --start + --duration to `take`, and the triggers in this time. Without --start,
// triggers before the first event are passed, too.
absl::StatusOr<ConvertedEvents> ReadEvents(const ConvertArguments& arguments, const CliContext& context,
                                           RecordingReader& reader, const TakeEvents& take) {
  ConvertedEvents result;
  result.header = HeaderOf(reader);
  result.has_stated_size = reader.header().geometry_is_stated || !arguments.size.empty();
  result.format = reader.header().container;
  if (result.format.empty()) result.format = EncodingName(reader.header().encoding);
  const OutsideSensor outside = arguments.drops_outside ? OutsideSensor::kDrop : OutsideSensor::kKeep;
  EVPOSE_ASSIGN_OR_RETURN(EventReader events, EventReader::Make(reader, {.outside_sensor = outside}));
  std::optional<int64_t> begin_us;
  int64_t end_us = std::numeric_limits<int64_t>::max();
  std::vector<Event> selected;
  std::vector<evpose::Trigger> triggers;
  EventDigest digest;
  ProgressLine progress(context);
  while (true) {
    ShowReading(events, reader, progress);
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (context.IsInterrupted()) return absl::CancelledError("interrupted: nothing was written");
    if (!has_piece) break;
    selected.clear();
    for (const Event& event : events.decoded().events) {
      if (!begin_us) {
        begin_us = event.t_us + std::llround(arguments.start_s * 1e6);
        if (std::isfinite(arguments.duration_s)) end_us = *begin_us + std::llround(arguments.duration_s * 1e6);
      }
      // Times may step back: without --start, events that are earlier than the first one are also converted.
      const bool has_begun = arguments.start_s == 0 || event.t_us >= *begin_us;
      if (has_begun && event.t_us < end_us) selected.push_back(event);
    }
    triggers.clear();
    for (const evpose::Trigger& trigger : events.decoded().triggers) {
      const bool has_begun = arguments.start_s == 0 || (begin_us && trigger.t_us >= *begin_us);
      if (has_begun && trigger.t_us < end_us) triggers.push_back(trigger);
    }
    result.num_triggers += triggers.size();
    if (selected.empty() && triggers.empty()) continue;
    EVPOSE_RETURN_IF_ERROR(take(selected, triggers));
    if (selected.empty()) continue;
    digest.Add(selected);
    if (result.num_events == 0) result.t_first_us = selected.front().t_us;
    result.t_last_us = selected.back().t_us;
    result.num_events += selected.size();
  }
  result.counts = events.counts();
  result.skipped = reader.skipped();
  result.sha256 = digest.FinishHex();
  if (result.num_events > 0) return result;
  return absl::OutOfRangeError(
      begin_us ? absl::StrFormat("%s: has no event between --start and --start + --duration", arguments.recording)
               : absl::StrCat(arguments.recording, ": has no event"));
}

absl::Status CannotHold(const ConvertArguments& arguments, const EventFileFormat& format, const absl::Status& status) {
  return absl::InvalidArgumentError(absl::StrCat(arguments.recording, ": ", std::string(format.title),
                                                 " cannot store these events: ", status.message(),
                                                 ". No file was written. Write CSV, which can store any event, or drop "
                                                 "events outside the sensor with --drop-outside"));
}

absl::Status CheckTriggers(const ConvertArguments& arguments, const EventFileFormat& format,
                           absl::Span<const evpose::Trigger> triggers) {
  if (format.has_triggers || arguments.drops_triggers || triggers.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat(
      "%s: %s cannot store external triggers, such as the one at %.6f s. No file was written. Write RAW, or leave out "
      "the triggers with --drop-triggers",
      arguments.recording, std::string(format.title), triggers.front().t_us * 1e-6));
}

// Reads the whole recording and checks that the format can hold it. A pipe, which cannot be read twice, is checked
// while the file is written; after an error the file does not appear.
absl::Status CheckAll(const ConvertArguments& arguments, const EventFileFormat& format, const CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> reader, OpenInput(arguments, context));
  absl::StatusOr<std::unique_ptr<EventFileChecker>> checker = format.check(HeaderOf(*reader));
  if (!checker.ok()) return CannotHold(arguments, format, checker.status());
  const auto check = [&](absl::Span<const Event> events, absl::Span<const evpose::Trigger> triggers) -> absl::Status {
    EVPOSE_RETURN_IF_ERROR(CheckTriggers(arguments, format, triggers));
    const absl::Status status = (*checker)->Check(events, triggers);
    return status.ok() ? status : CannotHold(arguments, format, status);
  };
  return ReadEvents(arguments, context, *reader, check).status();
}

Json ConvertJson(const ConvertArguments& arguments, const EventFileFormat& format, const ConvertedEvents& converted) {
  return {{"recording", arguments.recording},
          {"format", converted.format},
          {"out", arguments.out},
          {"out_format", std::string(format.title)},
          {"width", converted.header.geometry.width_px},
          {"height", converted.header.geometry.height_px},
          {"geometry_is_stated", converted.has_stated_size},
          {"cd_events", converted.num_events},
          {"t_first_us", converted.t_first_us},
          {"t_last_us", converted.t_last_us},
          {"time_offset_us", converted.header.time_offset_us},
          {"sha256", converted.sha256},
          {"triggers", format.has_triggers ? converted.num_triggers : 0},
          {"triggers_left_out", format.has_triggers ? 0 : converted.num_triggers},
          {"dropped_events", converted.counts.dropped_events()},
          {"invalid_words", converted.counts.invalid_words()},
          {"skipped", SkippedJson(converted.skipped)}};
}

void PrintConverted(const ConvertArguments& arguments, const EventFileFormat& format, const ConvertedEvents& converted,
                    std::ostream& out) {
  out << absl::StrFormat("%s: %s %dx%d, %s of %s, %.6f to %.6f s\n", arguments.out, std::string(format.title),
                         converted.header.geometry.width_px, converted.header.geometry.height_px,
                         Counted(converted.num_events, "event"), converted.format, converted.t_first_us * 1e-6,
                         converted.t_last_us * 1e-6);
  out << "sha256     " << converted.sha256 << "\n";
}

// Reports which parts of the recording the new file lacks, and whether its size of the sensor is a guess.
void Warn(const EventFileFormat& format, const ConvertedEvents& converted, CliContext& context) {
  std::vector<SkippedParts> lost = converted.skipped;
  const DecodeCounts& counts = converted.counts;
  if (!format.has_triggers && converted.num_triggers > 0) lost.push_back({"triggers", converted.num_triggers});
  if (counts.dropped_events() > 0)
    lost.push_back({"events without time or outside the sensor", counts.dropped_events()});
  if (counts.invalid_words() > 0) lost.push_back({"invalid words", counts.invalid_words()});
  if (!lost.empty()) context.err << "evpose convert: left out: " << DescribeSkipped(lost) << "\n";
  if (!converted.has_stated_size) {
    context.err << absl::StrFormat(
        "evpose convert: the recording does not state the size of its sensor; %dx%d is a guess, which the new file "
        "states. Give the size with --size\n",
        converted.header.geometry.width_px, converted.header.geometry.height_px);
  }
}

absl::Status RunConvert(const ConvertArguments& arguments, CliContext& context) {
  const absl::StatusOr<EventFileFormat> format = ChooseEventFileFormat(arguments.to, arguments.out);
  EVPOSE_RETURN_IF_ERROR(AsUsageError(format.status()));
  if (CanBeReadTwice(arguments.recording)) EVPOSE_RETURN_IF_ERROR(CheckAll(arguments, *format, context));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> reader, OpenInput(arguments, context));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventFileWriter> writer,
                          format->create(arguments.out, HeaderOf(*reader)));
  const auto write = [&](absl::Span<const Event> events, absl::Span<const evpose::Trigger> triggers) -> absl::Status {
    EVPOSE_RETURN_IF_ERROR(CheckTriggers(arguments, *format, triggers));
    return writer->Write(events, triggers);
  };
  EVPOSE_ASSIGN_OR_RETURN(const ConvertedEvents converted, ReadEvents(arguments, context, *reader, write));
  EVPOSE_RETURN_IF_ERROR(writer->Close());
  Warn(*format, converted, context);
  return PrintResult(context, arguments.is_json, ConvertJson(arguments, *format, converted),
                     [&](std::ostream& out) { PrintConverted(arguments, *format, converted, out); });
}

}  // namespace

CommandRunner AddConvertCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<ConvertArguments>();
  app.option_defaults()->group(kInputGroup);
  AddFile(app, "recording", arguments->recording, absl::StrCat("Recording: ", kRecordingFormats))->required();
  AddOption(app, "--start", arguments->start_s, "Time after the first event at which the file begins",
            NumberRange(0.0, kMaxSeconds))
      ->type_name("SECONDS");
  app.add_option("--duration", arguments->duration_s, "Part of the recording from --start on. Default: all of it")
      ->type_name("SECONDS")
      ->check(AboveZero())
      ->check(NumberRange(0.0, kMaxSeconds));
  app.add_option("--size", arguments->size,
                 "Size of the sensor in pixels, for a recording that does not state it. Default: the smallest known "
                 "sensor that contains all events")
      ->type_name("WIDTHxHEIGHT");
  app.option_defaults()->group(kOutputGroup);
  AddOutputFile(app, "out", arguments->out, "File to write; its suffix is the format: .raw, .dat, .csv or .hdf5")
      ->required();
  std::vector<std::string> names;
  for (const EventFileFormat& format : EventFileFormats()) names.emplace_back(format.name);
  app.add_option("--to", arguments->to, "Format of the file. Default: by its suffix")->check(CLI::IsMember(names));
  app.add_flag("--drop-outside", arguments->drops_outside,
               "Leave out events outside the sensor, which RAW and DAT cannot store");
  app.add_flag("--drop-triggers", arguments->drops_triggers,
               "Leave out external triggers, which DAT and CSV cannot store");
  AddJson(app, arguments->is_json);
  app.footer(
      "The events keep their times, order, addresses and polarities: evpose info prints the same SHA-256 for both "
      "files. An event or a trigger that the format cannot store is an error, and nothing is written.\n\n"
      "In recordings with times since 1970, times become relative to the first event, and the header of the new file "
      "has the offset (time_offset_us).\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose convert cube/recording.raw cube/recording.csv --start 0.1 --duration 0.2");
  return [arguments, &context] { return RunConvert(*arguments, context); };
}

}  // namespace evpose::client
