// SPDX-License-Identifier: Apache-2.0

// Recordings and cameras in files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "evpose/track.h"
#include "evpose/types.h"

namespace evpose::client {

struct RecordingOptions {
  // Whether reading continues at the end of the file as it grows, until `stop` returns true.
  bool is_following = false;
  std::function<bool()> stop;             // polled while no data arrive; true: the recording ends here
  int64_t max_duration_us = 1000;         // a chunk ends after this sensor time: one pose period at 1 kHz
  size_t max_bytes = size_t{256} * 1024;  // a chunk ends at this size; a multiple of 8, at least 8
};

// The encoded events of a Prophesee RAW or DAT file. Not thread-safe.
class Recording {
 public:
  // `path` "-" is standard input. Errors name the path: NOT_FOUND, PERMISSION_DENIED, INVALID_ARGUMENT for a header
  // that is contradictory or names no format, and for invalid options.
  static absl::StatusOr<std::unique_ptr<Recording>> Open(const std::string& path, const RecordingOptions& options = {});
  ~Recording();

  EventEncoding encoding() const;
  int width_px() const;  // width of the sensor, from the header
  int height_px() const;

  // Returns the next chunk; empty bytes at the end. Errors: DATA_LOSS or UNAVAILABLE naming path and offset.
  absl::StatusOr<EventChunk> Next();

 private:
  struct Impl;
  explicit Recording(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Reads a camera calibration; the format is recognised by the content: ROS camera_info or printed message, Kalibr
// camchain (FILE#cam1 selects a camera), Metavision intrinsics, OpenCV FileStorage, COLMAP cameras.txt, DV. Errors name
// the file and the field: NOT_FOUND, INVALID_ARGUMENT.
absl::StatusOr<Camera> LoadCamera(const std::string& path);

}  // namespace evpose::client
