// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pose_format.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "absl/time/time.h"
#include "client/cli/common/pose_columns.h"
#include "client/lib/messages/core_types.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/geometry/trajectory.h"
#include "core/geometry/transform_file.h"

namespace evpose::client {
namespace {

constexpr char kObjectPlaceholder[] = "{object}";

// Visits the upper triangle row by row.
template <typename Visit>
void VisitUpper(const Eigen::Matrix<double, 6, 6>& matrix, const Visit& visit) {
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) visit(row, column, matrix(row, column));
  }
}

std::string StateName(const Pose& pose) { return std::string(TrackStateName(pose.state)); }

std::string CauseName(const Loss& loss) { return std::string(LossCauseName(loss.cause)); }

// The translation and the quaternion [x y z w].
std::array<double, 7> Numbers(const Transform& transform) {
  const Eigen::Vector3d& t = transform.translation_m;
  const Eigen::Quaterniond q = transform.Quaternion();
  return {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()};
}

std::string CsvHeader(const PoseFrame& frame) {
  std::string line =
      "pose_seq,object_id,t_us,tx_m,ty_m,tz_m,qx,qy,qz,qw,state,num_events,explained_ratio,residual_rms_px";
  for (const char* const name : kTwistColumns) absl::StrAppend(&line, ",", name);
  VisitUpper(Eigen::Matrix<double, 6, 6>::Zero(), [&](int row, int column, double) {
    absl::StrAppend(&line, ",cov_", kCovarianceAxes[static_cast<size_t>(row)], "_",
                    kCovarianceAxes[static_cast<size_t>(column)]);
  });
  absl::StrAppend(&line, ",num_alternatives");
  for (size_t i = 1; i <= kAlternativesInCsv; ++i) {
    for (const char* const name : kPoseColumns) absl::StrAppend(&line, ",alt", i, "_", name);
    absl::StrAppend(&line, ",alt", i, "_", kLikelihoodColumn);
  }
  absl::StrAppend(&line, ",", kLossTimeColumn, ",", kLossCauseColumn);
  if (!frame.is_default()) absl::StrAppend(&line, ",", kTransformKey);
  return line + "\n";
}

std::string CsvLine(const Pose& pose, const PoseFrame& frame) {
  std::string line = absl::StrFormat("%d,%s,%d", pose.seq, pose.object_id, pose.t_us);
  for (const double value : Numbers(pose.camera_from_object)) absl::StrAppendFormat(&line, ",%.17g", value);
  absl::StrAppendFormat(&line, ",%s,%d,%.9g,%.9g", StateName(pose), pose.num_events, pose.explained_ratio,
                        pose.residual_rms_px);
  for (const double value : pose.twist) absl::StrAppendFormat(&line, ",%.17g", value);
  VisitUpper(pose.covariance, [&](int, int, double value) { absl::StrAppendFormat(&line, ",%.17g", value); });
  absl::StrAppend(&line, ",", pose.alternatives.size());
  for (size_t i = 0; i < kAlternativesInCsv; ++i) {
    if (i >= pose.alternatives.size()) {
      absl::StrAppend(&line, ",,,,,,,,");
      continue;
    }
    const PoseAlternative& alternative = pose.alternatives[i];
    for (const double value : Numbers(alternative.camera_from_object)) absl::StrAppendFormat(&line, ",%.17g", value);
    absl::StrAppendFormat(&line, ",%.9g", alternative.log_likelihood_ratio);
  }
  if (pose.latest_loss) {
    absl::StrAppend(&line, ",", pose.latest_loss->t_us, ",", CauseName(*pose.latest_loss));
  } else {
    absl::StrAppend(&line, ",,");
  }
  if (!frame.is_default()) absl::StrAppend(&line, ",", frame.transform());
  return line + "\n";
}

void SetTransform(const Transform& transform, nlohmann::ordered_json& json) {
  const std::array<double, 7> n = Numbers(transform);
  json["translation_m"] = {n[0], n[1], n[2]};
  json["quaternion_xyzw"] = {n[3], n[4], n[5], n[6]};
}

