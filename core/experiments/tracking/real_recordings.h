// SPDX-License-Identifier: Apache-2.0

// A directory of recordings of real sensors with references.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"

namespace evpose {

// An object that is recorded, with the camera of its folder.
struct RealObject {
  std::string name;  // name of the first folder with this model file
  std::string model_path;
  CameraModel camera;
  std::shared_ptr<const ObjectModel> model;
};

struct RealRecording {
  std::string name;  // name of the folder; with the name of the file if the folder has several recordings
  std::string events_path;
  SensorGeometry geometry;  // as the recording states
  int object = -1;          // index into RealDirectory::objects; -1: none of the objects is in view
  CameraModel camera;       // if `object` is not negative
  Trajectory reference;     // if `object` is not negative
};

struct RealDirectory {
  std::vector<RealObject> objects;
  std::vector<RealRecording> recordings;
};

// Reads the list of the recordings below `directory`, in the order of the names. A folder with a recording (*.raw) has
// a model of the object (model.obj), the camera (camera.yaml) and for each recording NAME.raw its reference, NAME.tum
// or the only *.tum file. In the recordings of a folder without a model, no object of the other folders is in view.
// Folders without a recording and a model are skipped. Folders with equal model files show the same object. Errors name
// the file: NOT_FOUND for a missing file or a directory without recordings, INVALID_ARGUMENT for a camera of another
// size than the sensor, those of LoadObjectModel(), LoadCameraModel(), ReadTumTrajectory() and RecordingReader::Open().
absl::StatusOr<RealDirectory> ReadRealDirectory(const std::string& directory);

// The events of a recording. Errors: those of RecordingReader; INVALID_ARGUMENT for more than 2^26 events.
absl::StatusOr<std::vector<Event>> ReadRealEvents(const RealRecording& recording);

}  // namespace evpose
