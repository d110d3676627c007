// SPDX-License-Identifier: Apache-2.0

// Writes a simulation as a directory of files.
#include <algorithm>
#include <filesystem>
#include <memory>
#include <string>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/recordings/recording_writer.h"
#include "core/simulation/describe.h"
#include "core/simulation/simulator.h"

namespace evpose {
namespace {

namespace fs = std::filesystem;

absl::Status FileError(const char* what, const fs::path& path, const std::error_code& error) {
  return absl::UnavailableError(absl::StrCat(path.string(), ": ", what, ": ", error.message()));
}

// A temporary directory inside the target. Files are written there and moved to the target when all are complete.
class StagingDirectory {
 public:
  static absl::StatusOr<std::unique_ptr<StagingDirectory>> Create(const fs::path& target) {
    std::error_code error;
    const bool made_target = fs::create_directories(target, error);
    if (error) return FileError("cannot make this directory", target, error);
    for (const char* name : kSimulationFiles) {
      // Checked before the simulation, because a failure at its end would leave some files replaced and others not.
      if (fs::is_directory(target / name, error)) {
        return absl::InvalidArgumentError(absl::StrCat(
            (target / name).string(), ": is a directory, but a file must be written here; move the directory"));
      }
    }
    auto staging = std::unique_ptr<StagingDirectory>(new StagingDirectory(target, made_target));
    fs::remove_all(staging->path_, error);  // left by a run that was killed
    fs::create_directory(staging->path_, error);
    if (error) return FileError("cannot make this directory", staging->path_, error);
    return staging;
  }

  ~StagingDirectory() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
    if (made_target_ && !is_published_) fs::remove(target_, ignored);
  }

  std::string PathOf(const char* name) const { return (path_ / name).string(); }

  absl::Status Publish() {
    for (const char* name : kSimulationFiles) {
      std::error_code error;
      fs::rename(path_ / name, target_ / name, error);
      if (error) return FileError("cannot replace this file", target_ / name, error);
      is_published_ = true;
    }
    return absl::OkStatus();
  }

 private:
  StagingDirectory(const fs::path& target, bool made_target)
      : target_(target), path_(target / ".simulation-in-progress"), made_target_(made_target) {}

  fs::path target_;
  fs::path path_;
  bool made_target_;
  bool is_published_ = false;
};

// Edges that were found in the mesh of a user are left out: a reader finds them again, and would take those of the file
// for all edges of the object.
std::string ModelText(const SimulationOptions& options, ObjectModel model) {
  const auto is_of_mesh = [](const auto& edge) { return edge.kind != EdgeKind::kPainted; };
  const bool has_edges_of_mesh = std::any_of(model.lines.begin(), model.lines.end(), is_of_mesh) ||
                                 std::any_of(model.curves.begin(), model.curves.end(), is_of_mesh);
  if (options.scene.model != nullptr && has_edges_of_mesh) {
    model.lines.clear();
    model.curves.clear();
  }
  return ObjectModelToObj(model);
}

}  // namespace

absl::StatusOr<SimulationReport> SimulateToDirectory(const SimulationOptions& options, const std::string& directory,
                                                     const std::function<void(double progress_ratio)>& on_progress,
                                                     const std::function<bool()>& is_cancelled) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<StagingDirectory> staging, StagingDirectory::Create(directory));
  EVPOSE_ASSIGN_OR_RETURN(const ObjectModel model, SimulatedModel(options));
  EVPOSE_RETURN_IF_ERROR(WriteFile(staging->PathOf(kSimulationNote), DescribeSimulation(options)));
  EVPOSE_RETURN_IF_ERROR(WriteFile(staging->PathOf("model.obj"), ModelText(options, model)));
  EVPOSE_RETURN_IF_ERROR(WriteFile(staging->PathOf("camera.yaml"), CameraModelToYaml(options.camera)));
  EVPOSE_RETURN_IF_ERROR(WriteTumTrajectory(staging->PathOf("truth.tum"), SimulatedTruth(options)));
  const SensorGeometry geometry = {options.camera.width_px, options.camera.height_px};
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingWriter> writer,
                          RecordingWriter::Create(staging->PathOf("recording.raw"), Encoding::kEvt3, geometry));
  const auto on_events = [&](absl::Span<const Event> events) -> absl::Status {
    if (is_cancelled && is_cancelled()) return absl::CancelledError("interrupted");
    return writer->Write(events);
  };
  EVPOSE_ASSIGN_OR_RETURN(const SimulationReport report, Simulate(options, on_events, on_progress));
  EVPOSE_RETURN_IF_ERROR(writer->Close());
  EVPOSE_RETURN_IF_ERROR(staging->Publish());
  return report;
}

}  // namespace evpose
