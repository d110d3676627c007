// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/event_reader.h"

#include "absl/types/span.h"
#include "core/base/status_macros.h"

namespace evpose {

absl::StatusOr<EventReader> EventReader::Make(RecordingReader& recording, const EventReaderOptions& options) {
  const RecordingHeader& header = recording.header();
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<EventDecoder> decoder,
                          MakeEventDecoder(header.encoding, header.geometry, options.outside_sensor));
  return EventReader(recording, std::move(decoder), options.max_piece_bytes);
}

absl::StatusOr<bool> EventReader::Next() {
  decoded_.events.clear();
  decoded_.triggers.clear();
  decoded_.time_marks.clear();
  EVPOSE_ASSIGN_OR_RETURN(const size_t size, recording_->Read(absl::MakeSpan(piece_)));
  if (size == 0) return false;
  data_bytes_ += size;
  first_time_.Add(absl::MakeConstSpan(piece_).first(size));
  if (recording_->follows_loss()) decoder_->ResetAfterLoss();
  decoder_->Decode(absl::MakeConstSpan(piece_).first(size), decoded_);
  return true;
}

}  // namespace evpose
