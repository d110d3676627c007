// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/calibrate_hand_eye.h"

#include <cmath>
#include <ostream>
#include <string>
#include <vector>

#include "absl/algorithm/container.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/string_view.h"
#include "client/cli/common/pose_reader.h"
#include "client/cli/common/pose_records.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/calibration/hand_eye.h"
#include "core/geometry/trajectory.h"
#include "core/geometry/transform_file.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

constexpr char kHandEyeGroup[] = "Camera on a robot or beside it";
// The other options of the command apply to recordings.
constexpr absl::string_view kSharedOptions[] = {"--help", "--out", "--json"};

// The pose of the camera in the frame in which it is at rest: that of the base of a robot beside it, or of the tool
// that carries it.
struct MountedCamera {
  std::string frame;
  RigidTransform frame_from_camera;
  Vector6d errors;
};

MountedCamera CameraOf(const HandEye& result) {
  MountedCamera camera;
  camera.frame = result.mount == HandEyeMount::kInHand ? "tool" : "base";
  camera.frame_from_camera = result.left.Inverse();
  if (result.left_errors.allFinite()) {
    const Matrix6d jacobian = JacobianOfInverse(result.left);
    camera.errors = (jacobian * result.left_covariance * jacobian.transpose()).diagonal().cwiseSqrt();
  } else {
    camera.errors = Vector6d::Constant(result.left_errors.maxCoeff());
  }
  return camera;
}

// Returns null for a number that the poses do not determine, because JSON has no infinity.
Json NumberJson(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json TransformWithErrorsJson(const RigidTransform& transform, const Vector6d& errors) {
  Json json = TransformJson(transform);
  for (int i = 0; i < 3; ++i) {
    json["translation_errors_m"].push_back(NumberJson(errors(i)));
    json["rotation_errors_rad"].push_back(NumberJson(errors(3 + i)));
  }
  return json;
}

Json HandEyeJson(const HandEye& result) {
  const MountedCamera camera = CameraOf(result);
  const std::string object = result.mount == HandEyeMount::kInHand ? "base_from_object" : "tool_from_object";
  return {{"mount", HandEyeMountName(result.mount)},
          {"other_mount_residual_ratio", result.other_mount_ratio ? Json(*result.other_mount_ratio) : Json(nullptr)},
          {camera.frame + "_from_camera", TransformWithErrorsJson(camera.frame_from_camera, camera.errors)},
          {object, TransformWithErrorsJson(result.right, result.right_errors)},
          {"time_offset_s", result.time_offset_s},
          {"time_offset_error_s", result.time_offset_error_s ? NumberJson(*result.time_offset_error_s) : Json(nullptr)},
          {"position_rms_m", result.position_rms_m},
          {"rotation_rms_rad", result.rotation_rms_rad},
          {"poses", result.num_poses},
          {"outliers", result.num_outliers},
          {"correlated_poses", result.correlated_poses},
          {"orientation_spread_rad", result.axes_rad},
          {"warnings", result.warnings}};
}

void PrintTransform(const std::string& name, const RigidTransform& transform, const Vector6d& e, std::ostream& out) {
  const Eigen::Vector3d t_mm = 1e3 * transform.translation_m;
  const Eigen::Vector3d r_deg = kDegreesPerRadian * LogSo3(transform.rotation);
  out << absl::StrFormat("%s\n  translation   %10.2f %10.2f %10.2f mm  +- %.2f %.2f %.2f\n", name, t_mm.x(), t_mm.y(),
                         t_mm.z(), 1e3 * e(0), 1e3 * e(1), 1e3 * e(2))
      << absl::StrFormat("  rotation vec. %10.3f %10.3f %10.3f deg +- %.3f %.3f %.3f\n", r_deg.x(), r_deg.y(),
                         r_deg.z(), kDegreesPerRadian * e(3), kDegreesPerRadian * e(4), kDegreesPerRadian * e(5));
}

void PrintHandEye(const HandEye& result, std::ostream& out) {
  const MountedCamera camera = CameraOf(result);
  const bool is_in_hand = result.mount == HandEyeMount::kInHand;
  out << (is_in_hand ? "the camera moves with the tool, the object is at rest"
                     : "the camera stands beside the robot, the object moves with the tool");
  if (result.other_mount_ratio) {
    out << absl::StrFormat(" (the other way, residuals are %.3g times as large)", *result.other_mount_ratio);
  }
  out << "\n";
  PrintTransform(camera.frame + "_from_camera", camera.frame_from_camera, camera.errors, out);
  PrintTransform(is_in_hand ? "base_from_object" : "tool_from_object", result.right, result.right_errors, out);
  out << absl::StrFormat("clock of the robot - clock of the sensor %.6f s", result.time_offset_s);
  if (result.time_offset_error_s) out << absl::StrFormat(" +- %.0f us", 1e6 * *result.time_offset_error_s);
  out << absl::StrFormat(
             "\nresiduals, rms: %.3f mm, %.3f deg; %d poses, %d outliers; %.0f successive poses count as one\n",
             1e3 * result.position_rms_m, kDegreesPerRadian * result.rotation_rms_rad, result.num_poses,
             result.num_outliers, result.correlated_poses)
      << absl::StrFormat("orientations spread by %.1f, %.1f and %.1f deg about three axes\n",
                         kDegreesPerRadian * result.axes_rad[0], kDegreesPerRadian * result.axes_rad[1],
                         kDegreesPerRadian * result.axes_rad[2]);
}

std::string MountYaml(const HandEye& result, const std::string& poses, const std::string& reference) {
  const MountedCamera camera = CameraOf(result);
  const Vector6d& e = camera.errors;
  const std::string comment = absl::StrFormat(
      "%s_from_camera by evpose calibrate --hand-eye, from %s and %s; metres, quaternion x y z w\n"
      "standard errors: %.3g %.3g %.3g m, %.3g %.3g %.3g rad\n"
      "clock of the robot - clock of the sensor: %.6f s",
      camera.frame, poses, reference, e(0), e(1), e(2), e(3), e(4), e(5), result.time_offset_s);
  return TransformToYaml(camera.frame_from_camera, camera.frame, "camera", comment);
}

}  // namespace

