// SPDX-License-Identifier: Apache-2.0

// Writes poses as text, and to files in the format of their extension, in the frame of the camera or in another one.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "client/cli/common/command.h"
#include "client/mcap/pose_recorder.h"
#include "core/base/output_file.h"
#include "core/geometry/rigid_transform.h"
#include "evpose/types.h"

namespace evpose::client {

inline constexpr char kCameraFromObject[] = "camera_from_object";
inline constexpr char kObjectFromCamera[] = "object_from_camera";

// The frame in which poses are written.
class PoseFrame {
 public:
  PoseFrame() = default;  // camera_from_object, as in the API
  static PoseFrame ObjectFromCamera();
  // `frame` is the name of the world frame. The transform is called "<frame>_from_object".
  static PoseFrame WorldFromObject(const RigidTransform& world_from_camera, const std::string& frame);

  // Name of the transform that is written, for example "world_from_object".
  const std::string& transform() const { return transform_; }
  bool is_default() const { return kind_ == Kind::kCamera; }
  // The frame whose Apply() turns poses with `transform()` into camera_from_object.
  PoseFrame ToCamera() const;
  // True if a pose is that of the camera in the frame of an object.
  bool is_of_camera() const { return kind_ == Kind::kObject; }
  // Name of the frame for people: "camera", "object" or the name of the world frame.
  std::string name() const;
  // Name of the frame in which the pose of an object is written.
  std::string FrameId(const std::string& object_id) const;
  // The name of the world frame and the camera's pose in it; nullopt without a world frame.
  std::optional<std::pair<std::string, Transform>> world_from_camera() const;
  // Everything that determines the output, for comparisons.
  std::string Description() const;

  // Returns the pose with all transforms, the covariance and the twist expressed as `transform()`
  // (core/geometry/README.md, section 5). Its field camera_from_object then holds that transform.
  Pose Apply(const Pose& pose) const;
  std::vector<Pose> Apply(absl::Span<const Pose> poses) const;

 private:
  enum class Kind { kCamera, kObject, kWorld };
  RigidTransform Transformed(const RigidTransform& camera_from_object) const;

  Kind kind_ = Kind::kCamera;
  std::string world_;
  RigidTransform world_from_camera_;
  std::string transform_ = kCameraFromObject;
};

// --world-from-camera and --pose.
struct PoseFrameArguments {
  std::string world_from_camera;  // a file; empty: none
  std::string pose = "camera-from-object";

  // For the commands that write or show poses; `verb` is "written" or "shown".
  void AddTo(CLI::App& app, const std::string& verb = "written");
  // --world-from-camera for the commands that only read files of poses.
  void AddForReading(CLI::App& app);
  // Prints a warning to `err` if the camera is so far from the world's origin that the file may not be in metres.
  // Errors: those of ReadTransformFile(), and INVALID_ARGUMENT for a world frame with the name of the camera's.
  absl::StatusOr<PoseFrame> Read(std::ostream& err) const;
};

// kMcap is not a text format: PoseRecorder writes it.
enum class PoseFormat { kTum, kCsv, kJsonLines, kMcap };

// Why a file has no pose although there are poses.
inline constexpr char kOnlyAmbiguousPoses[] =
    "every pose is AMBIGUOUS, and a .tum file has none of them: write .csv or .jsonl files";

// The formats of files of poses, for the help of the options that take one.
inline constexpr char kPoseFormats[] = ".tum, .csv, .jsonl, or .mcap for ROS 2, Foxglove and Lichtblick";

// Parses .tum, .csv, .jsonl or .mcap. Error: INVALID_ARGUMENT naming the extensions.
absl::StatusOr<PoseFormat> PoseFormatFromPath(const std::string& path);
// The header line, line feed included; empty for a format without a header. The transform of the poses, if it is not
// camera_from_object, is named in a TUM file in a comment before the poses, and in a CSV file in the last column,
// `transform`. JSON lines always have the field `transform`.
std::string PoseHeader(PoseFormat format, const PoseFrame& frame = {});
// One line, line feed included; empty for an AMBIGUOUS pose in TUM, which has no states. It depends on the bytes of the
// session only, so that it does not contain the latency.
std::string PoseLine(PoseFormat format, const Pose& pose, const PoseFrame& frame = {});
// The message of an object's state in a .mcap file: the fields of a JSON line, without those of the pose unless it is
// AMBIGUOUS.
std::string StateJson(const Pose& pose, const PoseFrame& frame = {});

struct PoseFilesOptions {
  PoseFrame frame;
  std::optional<int64_t> epoch_ns;  // PoseRecorderOptions::epoch_ns
  // Continues the output of an earlier process: the number of bytes of each file, by object, that Sync() returned.
  const std::map<std::string, uint64_t>* kept_bytes = nullptr;
  std::map<std::string, uint64_t> kept_poses;  // PoseFiles::num_poses() of the earlier process
};

// What became of a file of poses.
struct PoseFile {
  std::string path;
  uint64_t num_poses = 0;    // written to it; a .tum file has no AMBIGUOUS poses, the other formats have them
  int64_t last_t_us = 0;     // the latest time of those that this process has written
  bool keeps_older = false;  // the file of an earlier run stays, because there is no pose for it

