// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/recording_input.h"

#include "absl/strings/str_cat.h"
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
