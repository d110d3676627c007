// SPDX-License-Identifier: Apache-2.0
#include "client/containers/hdf5_source.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "client/containers/event_source.h"
#include "client/containers/hdf5/event_pipe.h"
#include "client/programs/program_path.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr char kHdf5Program[] = "evpose-hdf5";
constexpr std::string_view kHdf5Signature("\x89HDF\r\n\x1a\n", 8);

absl::StatusOr<std::unique_ptr<ChildProcess>> StartProgram(const char* command, const std::string& path) {
  const std::optional<std::string> program = FindProgram(kHdf5Program, "../convert_hdf5");
  if (program.has_value()) return ChildProcess::Start(*program, {command, PathArgument(path)});
  return absl::FailedPreconditionError(absl::StrCat(path, ": HDF5 needs the program ", kHdf5Program,
                                                    ", which is neither beside this program nor in the PATH: install "
                                                    "the Debian package ",
                                                    kHdf5Program, " (component hdf5 of cmake --install)"));
}

class Hdf5Source final : public EventSource {
 public:
  static absl::StatusOr<std::unique_ptr<EventSource>> Open(const std::string& path) {
    EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<ChildProcess> program, StartProgram("read", path));
    std::unique_ptr<Hdf5Source> source(new Hdf5Source(path, std::move(program)));
    EVPOSE_RETURN_IF_ERROR(source->ReadRecord());
    // Not NoRecord(): the program may be waiting for a reader of its further records.
    if (source->record_.kind != PipeRecordKind::kHeader) {
      return absl::DataLossError(absl::StrCat(path, ": evpose-hdf5 sent no header"));
    }
    const PipeHeader& header = source->record_.header;
    source->facts_ = {header.format, std::nullopt, header.time_offset_us, std::nullopt};
    if (header.geometry != SensorGeometry{}) source->facts_.geometry = header.geometry;
    if (header.metavision_zero_us >= 0) source->facts_.metavision_zero_us = header.metavision_zero_us;
    return source;
  }

  const SourceFacts& facts() const override { return facts_; }

  absl::StatusOr<bool> Next(std::vector<SourceEvent>& events) override {
    events.clear();
    if (record_.kind == PipeRecordKind::kEnd) return false;
    EVPOSE_RETURN_IF_ERROR(ReadRecord());
    if (record_.kind == PipeRecordKind::kTriggers) {
      triggers_.insert(triggers_.end(), record_.triggers.begin(), record_.triggers.end());
      if (triggers_.size() > kMaxPipeElements) {  // without events for so long there is nothing to merge them with
        AppendMerged({}, triggers_, events);
        triggers_.clear();
      }
    } else if (record_.kind == PipeRecordKind::kEvents) {
      AppendMerged(record_.events, triggers_, events);
      triggers_.clear();
    } else if (record_.kind == PipeRecordKind::kEnd) {
      AppendMerged({}, triggers_, events);
      triggers_.clear();
    }
    return true;
  }

  std::vector<SkippedParts> skipped() const override {
    std::vector<SkippedParts> parts;
    if (record_.losses.events > 0)
      parts.push_back({"events in damaged parts", record_.losses.events, SkippedParts::Loss::kEvents});
    if (record_.losses.triggers > 0)
      parts.push_back({"triggers in damaged parts", record_.losses.triggers, SkippedParts::Loss::kNone});
    if (record_.losses.invalid > 0)
      parts.push_back({"events with an invalid time or address", record_.losses.invalid, SkippedParts::Loss::kEvents});
    return parts;
  }

 private:
  Hdf5Source(std::string path, std::unique_ptr<ChildProcess> program)
      : path_(std::move(path)), program_(std::move(program)), buffer_(kReadBytes) {}

  // Replaces the record by the next one.
  absl::Status ReadRecord() {
    while (true) {
      absl::Span<const uint8_t> rest = absl::MakeConstSpan(buffer_).subspan(begin_, end_ - begin_);
      const size_t size = rest.size();
      EVPOSE_ASSIGN_OR_RETURN(const bool is_complete, TakePipeRecord(rest, record_));
      begin_ += size - rest.size();
      if (is_complete) return absl::OkStatus();
      std::copy(buffer_.begin() + static_cast<int64_t>(begin_), buffer_.begin() + static_cast<int64_t>(end_),
                buffer_.begin());
      end_ -= std::exchange(begin_, 0);
      if (end_ == buffer_.size()) buffer_.resize(2 * buffer_.size());  // the length of a record is bounded
      EVPOSE_ASSIGN_OR_RETURN(const size_t count, program_->Read(absl::MakeSpan(buffer_).subspan(end_)));
      if (count == 0) return NoRecord();
      end_ += count;
    }
  }

  // Why the program ended before the end of the recording.
  absl::Status NoRecord() {
    const absl::Status end = program_->Wait();
    if (end.code() == absl::StatusCode::kInvalidArgument) {
      return absl::InvalidArgumentError(absl::StrCat(path_, ": ", end.message()));
    }
    return absl::DataLossError(absl::StrCat(path_, ": cannot be read to its end, the file is probably damaged: ",
                                            end.ok() ? "evpose-hdf5 has ended" : end.message()));
  }

  const std::string path_;
  const std::unique_ptr<ChildProcess> program_;
  SourceFacts facts_;
  std::vector<uint8_t> buffer_;
  size_t begin_ = 0;  // of the bytes that are not taken
  size_t end_ = 0;
  PipeRecord record_;
  std::vector<Trigger> triggers_;  // of the events that follow
};

