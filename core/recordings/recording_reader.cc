// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/recording_reader.h"

#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

class RawReader final : public RecordingReader {
 public:
  explicit RawReader(std::unique_ptr<ByteSource> source) : source_(std::move(source)) {}

  // Reads the header and, unless following, the first byte after it.
  absl::Status Start() {
    const std::string& name = source_->name();
    std::optional<RecordingHeader> header;
    for (size_t wanted = 1; !header.has_value();) {
      EVPOSE_ASSIGN_OR_RETURN(const std::string_view prefix, source_->Peek(wanted));
      const bool is_end = prefix.size() < wanted;
      if (is_end && source_->was_stopped()) {
        return absl::CancelledError(absl::StrCat(name, ": stopped before the end of its header"));
      }
      if (is_end && prefix.empty()) return absl::InvalidArgumentError(absl::StrCat(name, ": is empty"));
      auto parsed = ParseRecordingHeader(prefix, is_end);
      if (!parsed.ok()) {
        return absl::Status(parsed.status().code(), absl::StrCat(name, ": ", parsed.status().message()));
      }
      header = *std::move(parsed);
      wanted = prefix.size() + 1;
    }
    header_ = *std::move(header);
    if (source_->size_bytes() >= 0) {
      data_size_bytes_ = source_->size_bytes() - static_cast<int64_t>(header_.size_bytes);
    }
    source_->Drop(header_.size_bytes);
    if (source_->options().is_following) return absl::OkStatus();
    EVPOSE_ASSIGN_OR_RETURN(const std::string_view data, source_->Peek(1));
    if (!data.empty()) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat(name, ": has a header but no events"));
  }

  const RecordingHeader& header() const override { return header_; }
  int64_t data_size_bytes() const override { return data_size_bytes_; }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override { return source_->Read(buffer); }

 private:
  const std::unique_ptr<ByteSource> source_;
  RecordingHeader header_;
  int64_t data_size_bytes_ = -1;
};

}  // namespace

absl::StatusOr<std::unique_ptr<RecordingReader>> RecordingReader::Open(const std::string& path,
                                                                       const RecordingReaderOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<ByteSource> source, ByteSource::Open(path, options));
  return FromBytes(std::move(source));
}

absl::StatusOr<std::unique_ptr<RecordingReader>> RecordingReader::FromBytes(std::unique_ptr<ByteSource> source) {
  auto reader = std::make_unique<RawReader>(std::move(source));
  EVPOSE_RETURN_IF_ERROR(reader->Start());
  return reader;
}

}  // namespace evpose
