// SPDX-License-Identifier: Apache-2.0
#include "evpose/recording.h"

#include <utility>

#include "client/lib/messages/core_types.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/recordings/chunker.h"

namespace evpose::client {

struct Recording::Impl {
  Impl(std::unique_ptr<RecordingReader> opened, const ChunkerOptions& options)
      : reader(std::move(opened)), chunker(*reader, options) {}

  const std::unique_ptr<RecordingReader> reader;
  Chunker chunker;
};

Recording::Recording(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Recording::~Recording() = default;

absl::StatusOr<std::unique_ptr<Recording>> Recording::Open(const std::string& path, const RecordingOptions& options) {
  const ChunkerOptions chunker_options = {.max_duration_us = options.max_duration_us, .max_bytes = options.max_bytes};
  EVPOSE_RETURN_IF_ERROR(chunker_options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<RecordingReader> reader,
                          RecordingReader::Open(path, {.is_following = options.is_following, .stop = options.stop}));
  return std::unique_ptr<Recording>(new Recording(std::make_unique<Impl>(std::move(reader), chunker_options)));
}

EventEncoding Recording::encoding() const { return FromCore(impl_->reader->header().encoding); }
int Recording::width_px() const { return impl_->reader->header().geometry.width_px; }
int Recording::height_px() const { return impl_->reader->header().geometry.height_px; }

absl::StatusOr<EventChunk> Recording::Next() { return FromCore(impl_->chunker.Next()); }

absl::StatusOr<Camera> LoadCamera(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(const CameraModel camera, LoadCameraModel(path));
  return FromCore(camera);
}

}  // namespace evpose::client