nlohmann::ordered_json PoseJson(const Pose& pose, const PoseFrame& frame) {
  nlohmann::ordered_json json;
  json["pose_seq"] = pose.seq;
  json["object_id"] = pose.object_id;
  json["t_us"] = pose.t_us;
  json[kTransformKey] = frame.transform();
  SetTransform(pose.camera_from_object, json);
  json["state"] = StateName(pose);
  json["num_events"] = pose.num_events;
  json["explained_ratio"] = pose.explained_ratio;
  json["residual_rms_px"] = pose.residual_rms_px;
  json["twist"] = std::vector<double>(pose.twist.begin(), pose.twist.end());
  std::vector<double> upper;
  VisitUpper(pose.covariance, [&](int, int, double value) { upper.push_back(value); });
  json["covariance_upper"] = upper;
  json["alternatives"] = nlohmann::ordered_json::array();
  for (const PoseAlternative& alternative : pose.alternatives) {
    nlohmann::ordered_json item;
    SetTransform(alternative.camera_from_object, item);
    item["log_likelihood_ratio"] = alternative.log_likelihood_ratio;
    json["alternatives"].push_back(std::move(item));
  }
  json[kLossTimeColumn] = nullptr;
  json[kLossCauseColumn] = nullptr;
  if (pose.latest_loss) {
    json[kLossTimeColumn] = pose.latest_loss->t_us;
    json[kLossCauseColumn] = CauseName(*pose.latest_loss);
  }
  return json;
}

std::string Text(const nlohmann::ordered_json& json) {
  // An object ID that is not valid UTF-8 must not stop the output.
  return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

constexpr char kWorldFromCameraHelp[] =
    "Constant pose of the camera in the frame of a world or a robot: \"tx ty tz qx qy qz qw\", a 4x4 matrix, or YAML "
    "with translation and rotation";

constexpr char kHostEpoch[] = "host";

// "SECONDS", at most nine decimals, before 2038, which is the range of stamps in ROS; nullopt for other texts.
std::optional<int64_t> ParseEpoch(const std::string& text) {
  absl::Duration epoch;
  const bool is_number = text.find_first_not_of("0123456789.") == std::string::npos;
  if (!is_number || !absl::ParseDuration(text + "s", &epoch) || epoch >= absl::Seconds(int64_t{1} << 31)) {
    return std::nullopt;
  }
  return absl::ToInt64Nanoseconds(epoch);
}

std::string CheckEpoch(const std::string& text) {
  if (text == kHostEpoch || ParseEpoch(text)) return "";
  return absl::StrCat("\"", text, "\" is neither host nor a number of seconds from 0 to 2147483647");
}

// Whether it is a file, and not a pipe or a device, that is not empty.
bool HasContents(const std::string& path) {
  std::error_code error;
  return std::filesystem::is_regular_file(path, error) && std::filesystem::file_size(path, error) > 0 && !error;
}

// The entry of an object, or that of all objects; the end if there is neither.
template <typename File>
auto FindFile(std::map<std::string, File>& files, const std::string& object_id) {
  const auto own = files.find(object_id);
  return own != files.end() ? own : files.find("");
}

// A camera that is farther from the origin of its world, metres, is reported: rooms and halls are smaller, and the
// millimetres of a robot's cell would be larger numbers.
constexpr double kFarFromWorldM = 100.0;

}  // namespace

absl::StatusOr<PoseFormat> PoseFormatFromPath(const std::string& path) {
  if (absl::EndsWith(path, ".tum")) return PoseFormat::kTum;
  if (absl::EndsWith(path, ".csv")) return PoseFormat::kCsv;
  if (absl::EndsWith(path, ".jsonl")) return PoseFormat::kJsonLines;
  if (absl::EndsWith(path, ".mcap")) return PoseFormat::kMcap;
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": the name of a file of poses ends in .tum, .csv, .jsonl or .mcap"));
}

std::string PoseHeader(PoseFormat format, const PoseFrame& frame) {
  if (format == PoseFormat::kCsv) return CsvHeader(frame);
  if (format != PoseFormat::kTum || frame.is_default()) return "";
  return absl::StrCat("# ", frame.transform(), ", timestamp tx ty tz qx qy qz qw: sensor clock, s; m\n");
}