bool MatchesHdf5(std::string_view prefix) {
  // The signature may follow a block of the user of 512 bytes, or twice, four times, ... as many.
  for (size_t begin = 0; begin + kHdf5Signature.size() <= prefix.size(); begin = begin == 0 ? 512 : 2 * begin) {
    if (prefix.substr(begin, kHdf5Signature.size()) == kHdf5Signature) return true;
  }
  return false;
}

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenHdf5(ContainerFile file) {
  file.bytes = nullptr;
  const auto open = [&file]() { return Hdf5Source::Open(file.path); };
  return MakeSourceReader(file.name, open, file.geometry, true);
}

}  // namespace

const ContainerFormat kHdf5Format = {.name = "HDF5", .matches = MatchesHdf5, .open = OpenHdf5};

absl::StatusOr<std::unique_ptr<Hdf5Output>> Hdf5Output::Create(const std::string& path, const EventFileHeader& header) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<ChildProcess> program, StartProgram("write", path));
  std::unique_ptr<Hdf5Output> output(new Hdf5Output(std::move(program)));
  AppendPipeHeader({.format = "",
                    .geometry = header.geometry,
                    .time_offset_us = header.time_offset_us,
                    .metavision_zero_us = std::max(header.metavision_zero_us, int64_t{0})},
                   output->bytes_);
  EVPOSE_RETURN_IF_ERROR(output->Send());
  return output;
}

Hdf5Output::~Hdf5Output() { (void)program_->Wait(); }

absl::Status Hdf5Output::Send() {
  const absl::Status sent = program_->Write(bytes_);
  bytes_.clear();
  return sent;
}

absl::Status Hdf5Output::Write(absl::Span<const Event> events) {
  while (!events.empty()) {
    const auto part = events.first(std::min(events.size(), kMaxPipeElements));
    AppendPipeEvents(part, bytes_);
    EVPOSE_RETURN_IF_ERROR(Send());
    events.remove_prefix(part.size());
  }
  return absl::OkStatus();
}

absl::Status Hdf5Output::Write(absl::Span<const Trigger> triggers) {
  while (!triggers.empty()) {
    const auto part = triggers.first(std::min(triggers.size(), kMaxPipeElements));
    AppendPipeTriggers(part, bytes_);
    EVPOSE_RETURN_IF_ERROR(Send());
    triggers.remove_prefix(part.size());
  }
  return absl::OkStatus();
}

absl::Status Hdf5Output::Close() {
  AppendPipeEnd(bytes_);
  EVPOSE_RETURN_IF_ERROR(Send());
  return program_->Wait();
}

}  // namespace evpose::client
