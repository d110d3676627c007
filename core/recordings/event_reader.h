// SPDX-License-Identifier: Apache-2.0

// Reads a recording in pieces and decodes them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "core/events/decoder.h"
#include "core/events/event.h"
#include "core/events/first_time_word.h"
#include "core/recordings/recording_reader.h"

namespace evpose {

struct EventReaderOptions {
  OutsideSensor outside_sensor = OutsideSensor::kDrop;
  size_t max_piece_bytes = size_t{256} * 1024;  // at least 1; bounds the memory for a recording of any size
};

class EventReader {
 public:
  // Keeps a reference: `recording` must outlive the reader. Errors: those of MakeEventDecoder().
  static absl::StatusOr<EventReader> Make(RecordingReader& recording, const EventReaderOptions& options = {});

  // Replaces decoded() by the events of the next piece, of which there may be none. Returns false at the end of the
  // recording, where decoded() is empty. Errors: those of RecordingReader::Read().
  absl::StatusOr<bool> Next();
  const DecodedEvents& decoded() const { return decoded_; }

  // RecordingHeader::metavision_zero_us, or the time of FirstTimeWord; 0 if there was none so far.
  int64_t metavision_zero_us() const { return first_time_.t_us().value_or(0); }
  uint64_t data_bytes() const { return data_bytes_; }  // bytes read after the header
  const DecodeCounts& counts() const { return decoder_->counts(); }
  int pending_bytes() const { return decoder_->pending_bytes(); }  // bytes of an unfinished word

 private:
  EventReader(RecordingReader& recording, std::unique_ptr<EventDecoder> decoder, size_t max_piece_bytes)
      : recording_(&recording),
        decoder_(std::move(decoder)),
        first_time_(recording.header().encoding, recording.header().metavision_zero_us),
        piece_(max_piece_bytes) {}

  RecordingReader* recording_;
  std::unique_ptr<EventDecoder> decoder_;
  FirstTimeWord first_time_;
  std::vector<uint8_t> piece_;
  DecodedEvents decoded_;
  uint64_t data_bytes_ = 0;
};

}  // namespace evpose