std::string PoseLine(PoseFormat format, const Pose& camera_pose, const PoseFrame& frame) {
  const Pose pose = frame.Apply(camera_pose);
  switch (format) {
    case PoseFormat::kTum:
      // A reader of TUM takes every line for a pose that is confirmed.
      if (pose.state == TrackState::kAmbiguous) return "";
      return TumLine({pose.t_us, ToCore(pose.camera_from_object)}) + "\n";
    case PoseFormat::kCsv:
      return CsvLine(pose, frame);
    case PoseFormat::kJsonLines:
      return Text(PoseJson(pose, frame)) + "\n";
    case PoseFormat::kMcap:
      break;
  }
  return "";
}

std::string StateJson(const Pose& pose, const PoseFrame& frame) {
  nlohmann::ordered_json json = PoseJson(frame.Apply(pose), frame);
  if (pose.state == TrackState::kAmbiguous) return Text(json);
  for (const char* const name :
       {kTransformKey, "translation_m", "quaternion_xyzw", "twist", "covariance_upper", "alternatives"}) {
    json.erase(name);
  }
  return Text(json);
}

void RecordingArguments::AddTo(CLI::App& app, const std::string& epoch_default) {
  app.add_option("--epoch", epoch,
                 absl::StrCat("With a .mcap file: seconds since 1970 at the sensor time 0, which are added to sensor "
                              "times; host: by the host's time at which the first message arrives. Default: ",
                              epoch_default))
      ->type_name("SECONDS|host")
      ->check(CheckEpoch);
  app.add_option("--event-images", event_cell_px,
                 "With a .mcap file: also write images of the events with the outlines of the objects, 30 per second, "
                 "with cells of 1, 2 or 4 pixels")
      ->type_name("PIXELS")
      ->check(CLI::IsMember({1, 2, 4}));
}

absl::Status RecordingArguments::Check(const std::string& out) const {
  if (absl::EndsWith(out, ".mcap")) return absl::OkStatus();
  if (!epoch.empty()) return UsageError("--epoch: is for an --out whose name ends in .mcap");
  if (event_cell_px != 0) return UsageError("--event-images: is for an --out whose name ends in .mcap");
  return absl::OkStatus();
}

std::optional<int64_t> RecordingArguments::EpochNs(std::optional<int64_t> without_option) const {
  return epoch.empty() ? without_option : ParseEpoch(epoch);
}

absl::Status PoseFiles::Check(const std::string& path, const std::vector<std::string>& object_ids) {
  EVPOSE_ASSIGN_OR_RETURN(const PoseFormat format, PoseFormatFromPath(path));
  if (!absl::StrContains(path, kObjectPlaceholder)) {
    if (object_ids.size() < 2 || format != PoseFormat::kTum) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": such a file holds the poses of one object; put ", kObjectPlaceholder,
        " in its name for one file each, or write .csv, .jsonl or .mcap, which name the object of every pose"));
  }
  for (const std::string& id : object_ids) {
    if (absl::StrContains(id, '/') || absl::StrContains(id, '\0')) {
      return absl::InvalidArgumentError(absl::StrCat(path, ": ", id, " cannot be part of a file's name"));
    }
  }
  return absl::OkStatus();
}

std::string PoseFile::Describe() const {
  if (!keeps_older) return absl::StrCat(path, ": ", Counted(num_poses, "pose"));
  return absl::StrCat(path, ": not written, because there is no pose for it; the earlier file stays as it was");
}

std::map<std::string, std::string> PoseFiles::Paths(const std::string& path,
                                                    const std::vector<std::string>& object_ids) {
  if (!absl::StrContains(path, kObjectPlaceholder)) return {{"", path}};
  std::map<std::string, std::string> paths;
  for (const std::string& id : object_ids) paths[id] = absl::StrReplaceAll(path, {{kObjectPlaceholder, id}});
  return paths;
}

