// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/real_recordings.h"

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/recordings/event_reader.h"
#include "core/recordings/recording_reader.h"

namespace evpose {
namespace {

namespace fs = std::filesystem;

constexpr const char* kModelName = "model.obj";
constexpr const char* kCameraName = "camera.yaml";
constexpr size_t kMaxEvents = size_t{1} << 26;  // 1 GB

// The entries of a directory for which `is_wanted` is true, by name.
absl::StatusOr<std::vector<fs::path>> Entries(const fs::path& directory, bool (*is_wanted)(const fs::path&)) {
  std::error_code error;
  std::vector<fs::path> entries;
  for (fs::directory_iterator entry(directory, error), end; !error && entry != end; entry.increment(error)) {
    if (is_wanted(entry->path())) entries.push_back(entry->path());
  }
  if (error) return absl::NotFoundError(absl::StrCat(directory.string(), ": ", error.message()));
  std::sort(entries.begin(), entries.end());
  return entries;
}

bool IsFolder(const fs::path& path) {
  std::error_code error;
  return fs::is_directory(path, error);
}

bool IsFile(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

bool IsRecordingFile(const fs::path& path) { return path.extension() == ".raw" && IsFile(path); }
bool IsTrajectoryFile(const fs::path& path) { return path.extension() == ".tum" && IsFile(path); }

absl::Status Missing(const fs::path& path, const char* remedy) {
  return absl::NotFoundError(absl::StrCat(path.string(), ": there is no such file; ", remedy));
}

// Returns the index of the object of a folder; appends it to the list if its model file is new.
absl::StatusOr<int> AddObject(const fs::path& folder, const CameraModel& camera, RealDirectory& result) {
  const std::string path = (folder / kModelName).string();
  const ModelOptions options;
  EVPOSE_ASSIGN_OR_RETURN(const std::string content, ReadFile(path, options.max_bytes));
  for (size_t i = 0; i < result.objects.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string other, ReadFile(result.objects[i].model_path, options.max_bytes));
    if (other == content) return static_cast<int>(i);
  }
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, LoadObjectModel(path, options));
  result.objects.push_back(
      {folder.filename().string(), path, camera, std::make_shared<const ObjectModel>(std::move(model))});
  return static_cast<int>(result.objects.size()) - 1;
}

// The trajectory of the recording's name, or the only one of its folder.
absl::StatusOr<Trajectory> ReadReference(const fs::path& recording) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<fs::path> files, Entries(recording.parent_path(), IsTrajectoryFile));
  fs::path path = recording;
  path.replace_extension(".tum");
  if (files.size() == 1 && files[0] != path) path = files[0];
  if (!IsFile(path)) return Missing(path, "a recording beside a model.obj has a reference trajectory");
  EVPOSE_ASSIGN_OR_RETURN(Trajectory reference, ReadTumTrajectory(path.string()));
  if (reference.size() >= 2) return reference;
  return absl::InvalidArgumentError(absl::StrCat(path.string(), ": a reference needs two poses or more"));
}

absl::Status AddFolder(const fs::path& folder, RealDirectory& result) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<fs::path> files, Entries(folder, IsRecordingFile));
  const bool has_model = IsFile(folder / kModelName);
  if (files.empty()) return has_model ? Missing(folder / "*.raw", "a model.obj has a recording") : absl::OkStatus();
  int object = -1;
  CameraModel camera;
  if (has_model) {
    if (!IsFile(folder / kCameraName)) return Missing(folder / kCameraName, "a model.obj has the camera beside it");
    EVPOSE_ASSIGN_OR_RETURN(camera, LoadCameraModel((folder / kCameraName).string()));
    EVPOSE_ASSIGN_OR_RETURN(object, AddObject(folder, camera, result));
  }
  for (const fs::path& file : files) {
    RealRecording recording;
    const std::string name = folder.filename().string();
    recording.name = files.size() == 1 && has_model ? name : absl::StrCat(name, "/", file.stem().string());
    recording.events_path = file.string();
    EVPOSE_ASSIGN_OR_RETURN(const auto reader, RecordingReader::Open(recording.events_path));
    recording.geometry = reader->header().geometry;
    if (has_model) {
      recording.object = object;
      recording.camera = camera;
      EVPOSE_ASSIGN_OR_RETURN(recording.reference, ReadReference(file));
      const SensorGeometry& sensor = recording.geometry;
      if (sensor.width_px != camera.width_px || sensor.height_px != camera.height_px) {
        return absl::InvalidArgumentError(absl::StrFormat("%s: the recording has %d x %d pixels, but %s %d x %d",
                                                          recording.events_path, sensor.width_px, sensor.height_px,
                                                          kCameraName, camera.width_px, camera.height_px));
      }
    }
    result.recordings.push_back(std::move(recording));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<RealDirectory> ReadRealDirectory(const std::string& directory) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<fs::path> folders, Entries(directory, IsFolder));
  RealDirectory result;
  for (const fs::path& folder : folders) EVPOSE_RETURN_IF_ERROR(AddFolder(folder, result));
  if (!result.objects.empty()) return result;
  return absl::NotFoundError(absl::StrCat(
      directory, ": no folder below it has a recording (*.raw) with model.obj, camera.yaml and a reference (*.tum)"));
}

absl::StatusOr<std::vector<Event>> ReadRealEvents(const RealRecording& recording) {
  EVPOSE_ASSIGN_OR_RETURN(const auto reader, RecordingReader::Open(recording.events_path));
  EVPOSE_ASSIGN_OR_RETURN(EventReader pieces, EventReader::Make(*reader));
  std::vector<Event> events;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, pieces.Next());
    if (!has_piece) break;
    const EventVector& decoded = pieces.decoded().events;
    if (events.size() + decoded.size() > kMaxEvents) {
      return absl::InvalidArgumentError(
          absl::StrCat(recording.events_path, ": has more than ", kMaxEvents, " events; cut it"));
    }
    events.insert(events.end(), decoded.begin(), decoded.end());
  }
  if (!events.empty()) return events;
  return absl::InvalidArgumentError(absl::StrCat(recording.events_path, ": has no event"));
}

}  // namespace evpose
