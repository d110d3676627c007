// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/recording_input.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/containers/open_recording.h"
#include "core/base/status_macros.h"

namespace evpose::client {

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenSeenBy(const CameraModel& camera, const std::string& camera_path,
                                                            const std::string& recording_path,
                                                            const RecordingReaderOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(
      std::unique_ptr<RecordingReader> reader,
      OpenRecording(recording_path, {.follow = options.follow,
                                     .stop = options.stop,
                                     .geometry = SensorGeometry{camera.width_px, camera.height_px}}));
  EVPOSE_RETURN_IF_ERROR(CheckCameraMatches(camera, camera_path, reader->header(), recording_path));
  return reader;
}

void ShowReading(const EventReader& events, const RecordingReader& recording, ProgressLine& progress) {
  const auto read_bytes = static_cast<double>(events.data_bytes());
  const auto total_bytes = static_cast<double>(recording.data_size_bytes());
  if (total_bytes > 0.0) {
    progress.Show(read_bytes / total_bytes, absl::StrFormat("%3.0f %% read", 100.0 * read_bytes / total_bytes));
  } else {
    progress.Show(-1.0, absl::StrFormat("%.1f MB read", read_bytes * 1e-6));
  }
}

std::string DescribeSkipped(const std::vector<SkippedParts>& skipped) {
  return absl::StrJoin(skipped, ", ", [](std::string* text, const SkippedParts& parts) {
    absl::StrAppend(text, parts.count, " ", parts.what);
  });
}

Json SkippedJson(const std::vector<SkippedParts>& skipped) {
  Json json = Json::array();
  for (const SkippedParts& parts : skipped) json.push_back({{"what", parts.what}, {"count", parts.count}});
  return json;
}

}  // namespace evpose::client
