// SPDX-License-Identifier: Apache-2.0

// Reads the events of HDF5 files of Metavision and of the shape of DSEC (client/convert_hdf5/README.md).
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/containers/hdf5/event_pipe.h"
#include "client/convert_hdf5/hdf5_column.h"
#include "client/convert_hdf5/hdf5_handle.h"
#include "core/events/event.h"

namespace evpose::client {

// Rows of a read from a table that is not divided into chunks: as many as Metavision's chunks have.
inline constexpr uint64_t kMaxRows = 16384;

class Hdf5Reader {
 public:
  // Errors: NOT_FOUND, PERMISSION_DENIED, INVALID_ARGUMENT for a file that HDF5 cannot open, that has no events in a
  // known layout, or that has a time offset or time shift out of range; and the errors of Hdf5Column::Open().
  static absl::StatusOr<std::unique_ptr<Hdf5Reader>> Open(const std::string& path);
  virtual ~Hdf5Reader() = default;

  const PipeHeader& header() const { return header_; }

  // Replaces both by the next ones, of which there may be none; at most kMaxPipeElements of each. Triggers come with
  // events of their time. False at the end. What cannot be read is skipped and counted.
  virtual bool Next(std::vector<Event>& events, std::vector<Trigger>& triggers) = 0;

  const PipeLosses& losses() const { return losses_; }

 protected:
  PipeHeader header_;
  PipeLosses losses_;

 private:
  // Open() without the checks of the times in the header.
  static absl::StatusOr<std::unique_ptr<Hdf5Reader>> OpenShape(const std::string& path);
};

// Metavision: /CD/events, and /EXT_TRIGGER/events if there.
absl::StatusOr<std::unique_ptr<Hdf5Reader>> OpenMetavision(Hdf5Handle file);
// DSEC: /events/x, /events/y, /events/p, /events/t, and /t_offset if there.
absl::StatusOr<std::unique_ptr<Hdf5Reader>> OpenDsec(Hdf5Handle file);

}  // namespace evpose::client
