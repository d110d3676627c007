// SPDX-License-Identifier: Apache-2.0
#include "core/events/recording_writer.h"

#include <cstdint>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/events/recording_header.h"

namespace evpose {

struct RecordingWriter::State {
  State(std::string path_in, OutputFile file_in, std::unique_ptr<EventEncoder> encoder_in)
      : path(std::move(path_in)), file(std::move(file_in)), encoder(std::move(encoder_in)) {}

  // Appends the encoded bytes unless encoding failed.
  absl::Status Flush(const absl::Status& encoded) {
    if (!encoded.ok()) return absl::Status(encoded.code(), absl::StrCat(path, ": ", encoded.message()));
    const absl::Status status = file.Append({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
    bytes.clear();
    return status;
  }

  std::string path;
  OutputFile file;
  std::unique_ptr<EventEncoder> encoder;
  std::vector<uint8_t> bytes;
  bool closed = false;
};

RecordingWriter::RecordingWriter() = default;
RecordingWriter::~RecordingWriter() = default;

absl::StatusOr<std::unique_ptr<RecordingWriter>> RecordingWriter::Create(const std::string& path, Encoding encoding,
                                                                         SensorGeometry geometry) {
  auto encoder = MakeEventEncoder(encoding, geometry);
  if (!encoder.ok()) {
    return absl::Status(encoder.status().code(), absl::StrCat(path, ": ", encoder.status().message()));
  }
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(path));
  EVPOSE_RETURN_IF_ERROR(file.Append(MakeRawHeader(encoding, geometry)));
  std::unique_ptr<RecordingWriter> writer(new RecordingWriter());
  writer->state_ = std::make_unique<State>(path, std::move(file), *std::move(encoder));
  return writer;
}

absl::Status RecordingWriter::Write(absl::Span<const Event> events) {
  if (state_->closed) return absl::FailedPreconditionError(absl::StrCat(state_->path, ": is closed already"));
  return state_->Flush(state_->encoder->Encode(events, state_->bytes));
}

absl::Status RecordingWriter::WriteTime(int64_t t_us) {
  if (state_->closed) return absl::FailedPreconditionError(absl::StrCat(state_->path, ": is closed already"));
  return state_->Flush(state_->encoder->EncodeTime(t_us, state_->bytes));
}

absl::Status RecordingWriter::Close() {
  if (state_->closed) return absl::FailedPreconditionError(absl::StrCat(state_->path, ": is closed already"));
  state_->closed = true;
  return state_->file.Commit();
}

}  // namespace evpose
