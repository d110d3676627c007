// SPDX-License-Identifier: Apache-2.0

// Writes Metavision's HDF5 files, with events compressed by ECF (client/convert_hdf5/README.md).
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "client/containers/hdf5/event_pipe.h"
#include "client/convert_hdf5/hdf5_handle.h"
#include "core/events/event.h"

namespace evpose::client {

// Entries of Metavision's tables /CD/indexes and /EXT_TRIGGER/indexes, one for each 2000 us from the first event on: an
// event at or before the beginning of this period, and its time after the first event.
class PeriodIndex {
 public:
  // Appends to `rows` the entries that the next event completes, until `rows` has `max_rows` entries: an event after a
  // long gap completes millions. Returns false if some are left; then empty `rows` and call it again with the same
  // event. Times may decrease: an event that is earlier than the previous event completes no entry.
  bool Add(int64_t t_us, size_t max_rows, std::vector<IndexRow>& rows);
  // Adds the last entry, if there were events.
  void Finish(std::vector<IndexRow>& rows) const;
  // The attribute `offset` of the table: the time of the first event, negated.
  int64_t offset_us() const { return -first_us_; }

 private:
  IndexRow current_ = {0, -1};
  IndexRow before_ = {0, -1};
  int64_t first_us_ = 0;
  int64_t num_rows_ = 0;
  uint64_t num_events_ = 0;
};

class Hdf5Writer {
 public:
  // Writes to a temporary name beside `path`, which Close() renames, and registers it for RemoveTemporaryFiles().
  // Errors: INVALID_ARGUMENT for a path that is not a regular file; UNAVAILABLE if the file cannot be created.
  static absl::StatusOr<std::unique_ptr<Hdf5Writer>> Create(const std::string& path, const PipeHeader& header);
  ~Hdf5Writer();  // removes the temporary file unless Close() succeeded
  Hdf5Writer(const Hdf5Writer&) = delete;
  Hdf5Writer& operator=(const Hdf5Writer&) = delete;

  // Errors: INVALID_ARGUMENT for an event that ECF cannot hold or a gap of more than a day, which the index cannot
  // hold; UNAVAILABLE if the file cannot be written.
  absl::Status Write(absl::Span<const Event> events);
  absl::Status Write(absl::Span<const Trigger> triggers);
  // The last call. Errors as for Write().
  absl::Status Close();

 private:
  // A table that grows, and the table of its index.
  struct Table {
    Hdf5Handle rows, indexes;
    uint64_t num_rows = 0, num_indexes = 0;
    PeriodIndex index;
    std::vector<IndexRow> pending_indexes;
    int64_t last_us = -1;
  };

  Hdf5Writer(std::string path, std::string temporary_path, Hdf5Handle file)
      : path_(std::move(path)), temporary_path_(std::move(temporary_path)), file_(std::move(file)) {}

  bool MakeTable(const char* group, const Hdf5Handle& row_type, bool is_compressed, Table& table);
  absl::Status AddIndex(int64_t t_us, Table& table);
  absl::Status FlushIndexes(Table& table);
  absl::Status FlushEvents();
  // Ends the writing after a failed call of the library, and returns its error.
  absl::Status Fail();

  const std::string path_;
  const std::string temporary_path_;
  Hdf5Handle file_;
  const Hdf5Handle cd_type_ = CdRowType();
  const Hdf5Handle trigger_type_ = TriggerRowType();
  const Hdf5Handle index_type_ = IndexRowType();
  Table cd_, triggers_;
  std::vector<Event> pending_events_;  // fewer than a chunk
  std::vector<uint8_t> chunk_;
  enum class Phase { kWriting, kFailed, kClosed };
  Phase phase_ = Phase::kWriting;
};

}  // namespace evpose::client
