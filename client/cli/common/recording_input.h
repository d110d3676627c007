// SPDX-License-Identifier: Apache-2.0

// The recordings of the command line, and their times compared with those of poses.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "client/cli/common/command.h"
#include "client/cli/console/progress.h"
#include "core/recordings/event_reader.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

// The formats that all commands read, for --help.
inline constexpr char kRecordingFormats[] =
    "RAW, DAT, text, CSV, rosbag2 (FILE#TOPIC), HDF5, AEDAT or NumPy; -: standard input (RAW, DAT, text, AEDAT)";

// The formats of recordings that can be read while they grow.
inline constexpr char kLiveFormats[] = "RAW or DAT, a file that grows; -: standard input";

// Opens a recording of `camera`. The size of the sensor is that of `camera` if the recording states none. Errors: those
// of OpenRecording() and CheckCameraMatches().
absl::StatusOr<std::unique_ptr<RecordingReader>> OpenSeenBy(const CameraModel& camera, const std::string& camera_path,
                                                            const std::string& recording_path,
                                                            const RecordingReaderOptions& options = {});

// Shows the share of a recording that was read, in percent of its bytes or, if its size is unknown, in megabytes.
void ShowReading(const EventReader& events, const RecordingReader& recording, ProgressLine& progress);

// "3 lines that are not events, 1 damaged chunks"
std::string DescribeSkipped(const std::vector<SkippedParts>& skipped);
Json SkippedJson(const std::vector<SkippedParts>& skipped);

// Times of the first and of the last event, on the sensor's clock.
struct TimeSpan {
  int64_t from_us = 0;
  int64_t to_us = 0;

  bool operator==(const TimeSpan&) const = default;
};

// "from 16.000000 s to 16.500000 s"
std::string FormatTimeSpan(const TimeSpan& span);

// Returns a text with cause and remedy if the poses have no time in common with the events; empty if they have.
std::string DescribeNoCommonTime(const std::string& poses_path, const TimeSpan& poses,
                                 const std::string& recording_path, const TimeSpan& events);

}  // namespace evpose::client