absl::StatusOr<PoseFiles> PoseFiles::Open(const std::string& path, const std::vector<std::string>& object_ids,
                                          const PoseFilesOptions& options) {
  EVPOSE_RETURN_IF_ERROR(Check(path, object_ids));
  PoseFiles files;
  files.frame_ = options.frame;
  EVPOSE_ASSIGN_OR_RETURN(files.format_, PoseFormatFromPath(path));
  for (const auto& [id, name] : Paths(path, object_ids)) {
    std::optional<uint64_t> kept;
    if (options.kept_bytes != nullptr) kept = options.kept_bytes->contains(id) ? options.kept_bytes->at(id) : 0;
    files.written_[id] = {.path = name};
    if (options.kept_poses.contains(id)) files.written_[id].num_poses = options.kept_poses.at(id);
    if (files.format_ == PoseFormat::kMcap) {
      const PoseRecorderOptions recorder = {.object_ids = id.empty() ? object_ids : std::vector<std::string>{id},
                                            .epoch_ns = options.epoch_ns,
                                            .transform = options.frame.transform(),
                                            .world_from_camera = options.frame.world_from_camera()};
      EVPOSE_ASSIGN_OR_RETURN(files.recorders_[id], PoseRecorder::Open(name, recorder, kept));
      continue;
    }
    EVPOSE_ASSIGN_OR_RETURN(OutputFile file, kept ? OutputFile::Continue(name, *kept) : OutputFile::Create(name));
    if (kept.value_or(0) == 0) EVPOSE_RETURN_IF_ERROR(file.Append(PoseHeader(files.format_, files.frame_)));
    files.files_.emplace(id, std::move(file));
  }
  return files;
}

void PoseFiles::Write(const Pose& pose) {
  // Errors are kept: Commit() returns them.
  if (const auto file = FindFile(files_, pose.object_id); file != files_.end()) {
    const std::string line = PoseLine(format_, pose, frame_);
    file->second.Append(line).IgnoreError();
    if (!line.empty()) Count(written_[file->first], pose);
  }
  if (const auto recorder = FindFile(recorders_, pose.object_id); recorder != recorders_.end()) {
    recorder->second->Add(pose, {frame_.Apply(pose), frame_.FrameId(pose.object_id)}, StateJson(pose, frame_));
    Count(written_[recorder->first], pose);
  }
}

void PoseFiles::Count(PoseFile& file, const Pose& pose) {
  ++file.num_poses;
  file.last_t_us = std::max(file.last_t_us, pose.t_us);
}

std::vector<PoseRecorder*> PoseFiles::recorders() const {
  std::vector<PoseRecorder*> recorders;
  for (const auto& [id, recorder] : recorders_) recorders.push_back(recorder.get());
  return recorders;
}

absl::StatusOr<std::map<std::string, uint64_t>> PoseFiles::Sync() {
  std::map<std::string, uint64_t> sizes;
  for (auto& [id, file] : files_) {
    EVPOSE_ASSIGN_OR_RETURN(sizes[id], file.Sync());
  }
  for (auto& [id, recorder] : recorders_) {
    EVPOSE_ASSIGN_OR_RETURN(sizes[id], recorder->Sync());
  }
  return sizes;
}

std::map<std::string, uint64_t> PoseFiles::num_poses() const {
  std::map<std::string, uint64_t> numbers;
  for (const auto& [id, file] : written_) numbers[id] = file.num_poses;
  return numbers;
}

absl::Status PoseFiles::Commit() {
  for (auto& [id, written] : written_) {
    written.keeps_older = written.num_poses == 0 && HasContents(written.path);
    const auto complete = [&keeps_older = written.keeps_older](auto& file) {
      if (!keeps_older) return file.Commit();
      file.Remove();
      return absl::OkStatus();
    };
    if (const auto file = files_.find(id); file != files_.end()) EVPOSE_RETURN_IF_ERROR(complete(file->second));
    if (const auto recorder = recorders_.find(id); recorder != recorders_.end()) {
      EVPOSE_RETURN_IF_ERROR(complete(*recorder->second));
    }
  }
  return absl::OkStatus();
}

std::vector<PoseFile> PoseFiles::files() const {
  std::vector<PoseFile> files;
  for (const auto& [id, file] : written_) files.push_back(file);
  return files;
}

PoseFrame PoseFrame::ObjectFromCamera() {
  PoseFrame frame;
  frame.kind_ = Kind::kObject;
  frame.transform_ = kObjectFromCamera;
  return frame;
}

PoseFrame PoseFrame::WorldFromObject(const RigidTransform& world_from_camera, const std::string& name) {
  PoseFrame frame;
  frame.kind_ = Kind::kWorld;
  frame.world_ = name;
  frame.world_from_camera_ = world_from_camera;
  frame.transform_ = absl::StrCat(name, "_from_object");
  return frame;
}

