// SPDX-License-Identifier: Apache-2.0
#include "client/containers/event_file_writer.h"

#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "client/containers/hdf5/ecf_codec.h"
#include "client/containers/hdf5_source.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/events/encoder.h"
#include "core/recordings/recording_writer.h"

namespace evpose::client {
namespace {

constexpr bool HasTriggers(Encoding encoding) { return encoding != Encoding::kDat; }

// Calls `write_events` and `write_trigger` with the parts of both in the order of time: each trigger before the first
// of the remaining events at its time or later.
template <typename WriteEvents, typename WriteTrigger>
absl::Status InOrder(absl::Span<const Event> events, absl::Span<const evpose::Trigger> triggers,
                     const WriteEvents& write_events, const WriteTrigger& write_trigger) {
  for (const evpose::Trigger& trigger : triggers) {
    size_t count = 0;
    while (count < events.size() && events[count].t_us < trigger.t_us) ++count;
    EVPOSE_RETURN_IF_ERROR(write_events(events.first(count)));
    EVPOSE_RETURN_IF_ERROR(write_trigger(trigger));
    events.remove_prefix(count);
  }
  return write_events(events);
}

// RAW and DAT.
class EncodedFileWriter final : public EventFileWriter {
 public:
  EncodedFileWriter(std::unique_ptr<RecordingWriter> writer, bool has_triggers)
      : writer_(std::move(writer)), has_triggers_(has_triggers) {}

  absl::Status Write(absl::Span<const Event> events, absl::Span<const evpose::Trigger> triggers) override {
    if (!has_triggers_) return writer_->Write(events);
    return InOrder(
        events, triggers, [this](absl::Span<const Event> part) { return writer_->Write(part); },
        [this](const evpose::Trigger& trigger) { return writer_->WriteTrigger(trigger); });
  }
  absl::Status Close() override { return writer_->Close(); }

 private:
  const std::unique_ptr<RecordingWriter> writer_;
  const bool has_triggers_;
};

class EncodingChecker final : public EventFileChecker {
 public:
  EncodingChecker(std::unique_ptr<EventEncoder> encoder, bool has_triggers)
      : encoder_(std::move(encoder)), has_triggers_(has_triggers) {}

  absl::Status Check(absl::Span<const Event> events, absl::Span<const evpose::Trigger> triggers) override {
    if (!has_triggers_) triggers = {};
    bytes_.clear();
    return InOrder(
        events, triggers, [this](absl::Span<const Event> part) { return CheckEvents(part); },
        [this](const evpose::Trigger& trigger) { return CheckTrigger(trigger); });
  }

 private:
  absl::Status CheckEvents(absl::Span<const Event> events) {
    if (encoder_->Encode(events, bytes_).ok()) {
      num_checked_ += events.size();
      return absl::OkStatus();
    }
    // One by one, because the encoder counts the events of a call.
    for (const Event& event : events) {
      const absl::Status status = encoder_->Encode({&event, 1}, bytes_);
      if (!status.ok()) {
        return absl::InvalidArgumentError(
            absl::StrReplaceAll(status.message(), {{"event 0 ", absl::StrCat("event ", num_checked_, " ")}}));
      }
      ++num_checked_;
    }
    return absl::OkStatus();
  }

  absl::Status CheckTrigger(const evpose::Trigger& trigger) {
    const absl::Status status = encoder_->EncodeTrigger(trigger, bytes_);
    if (status.ok()) return status;
    return absl::InvalidArgumentError(absl::StrCat("before event ", num_checked_, ", ", status.message()));
  }

  const std::unique_ptr<EventEncoder> encoder_;
  const bool has_triggers_;
  std::vector<uint8_t> bytes_;
  uint64_t num_checked_ = 0;
};

template <Encoding kEncoding>
absl::StatusOr<std::unique_ptr<EventFileChecker>> CheckEncoded(const EventFileHeader& header) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<EventEncoder> encoder, MakeEventEncoder(kEncoding, header.geometry));
  return std::make_unique<EncodingChecker>(std::move(encoder), HasTriggers(kEncoding));
}

template <Encoding kEncoding>
absl::StatusOr<std::unique_ptr<EventFileWriter>> CreateEncoded(const std::string& path, const EventFileHeader& header) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<RecordingWriter> writer,
                          RecordingWriter::Create(path, kEncoding, header.geometry, header.time_offset_us));
  return std::make_unique<EncodedFileWriter>(std::move(writer), HasTriggers(kEncoding));
}

// Metavision's CSV: x,y,p,t in microseconds, behind a line "%geometry:W,H" as OpenEB's standalone decoder writes it.
class CsvFileWriter final : public EventFileWriter {
 public:
  explicit CsvFileWriter(OutputFile file) : file_(std::move(file)) {}