Json TransformJson(const RigidTransform& transform) {
  const Eigen::Vector3d& t = transform.translation_m;
  const Eigen::Quaterniond q = transform.Quaternion();
  return {{"translation_m", {t.x(), t.y(), t.z()}}, {"quaternion_xyzw", {q.x(), q.y(), q.z(), q.w()}}};
}

absl::StatusOr<std::optional<double>> ParseTimeOffset(const std::string& text) {
  if (text == "auto") return std::nullopt;
  double seconds = 0.0;
  if (absl::SimpleAtod(text, &seconds) && std::abs(seconds) <= 4e9) return seconds;
  return UsageError(absl::StrCat("--time-offset: \"", text, "\" is neither auto nor a number of seconds"));
}

void HandEyeArguments::AddTo(CLI::App& app) {
  const std::vector<CLI::Option*> of_recordings = app.get_options([](const CLI::Option* option) {
    return !option->get_positional() && !absl::c_linear_search(kSharedOptions, option->get_name());
  });
  app.option_defaults()->group(kHandEyeGroup);
  CLI::Option* const hand_eye = AddFile(
      app, "--hand-eye", reference,
      "Poses base_from_tool of a robot on its own clock, TUM. The argument is then a file of evpose's poses, TUM "
      "or CSV, and --out the file for --world-from-camera");
  AddOption(
      app, "--mount", mount,
      "in-hand: the camera moves with the tool, and the object is at rest. beside: the camera is at rest, and the "
      "object moves with the tool. auto: that with the smaller residuals",
      CLI::IsMember({"auto", "in-hand", "beside"}))
      ->needs(hand_eye);
  app.add_option("--time-offset", time_offset, "Clock of the robot minus that of the sensor; auto: estimated")
      ->type_name("auto|SECONDS")
      ->capture_default_str()
      ->needs(hand_eye);
  for (CLI::Option* const option : of_recordings) hand_eye->excludes(option);
}

absl::Status RunHandEye(const HandEyeArguments& arguments, const std::string& poses, const std::string& out,
                        bool is_json, CliContext& context) {
  HandEyeOptions options;
  for (const auto& [mount, name] : kHandEyeMountNames) {
    if (arguments.mount == name) options.mount = mount;
  }
  EVPOSE_ASSIGN_OR_RETURN(options.time_offset_s, ParseTimeOffset(arguments.time_offset));
  EVPOSE_ASSIGN_OR_RETURN(const ReadPoses estimate, ReadCameraPoses(poses));
  EVPOSE_RETURN_IF_ERROR(RefuseMcap(arguments.reference, ".tum"));
  EVPOSE_ASSIGN_OR_RETURN(const Trajectory robot, ReadTumTrajectory(arguments.reference));
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(out));
  const absl::StatusOr<HandEye> result = SolveHandEye(estimate.trajectory, robot, options);
  if (!result.ok()) {
    return absl::Status(result.status().code(),
                        absl::StrCat(poses, " and ", arguments.reference, ": ", result.status().message()));
  }
  if (!result->has_second_axis || !result->explains_motion) {
    return absl::FailedPreconditionError(absl::StrCat(poses, " and ", arguments.reference, ": ",
                                                      absl::StrJoin(result->warnings, "; "), "; nothing was written"));
  }
  EVPOSE_RETURN_IF_ERROR(file.Append(MountYaml(*result, poses, arguments.reference)));
  EVPOSE_RETURN_IF_ERROR(file.Commit());
  for (const std::string& warning : result->warnings) context.err << "evpose calibrate: warning: " << warning << "\n";
  return PrintResult(context, is_json, HandEyeJson(*result), [&](std::ostream& stream) {
    PrintHandEye(*result, stream);
    stream << "written: " << out << "\n";
  });
}

}  // namespace evpose::client
