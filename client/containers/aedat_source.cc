// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat_source.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "client/containers/aedat/aedat4_decoder.h"
#include "client/containers/aedat/aedat_decoder.h"
#include "client/containers/aedat/aedat_header.h"
#include "client/containers/event_source.h"
#include "core/base/byte_order.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Bytes of AEDAT 2.0 from which the sensor is guessed if the header does not name it.
constexpr size_t kGuessedBytes = size_t{1} << 20;

class AedatSource final : public EventSource {
 public:
  AedatSource(std::unique_ptr<ByteSource> bytes, std::unique_ptr<AedatDecoder> decoder, SourceFacts facts)
      : bytes_(std::move(bytes)), decoder_(std::move(decoder)), facts_(std::move(facts)), buffer_(kReadBytes) {}

  const SourceFacts& facts() const override { return facts_; }

  absl::StatusOr<bool> Next(std::vector<SourceEvent>& events) override {
    events.clear();
    if (is_at_end_) return false;
    if (rest_.empty()) {
      EVPOSE_ASSIGN_OR_RETURN(const size_t size, bytes_->Read(absl::MakeSpan(buffer_)));
      rest_ = absl::MakeConstSpan(buffer_).first(size);
      is_at_end_ = size == 0;
    }
    decoded_.events.clear();
    decoded_.triggers.clear();
    is_at_end_ ? decoder_->Finish() : decoder_->Decode(rest_, decoded_);
    AppendMerged(decoded_.events, decoded_.triggers, events);
    return true;
  }

  std::vector<SkippedParts> skipped() const override {
    const AedatCounts& counts = decoder_->counts();
    std::vector<SkippedParts> parts;
    using Loss = SkippedParts::Loss;
    const auto add = [&parts](const char* what, uint64_t count, Loss loss) {
      if (count > 0) parts.push_back({what, count, loss});
    };
    add("inertial measurements", counts.imu_samples, Loss::kNone);
    add("image samples", counts.image_samples, Loss::kNone);
    add("marks other than triggers", counts.other_records, Loss::kNone);
    add("packets of frames, inertial measurements or other cameras", counts.other_packets, Loss::kNone);
    add("events outside the sensor", counts.outside_sensor, Loss::kEvents);
    add("invalid events", counts.invalid_events, Loss::kEvents);
    add("damaged packets", counts.damaged_packets, Loss::kPieces);
    add("packets of more than 64 MiB, which are not read", counts.oversized_packets, Loss::kPieces);
    add("bytes of incomplete or damaged data", counts.lost_bytes, Loss::kPieces);
    return parts;
  }

 private:
  const std::unique_ptr<ByteSource> bytes_;
  const std::unique_ptr<AedatDecoder> decoder_;
  const SourceFacts facts_;
  std::vector<uint8_t> buffer_;
  absl::Span<const uint8_t> rest_;  // of the buffer, what is not decoded
  DecodedEvents decoded_;
  bool is_at_end_ = false;
};

// Parses a header with more and more bytes until they suffice.
template <typename Header, typename Parse>
absl::StatusOr<Header> ParseGrowing(ByteSource& bytes, const Parse& parse) {
  for (size_t wanted = kSniffedBytes;; wanted *= 2) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string_view prefix, bytes.Peek(wanted));
    absl::StatusOr<std::optional<Header>> header = parse(prefix, prefix.size() < wanted);
    if (!header.ok()) {
      return absl::Status(header.status().code(), absl::StrCat(bytes.name(), ": ", header.status().message()));
    }
    if (header->has_value()) return **std::move(header);
  }
}

std::optional<SensorGeometry> Stated(SensorGeometry geometry) {
  return geometry == SensorGeometry{} ? std::nullopt : std::optional(geometry);
}

std::string NameOf(const char* version, const std::string& sensor) {
  return sensor.empty() ? version : absl::StrCat(version, " (", sensor, ")");
}

absl::StatusOr<std::unique_ptr<EventSource>> MakeSource2(std::unique_ptr<ByteSource> bytes, AedatHeader header) {
  if (header.sensor.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string_view prefix, bytes->Peek(header.size_bytes + kGuessedBytes));
    header.layout = GuessAedat2Layout(AsBytes(prefix.substr(header.size_bytes)));
    header.sensor = "DVS128";
    header.geometry = {128, 128};
  }
  if (header.layout == Aedat2Layout::kUnknown) {
    return absl::InvalidArgumentError(
        absl::StrCat(bytes->name(),
                     ": the header of this AEDAT 2.0 recording names no sensor, and the addresses are not "
                     "those of a DVS128: insert a line such as '# AEChip: DAVIS240C' after the first"));
  }
  bytes->Drop(header.size_bytes);
  return std::make_unique<AedatSource>(std::move(bytes), MakeAedat2Decoder(header.layout, header.geometry),
                                       SourceFacts{NameOf("AEDAT 2.0", header.sensor), header.geometry, 0});
}

absl::StatusOr<std::unique_ptr<EventSource>> MakeSource4(std::unique_ptr<ByteSource> bytes) {
  EVPOSE_ASSIGN_OR_RETURN(const Aedat4Header header,
                          ParseGrowing<Aedat4Header>(*bytes, [](std::string_view prefix, bool is_whole_file) {
                            return ParseAedat4Header(AsBytes(prefix), is_whole_file);
                          }));
  bytes->Drop(header.size_bytes);
  return std::make_unique<AedatSource>(std::move(bytes), MakeAedat4Decoder(header),
                                       SourceFacts{NameOf("AEDAT 4.0", header.source), Stated(header.geometry), 0});
}

absl::StatusOr<std::unique_ptr<EventSource>> MakeAedatSource(std::unique_ptr<ByteSource> bytes) {
  EVPOSE_ASSIGN_OR_RETURN(const AedatHeader header,
                          ParseGrowing<AedatHeader>(*bytes, [](std::string_view prefix, bool is_whole_file) {
                            return ParseAedatHeader(absl::string_view(prefix.data(), prefix.size()), is_whole_file);
                          }));
  if (header.version == AedatVersion::k4) return MakeSource4(std::move(bytes));
  if (header.version == AedatVersion::k2) return MakeSource2(std::move(bytes), header);
  bytes->Drop(header.size_bytes);
  return std::make_unique<AedatSource>(std::move(bytes), MakeAedat3Decoder(header.geometry),
                                       SourceFacts{NameOf("AEDAT 3.1", header.sensor), Stated(header.geometry), 0});
}

bool MatchesAedat(std::string_view prefix) { return IsAedat(absl::string_view(prefix.data(), prefix.size())); }

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenAedat(ContainerFile file) {
  const bool is_stream = file.path.empty();
  const RecordingReaderOptions options = file.bytes->options();
  const auto open = [&]() -> absl::StatusOr<std::unique_ptr<EventSource>> {
    if (file.bytes == nullptr) {
      EVPOSE_ASSIGN_OR_RETURN(file.bytes, ByteSource::Open(file.path, options));
    }
    return MakeAedatSource(std::move(file.bytes));
  };
  return MakeSourceReader(file.name, open, file.geometry, !is_stream);
}

}  // namespace

const ContainerFormat kAedatFormat = {
    .name = "AEDAT", .matches = MatchesAedat, .open = OpenAedat, .reads_streams = true};

}  // namespace evpose::client