  absl::Status Begin(const EventFileHeader& header) {
    std::string text = absl::StrCat("%geometry:", header.geometry.width_px, ",", header.geometry.height_px, "\n");
    if (header.time_offset_us != 0) absl::StrAppend(&text, "%time_offset_us:", header.time_offset_us, "\n");
    return file_.Append(text);
  }

  absl::Status Write(absl::Span<const Event> events, absl::Span<const evpose::Trigger> /*triggers*/) override {
    text_.clear();
    for (const Event& event : events) {
      absl::StrAppend(&text_, event.x, ",", event.y, ",", static_cast<int>(event.polarity), ",", event.t_us);
      text_ += '\n';
    }
    return file_.Append(text_);
  }
  absl::Status Close() override { return file_.Commit(); }

 private:
  OutputFile file_;
  std::string text_;
};

// CSV holds every event.
class CsvChecker final : public EventFileChecker {
 public:
  absl::Status Check(absl::Span<const Event> /*events*/, absl::Span<const evpose::Trigger> /*triggers*/) override {
    return absl::OkStatus();
  }
};

absl::StatusOr<std::unique_ptr<EventFileChecker>> CheckCsv(const EventFileHeader& /*header*/) {
  return std::make_unique<CsvChecker>();
}

absl::StatusOr<std::unique_ptr<EventFileWriter>> CreateCsv(const std::string& path, const EventFileHeader& header) {
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(path));
  auto writer = std::make_unique<CsvFileWriter>(std::move(file));
  EVPOSE_RETURN_IF_ERROR(writer->Begin(header));
  return writer;
}

// Metavision's HDF5.
class Hdf5FileWriter final : public EventFileWriter {
 public:
  explicit Hdf5FileWriter(std::unique_ptr<Hdf5Output> output) : output_(std::move(output)) {}

  absl::Status Write(absl::Span<const Event> events, absl::Span<const evpose::Trigger> triggers) override {
    EVPOSE_RETURN_IF_ERROR(output_->Write(triggers));
    return output_->Write(events);
  }
  absl::Status Close() override { return output_->Close(); }

 private:
  const std::unique_ptr<Hdf5Output> output_;
};

class Hdf5Checker final : public EventFileChecker {
 public:
  absl::Status Check(absl::Span<const Event> events, absl::Span<const evpose::Trigger> /*triggers*/) override {
    for (const Event& event : events) {
      if (event.x > kEcfMaxCoordinatePx || event.y > kEcfMaxCoordinatePx) {
        return absl::InvalidArgumentError(absl::StrCat("event ", num_checked_, " at x ", event.x, ", y ", event.y,
                                                       " lies beyond column or row ", kEcfMaxCoordinatePx));
      }
      ++num_checked_;
    }
    return absl::OkStatus();
  }

 private:
  uint64_t num_checked_ = 0;
};

absl::StatusOr<std::unique_ptr<EventFileChecker>> CheckHdf5(const EventFileHeader& header) {
  if (header.geometry.width_px <= kEcfMaxCoordinatePx + 1 && header.geometry.height_px <= kEcfMaxCoordinatePx + 1) {
    return std::make_unique<Hdf5Checker>();
  }
  return absl::InvalidArgumentError(absl::StrCat("a sensor of ", header.geometry.width_px, "x",
                                                 header.geometry.height_px,
                                                 " pixels has more than 2048 columns or rows"));
}

absl::StatusOr<std::unique_ptr<EventFileWriter>> CreateHdf5(const std::string& path, const EventFileHeader& header) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<Hdf5Output> output, Hdf5Output::Create(path, header));
  return std::make_unique<Hdf5FileWriter>(std::move(output));
}

constexpr EventFileFormat kEventFileFormats[] = {
    {"raw", ".raw", "RAW EVT3", true, CheckEncoded<Encoding::kEvt3>, CreateEncoded<Encoding::kEvt3>},
    {"dat", ".dat", "DAT", false, CheckEncoded<Encoding::kDat>, CreateEncoded<Encoding::kDat>},
    {"csv", ".csv", "CSV (x,y,p,t)", false, CheckCsv, CreateCsv},
    {"hdf5", ".hdf5", "HDF5 (ECF)", true, CheckHdf5, CreateHdf5}};

}  // namespace

absl::Span<const EventFileFormat> EventFileFormats() { return kEventFileFormats; }

absl::StatusOr<EventFileFormat> ChooseEventFileFormat(const std::string& name, const std::string& path) {
  const std::string lower_path = absl::AsciiStrToLower(path);
  for (const EventFileFormat& format : EventFileFormats()) {
    if (name.empty() ? std::string_view(lower_path).ends_with(format.suffix) : name == format.name) return format;
  }
  const std::string names = absl::StrJoin(EventFileFormats(), ", ", [](std::string* text, const EventFileFormat& each) {
    absl::StrAppend(text, std::string(each.suffix));
  });
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": its name ends with none of ", names, ": rename it, or choose the format with --to"));
}

}  // namespace evpose::client
