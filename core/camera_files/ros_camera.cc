// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_readers.h"

namespace evpose {
namespace {

// Names of common_msgs, sensor_msgs/distortion_models.h, and those by which other tools call the same models.
constexpr std::pair<const char*, LensModel> kRosModels[] = {{"plumb_bob", LensModel::kBrown},
                                                            {"radtan", LensModel::kBrown},
                                                            {"rational_polynomial", LensModel::kRational},
                                                            {"equidistant", LensModel::kFisheye},
                                                            {"fisheye", LensModel::kFisheye},
                                                            {"kannala_brandt", LensModel::kFisheye}};

// Takes the coefficients at `key` for the model that `distortion_model` names.
absl::Status TakeRosDistortion(const CameraFields& root, const std::string& key,
                               const std::vector<double>& coefficients, CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string name, root.Word("distortion_model"));
  const bool is_zero = std::all_of(coefficients.begin(), coefficients.end(), [](double k) { return k == 0.0; });
  if (name == "none" || (name.empty() && is_zero)) {
    if (is_zero) return absl::OkStatus();
    return root.Error("distortion_model", absl::StrCat("is none, but ", key, " are not 0; set it to plumb_bob"));
  }
  if (name.empty()) {
    if (coefficients.size() == 4 || coefficients.size() == 5) return TakeDistortion(root, key, coefficients, camera);
    return root.Error("distortion_model",
                      absl::StrCat("is missing, and ", key, " has ", coefficients.size(),
                                   " numbers; give plumb_bob (4 or 5), rational_polynomial (8) or equidistant (4)"));
  }
  const auto* const found = std::find_if(std::begin(kRosModels), std::end(kRosModels),
                                         [&name](const auto& each) { return name == each.first; });
  if (found == std::end(kRosModels)) {
    return root.Error(
        "distortion_model",
        absl::StrCat(Quoted(name), " is not supported; use plumb_bob, rational_polynomial, equidistant or ",
                     "none: calibrate anew with that model, or undistort the recording"));
  }
  camera.lens_model = found->second;
  return TakeDistortion(root, key, coefficients, camera);
}

// A message is that of one image: with binning or a region of interest it is not the calibration of the recording.
absl::Status CheckWholeImage(const CameraFields& root, const CameraModel& camera) {
  for (const char* key : {"binning_x", "binning_y"}) {
    if (!root.Has(key)) continue;
    EVPOSE_ASSIGN_OR_RETURN(const int binning, root.WholeNumber(key));
    if (binning > 1) {
      return root.Error(
          key, absl::StrCat("is ", binning, "; a calibration of the whole sensor, without binning, is needed"));
    }
  }
  if (!root.Has("roi")) return absl::OkStatus();
  if (!root.IsMap("roi")) return root.Error("roi", "is not a map");
  const CameraFields roi = root.Child("roi");
  const std::pair<const char*, int> whole[] = {
      {"x_offset", 0}, {"y_offset", 0}, {"width", camera.width_px}, {"height", camera.height_px}};
  for (const auto& [key, full] : whole) {
    if (!roi.Has(key)) continue;
    EVPOSE_ASSIGN_OR_RETURN(const int value, roi.WholeNumber(key));
    if (value == 0 || value == full) continue;
    return roi.Error(key, absl::StrCat("is ", value, "; the region must be the whole image, ", camera.width_px, "x",
                                       camera.height_px, ", or 0"));
  }
  return absl::OkStatus();
}

}  // namespace

bool IsRosMessage(const CameraFields& root) {
  return (root.Has("K") || root.Has("k") || root.Has("D") || root.Has("d")) &&
         (root.Has("width") || root.Has("height")) && !root.Has("camera_matrix") && !root.IsMap("K");
}

absl::StatusOr<CameraFile> ReadRosMessage(const CameraFields& root) {
  CameraFile file = {.format = "ros-message", .description = "the printed message of ROS"};
  CameraModel& camera = file.camera;
  EVPOSE_ASSIGN_OR_RETURN(camera.width_px, root.WholeNumber("width"));
  EVPOSE_ASSIGN_OR_RETURN(camera.height_px, root.WholeNumber("height"));
  EVPOSE_ASSIGN_OR_RETURN(const std::string matrix_key, root.OneOf({"k", "K"}));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> matrix, root.Numbers(matrix_key));
  EVPOSE_RETURN_IF_ERROR(TakeCameraMatrix(root, matrix_key, matrix, camera));
  EVPOSE_ASSIGN_OR_RETURN(const std::string distortion_key, root.OneOf({"d", "D"}));
  std::vector<double> coefficients;
  EVPOSE_ASSIGN_OR_RETURN(const std::string model, root.Word("distortion_model"));
  if (root.Has(distortion_key) || (!model.empty() && model != "none")) {
    EVPOSE_ASSIGN_OR_RETURN(coefficients, root.Numbers(distortion_key));
  }
  EVPOSE_RETURN_IF_ERROR(TakeRosDistortion(root, distortion_key, coefficients, camera));
  EVPOSE_RETURN_IF_ERROR(CheckWholeImage(root, camera));
  return file;
}

absl::StatusOr<CameraFile> ReadRosCameraInfo(const CameraFields& root) {
  CameraFile file = {.format = "ros", .description = "ROS camera_info"};
  CameraModel& camera = file.camera;
  EVPOSE_ASSIGN_OR_RETURN(camera.width_px, root.WholeNumber("image_width"));
  EVPOSE_ASSIGN_OR_RETURN(camera.height_px, root.WholeNumber("image_height"));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> matrix, root.Matrix("camera_matrix"));
  EVPOSE_RETURN_IF_ERROR(TakeCameraMatrix(root, "camera_matrix", matrix, camera));
  std::vector<double> coefficients;
  EVPOSE_ASSIGN_OR_RETURN(const std::string model, root.Word("distortion_model"));
  if (root.Has("distortion_coefficients") || (!model.empty() && model != "none")) {
    EVPOSE_ASSIGN_OR_RETURN(coefficients, root.Matrix("distortion_coefficients"));
  }
  EVPOSE_RETURN_IF_ERROR(TakeRosDistortion(root, "distortion_coefficients", coefficients, camera));
  return file;
}

}  // namespace evpose
