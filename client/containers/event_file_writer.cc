// SPDX-License-Identifier: Apache-2.0
#include "client/containers/event_file_writer.h"

#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/events/encoder.h"
#include "core/events/recording_writer.h"

namespace evpose::client {
namespace {

// RAW and DAT.
class EncodedFileWriter final : public EventFileWriter {
 public:
  explicit EncodedFileWriter(std::unique_ptr<RecordingWriter> writer) : writer_(std::move(writer)) {}

  absl::Status Write(absl::Span<const Event> events) override { return writer_->Write(events); }
  absl::Status Close() override { return writer_->Close(); }

 private:
  const std::unique_ptr<RecordingWriter> writer_;
};

class EncodingChecker final : public EventFileChecker {
 public:
  explicit EncodingChecker(std::unique_ptr<EventEncoder> encoder) : encoder_(std::move(encoder)) {}

  absl::Status Check(absl::Span<const Event> events) override {
    bytes_.clear();
    const absl::Status status = encoder_->Encode(events, bytes_);
    if (!status.ok()) {
      return absl::InvalidArgumentError(absl::StrCat("behind the first ", num_checked_, " events, ", status.message()));
    }
    num_checked_ += events.size();
    return absl::OkStatus();
  }

 private:
  const std::unique_ptr<EventEncoder> encoder_;
  std::vector<uint8_t> bytes_;
  uint64_t num_checked_ = 0;
};

template <Encoding kEncoding>
absl::StatusOr<std::unique_ptr<EventFileChecker>> CheckEncoded(const EventFileHeader& header) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<EventEncoder> encoder, MakeEventEncoder(kEncoding, header.geometry));
  return std::make_unique<EncodingChecker>(std::move(encoder));
}

template <Encoding kEncoding>
absl::StatusOr<std::unique_ptr<EventFileWriter>> CreateEncoded(const std::string& path, const EventFileHeader& header) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<RecordingWriter> writer,
                          RecordingWriter::Create(path, kEncoding, header.geometry, header.time_offset_us));
  return std::make_unique<EncodedFileWriter>(std::move(writer));
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

  absl::Status Write(absl::Span<const Event> events) override {
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
  absl::Status Check(absl::Span<const Event> /*events*/) override { return absl::OkStatus(); }
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

constexpr EventFileFormat kEventFileFormats[] = {
    {"raw", ".raw", "RAW EVT3", CheckEncoded<Encoding::kEvt3>, CreateEncoded<Encoding::kEvt3>},
    {"dat", ".dat", "DAT", CheckEncoded<Encoding::kDat>, CreateEncoded<Encoding::kDat>},
    {"csv", ".csv", "CSV (x,y,p,t)", CheckCsv, CreateCsv}};

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