  // "PATH: 3 poses", or why it was not written.
  std::string Describe() const;
};

// --epoch and --event-images of the commands that write .mcap files.
struct RecordingArguments {
  std::string epoch;
  int event_cell_px = 0;

  // `epoch_default` says what holds without --epoch.
  void AddTo(CLI::App& app, const std::string& epoch_default);
  // Error: INVALID_ARGUMENT (usage) for an option without a .mcap file `out`.
  absl::Status Check(const std::string& out) const;
  // The epoch in nanoseconds; nullopt for "host"; `without_option` if the option was not given.
  std::optional<int64_t> EpochNs(std::optional<int64_t> without_option) const;
};

// Writes the poses of the objects of a session as they arrive: to one file or, if the path contains "{object}", to one
// file for each object. A file appears under its name when it is complete. In all formats, a file without a pose does
// not replace an older file that is not empty.
class PoseFiles {
 public:
  // Errors: INVALID_ARGUMENT for an unknown extension, for a TUM file with several objects, and for an ID that cannot
  // be part of a file name.
  static absl::Status Check(const std::string& path, const std::vector<std::string>& object_ids);
  // Additional errors: those of OutputFile and PoseRecorder.
  static absl::StatusOr<PoseFiles> Open(const std::string& path, const std::vector<std::string>& object_ids,
                                        const PoseFilesOptions& options = {});
  // The first error is kept and returned by Commit().
  void Write(const Pose& pose);
  // The .mcap files, which also take states, health, cameras, models and images of events; empty for other formats.
  std::vector<PoseRecorder*> recorders() const;
  // Writes all data to the disk; returns the sizes of the files, by object.
  absl::StatusOr<std::map<std::string, uint64_t>> Sync();
  // The number of poses in the files, by object.
  std::map<std::string, uint64_t> num_poses() const;
  // Completes each file, or removes it if it has no pose and an older one is not empty. The last call that writes.
  absl::Status Commit();
  // The files, in the order of Paths(); PoseFile::keeps_older is set by Commit().
  std::vector<PoseFile> files() const;

  // The objects with files of their own, and the names of the files; the key of a single file for all objects is "".
  static std::map<std::string, std::string> Paths(const std::string& path, const std::vector<std::string>& object_ids);

 private:
  void Count(PoseFile& file, const Pose& pose);

  PoseFormat format_ = PoseFormat::kTum;
  PoseFrame frame_;
  std::map<std::string, OutputFile> files_;                         // by the object's ID; "" for a single file
  std::map<std::string, std::unique_ptr<PoseRecorder>> recorders_;  // the recorders of .mcap files
  std::map<std::string, PoseFile> written_;
};

}  // namespace evpose::client