PoseFrame PoseFrame::ToCamera() const {
  // The inverse of an inverse is the pose itself, with its covariance and twist.
  return kind_ == Kind::kWorld ? WorldFromObject(world_from_camera_.Inverse(), "camera") : *this;
}

std::string PoseFrame::name() const {
  if (kind_ == Kind::kWorld) return world_;
  return kind_ == Kind::kObject ? "object" : "camera";
}

std::string PoseFrame::FrameId(const std::string& object_id) const {
  if (kind_ == Kind::kCamera) return kCameraFrame;
  return kind_ == Kind::kWorld ? world_ : object_id;
}

std::optional<std::pair<std::string, Transform>> PoseFrame::world_from_camera() const {
  if (kind_ != Kind::kWorld) return std::nullopt;
  return std::pair(world_, FromCore(world_from_camera_));
}

std::string PoseFrame::Description() const {
  if (kind_ != Kind::kWorld) return transform_;
  return TransformToYaml(world_from_camera_, transform_, "camera", "");
}

RigidTransform PoseFrame::Transformed(const RigidTransform& camera_from_object) const {
  if (kind_ == Kind::kObject) return camera_from_object.Inverse();
  return world_from_camera_ * camera_from_object;
}

Pose PoseFrame::Apply(const Pose& pose) const {
  if (is_default()) return pose;
  const RigidTransform camera_from_object = ToCore(pose.camera_from_object);
  const Matrix6d jacobian =
      kind_ == Kind::kObject ? JacobianOfInverse(camera_from_object) : JacobianOfProduct(world_from_camera_.rotation);
  Pose result = pose;
  result.camera_from_object = FromCore(Transformed(camera_from_object));
  result.covariance = jacobian * pose.covariance * jacobian.transpose();
  result.covariance = (0.5 * (result.covariance + result.covariance.transpose())).eval();  // symmetric to the bit
  result.twist = jacobian * pose.twist;
  for (PoseAlternative& alternative : result.alternatives) {
    alternative.camera_from_object = FromCore(Transformed(ToCore(alternative.camera_from_object)));
  }
  return result;
}

std::vector<Pose> PoseFrame::Apply(absl::Span<const Pose> poses) const {
  std::vector<Pose> result;
  for (const Pose& pose : poses) result.push_back(Apply(pose));
  return result;
}

void PoseFrameArguments::AddTo(CLI::App& app, const std::string& verb) {
  CLI::Option* const world =
      AddFile(
          app, "--world-from-camera", world_from_camera,
          absl::StrCat(kWorldFromCameraHelp, ", in metres. Poses, covariances and twists are ", verb, " in that frame"))
          ->group(kOutputGroup);
  AddOption(app, "--pose", pose,
            absl::StrCat("Transform that is ", verb,
                         ". object-from-camera is the pose of a moving camera in the frame of an object at rest"),
            CLI::IsMember({"camera-from-object", "object-from-camera"}))
      ->excludes(world)
      ->group(kOutputGroup);
}

void PoseFrameArguments::AddForReading(CLI::App& app) {
  AddFile(app, "--world-from-camera", world_from_camera,
          absl::StrCat("For files of poses that were written with this option: ", kWorldFromCameraHelp));
}

absl::StatusOr<PoseFrame> PoseFrameArguments::Read(std::ostream& err) const {
  if (pose == "object-from-camera") return PoseFrame::ObjectFromCamera();
  if (world_from_camera.empty()) return PoseFrame();
  EVPOSE_ASSIGN_OR_RETURN(const NamedTransform world, ReadTransformFile(world_from_camera));
  const std::string name = world.target.empty() ? "world" : world.target;
  const double distance_m = world.target_from_source.translation_m.norm();
  if (distance_m > kFarFromWorldM) {
    err << absl::StrFormat("evpose: %s: the camera is %.4g m from the origin of %s: translations are in metres\n",
                           world_from_camera, distance_m, name);
  }
  if (name != "camera" && name != kCameraFrame) return PoseFrame::WorldFromObject(world.target_from_source, name);
  return absl::InvalidArgumentError(
      absl::StrCat(world_from_camera, ": frame_id: ", name,
                   " is the name of the camera's own frame: give the pose of the camera in the frame of the world or "
                   "the robot, and the name of that frame"));
}

}  // namespace evpose::client
