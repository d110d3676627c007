// SPDX-License-Identifier: Apache-2.0

// Random access to the events of a recording of any format.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/view/page_messages.h"
#include "core/events/decoder.h"
#include "core/events/event_counts.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

struct RecordedEventsOptions {
  uint64_t spacing_bytes = uint64_t{256} * 1024;  // between two positions: decoding it takes some milliseconds
  size_t max_positions = size_t{1} << 15;         // of more, every second is removed and the spacing doubled
};

// A thread reads the recording once from its beginning and stores positions from which a decoder can continue. Events
// that have been read can be accessed meanwhile. Events of a RAW or DAT file are read again from that file; those of
// other recordings are stored in a temporary file. Thread-safe.
class RecordedEvents {
 public:
  // `path` is the file of `reader`. Errors: UNAVAILABLE if the file cannot be opened again, or no temporary file can be
  // created; those of MakeEventDecoder().
  static absl::StatusOr<std::unique_ptr<RecordedEvents>> Open(const std::string& path,
                                                              std::unique_ptr<RecordingReader> reader,
                                                              const RecordedEventsOptions& options = {});
  ~RecordedEvents();

  SensorGeometry geometry() const { return header_.geometry; }

  struct Progress {
    bool has_events = false;
    TimeSpan range;  // of the events so far
    bool is_complete = false;
    absl::Status status;  // the error at which reading ended
  };
  Progress progress() const;
  // Counts of the events so far.
  EventCounts counts() const;
  // Calls `on_progress`, on another thread, after each piece of the recording that was read. No call follows the
  // destruction of the returned handle.
  std::shared_ptr<void> Subscribe(std::function<void()> on_progress);

  // Whether all events before `to_us` have been read.
  bool HasUntil(int64_t to_us) const;
  // Calls `visit` for the events of [from_us, to_us) that have been read, in the order of the recording. Errors: those
  // of reading the file.
  absl::Status Visit(int64_t from_us, int64_t to_us, const std::function<void(absl::Span<const Event>)>& visit) const;

 private:
  struct Position {
    uint64_t offset = 0;    // of the data
    int64_t latest_us = 0;  // of the events before
    std::string decoder;    // its state
  };

  RecordedEvents(std::unique_ptr<RecordingReader> reader, std::unique_ptr<EventDecoder> decoder, int file,
                 uint64_t data_offset, bool is_own, const RecordedEventsOptions& options);
  void ReadAll(const std::stop_token& stop);
  // Appends the bytes that were read to the temporary file.
  absl::Status Keep(absl::Span<const uint8_t> bytes) const;
  void AddPosition(uint64_t offset);
  void AddLoss(uint64_t offset);
  void Publish(uint64_t read_bytes, const DecodedEvents& decoded);
  void Finish(const absl::Status& status);
  absl::StatusOr<size_t> ReadAt(uint64_t offset, absl::Span<uint8_t> buffer) const;

  const std::unique_ptr<RecordingReader> reader_;
  const RecordingHeader header_;
  const std::unique_ptr<EventDecoder> decoder_;
  const int file_;
  const uint64_t data_offset_;  // of the data in the file
  const bool is_own_;           // the file is the temporary one
  const size_t max_positions_;
  mutable std::mutex mutex_;
  Progress progress_ ABSL_GUARDED_BY(mutex_);
  EventCounts counts_ ABSL_GUARDED_BY(mutex_);
  uint64_t read_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<Position> positions_ ABSL_GUARDED_BY(mutex_);
  uint64_t spacing_bytes_ ABSL_GUARDED_BY(mutex_);
  std::vector<uint64_t> losses_ ABSL_GUARDED_BY(mutex_);  // offsets before which bytes were lost
  std::mutex listeners_mutex_;
  std::map<uint64_t, std::function<void()>> listeners_ ABSL_GUARDED_BY(listeners_mutex_);
  uint64_t next_listener_ ABSL_GUARDED_BY(listeners_mutex_) = 0;
  std::jthread thread_;
};

}  // namespace evpose::client
