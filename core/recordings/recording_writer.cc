// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/recording_writer.h"

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/recordings/recording_header.h"

namespace evpose {

absl::StatusOr<std::unique_ptr<RecordingWriter>> RecordingWriter::Create(const std::string& path, Encoding encoding,
                                                                         SensorGeometry geometry,
                                                                         int64_t time_offset_us) {
  auto encoder = MakeEventEncoder(encoding, geometry);
  if (!encoder.ok()) {
    return absl::Status(encoder.status().code(), absl::StrCat(path, ": ", encoder.status().message()));
  }
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(path));
  EVPOSE_RETURN_IF_ERROR(file.Append(MakeRawHeader(encoding, geometry, time_offset_us)));
  return std::unique_ptr<RecordingWriter>(new RecordingWriter(path, std::move(file), *std::move(encoder)));
}

absl::Status RecordingWriter::Write(absl::Span<const Event> events) {
  EVPOSE_RETURN_IF_ERROR(CheckOpen());
  return Flush(encoder_->Encode(events, bytes_));
}

absl::Status RecordingWriter::WriteTrigger(const Trigger& trigger) {
  EVPOSE_RETURN_IF_ERROR(CheckOpen());
  return Flush(encoder_->EncodeTrigger(trigger, bytes_));
}

absl::Status RecordingWriter::Close() {
  EVPOSE_RETURN_IF_ERROR(CheckOpen());
  is_closed_ = true;
  return file_.Commit();
}

absl::Status RecordingWriter::CheckOpen() const {
  return is_closed_ ? absl::FailedPreconditionError(absl::StrCat(path_, ": is closed already")) : absl::OkStatus();
}

absl::Status RecordingWriter::Flush(const absl::Status& encoded) {
  if (!encoded.ok()) return absl::Status(encoded.code(), absl::StrCat(path_, ": ", encoded.message()));
  const absl::Status status = file_.Append({reinterpret_cast<const char*>(bytes_.data()), bytes_.size()});
  bytes_.clear();
  return status;
}

}  // namespace evpose
