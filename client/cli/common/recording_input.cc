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
      OpenRecording(recording_path, {.is_following = options.is_following,
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

std::string FormatTimeSpan(const TimeSpan& span) {
  return absl::StrFormat("from %.6f s to %.6f s", static_cast<double>(span.from_us) * 1e-6,
                         static_cast<double>(span.to_us) * 1e-6);
}

std::string DescribeNoCommonTime(const std::string& poses_path, const TimeSpan& poses,
                                 const std::string& recording_path, const TimeSpan& events) {
  if (poses.from_us <= events.to_us && poses.to_us >= events.from_us) return "";
  return absl::StrCat(poses_path, ": its poses are ", FormatTimeSpan(poses), ", but the events of ", recording_path,
                      " are ", FormatTimeSpan(events),
                      ": no pose can be drawn. If the poses are of this recording, their times must be those of the "
                      "sensor, which evpose info prints: run evpose replay with --time-zero sensor, or add the "
                      "offset of the clocks to the times in the file");
}

}  // namespace evpose::client
