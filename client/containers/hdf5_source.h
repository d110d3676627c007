// SPDX-License-Identifier: Apache-2.0

// Recordings in HDF5, of Metavision (ECF) and of the shape of DSEC. The program evpose-hdf5 reads and writes them
// (client/containers/hdf5/README.md).
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "client/containers/container_format.h"
#include "client/containers/event_file_writer.h"
#include "client/programs/child_process.h"
#include "core/events/event.h"

namespace evpose::client {

extern const ContainerFormat kHdf5Format;

// Writes a recording as Metavision's HDF5 file with ECF. No file appears under its path before Close().
class Hdf5Output {
 public:
  // Errors have the path: FAILED_PRECONDITION with the package to install if evpose-hdf5 is missing.
  static absl::StatusOr<std::unique_ptr<Hdf5Output>> Create(const std::string& path, const EventFileHeader& header);
  // Without Close() it waits until the program has removed the incomplete file.
  ~Hdf5Output();
  Hdf5Output(const Hdf5Output&) = delete;
  Hdf5Output& operator=(const Hdf5Output&) = delete;

  // Takes events and triggers in the order of the file. Triggers may be written before or after events of their time.
  // Errors: INVALID_ARGUMENT for what the format cannot hold; a later call or Close() may return those of an earlier
  // one.
  absl::Status Write(absl::Span<const Event> events);
  absl::Status Write(absl::Span<const Trigger> triggers);
  // Completes the file; the last call.
  absl::Status Close();

 private:
  explicit Hdf5Output(std::unique_ptr<ChildProcess> program) : program_(std::move(program)) {}

  absl::Status Send();

  const std::unique_ptr<ChildProcess> program_;
  std::vector<uint8_t> bytes_;
};

}  // namespace evpose::client
