// SPDX-License-Identifier: Apache-2.0

// Tracks the object of a recording, for calibrations without known poses.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/calibration/line_samples.h"
#include "core/estimation/sensor_profile.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/recordings/recording_reader.h"

namespace evpose {

// max_intervals and motion_px are validated as CameraCalibrationOptions; the other fields are input.
struct TrackedRecordingOptions {
  SensorProfile sensor;
  // Ends after so many microseconds of the recording.
  int64_t max_duration_us = std::numeric_limits<int64_t>::max();
  // Ends so many microseconds after the object was found.
  int64_t max_tracked_us = std::numeric_limits<int64_t>::max();
  // Largest number of intervals of CollectIntervals(): 300 give each parameter of a lens some thousand independent
  // measurements. When there are more, every other one is dropped, and later ones are as far apart.
  int max_intervals = 300;
  // Mean motion of the image in an interval, pixels: the events of an edge then cover all positions between two pixels.
  double motion_px = 2.0;
};

// Called with the seconds of the recording that have been processed.
using RecordingProgress = absl::FunctionRef<void(double seconds)>;

// Reads the recording to its end, or to the largest duration. Returns the poses while the object is TRACKING; empty if
// it was never found. Errors: those of RecordingReader::Read() and of Tracker::Create().
absl::StatusOr<Trajectory> TrackRecording(RecordingReader& recording, std::shared_ptr<const ObjectModel> model,
                                          const CameraModel& camera, const TrackedRecordingOptions& options,
                                          RecordingProgress on_progress);

// Reads the recording likewise. Returns the intervals in which the object is TRACKING and moves, in order of time. If
// it is DEGRADED most of the time, as with a camera that is far from the true one, these intervals count, too. `index`
// is their CalibrationInterval::recording. Errors: the same.
absl::StatusOr<std::vector<CalibrationInterval>> CollectIntervals(RecordingReader& recording, int index,
                                                                  std::shared_ptr<const ObjectModel> model,
                                                                  const CameraModel& camera,
                                                                  const TrackedRecordingOptions& options,
                                                                  RecordingProgress on_progress);

}  // namespace evpose
