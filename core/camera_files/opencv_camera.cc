// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_readers.h"

namespace evpose {
namespace {

// The names of OpenCV's calibration programs since 2.4, and those of other programs that write FileStorage.
const std::vector<std::string>& MatrixKeys() {
  static const auto& keys =
      *new std::vector<std::string>{"camera_matrix", "Camera_Matrix", "cameraMatrix", "camera_Matrix", "K"};
  return keys;
}
const std::vector<std::string>& DistortionKeys() {
  static const auto& keys = *new std::vector<std::string>{"distortion_coefficients", "Distortion_Coefficients",
                                                          "distCoeffs", "distortion_Coefficients", "D"};
  return keys;
}

bool HasMatrix(const CameraFields& fields) {
  return std::any_of(MatrixKeys().begin(), MatrixKeys().end(),
                     [&fields](const std::string& key) { return fields.IsMap(key); });
}

// The nodes of a DV file, each a camera; empty for other files.
std::vector<std::string> DvCameras(const CameraFields& root) {
  std::vector<std::string> names = root.Keys();
  std::erase_if(names, [&root](const std::string& name) { return !root.IsMap(name) || !HasMatrix(root.Child(name)); });
  return names;
}

bool IsMetavision(const CameraFields& root) { return root.Has("image_size") && HasMatrix(root); }

absl::Status TakeSize(const CameraFields& fields, CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string width,
                          fields.OneOf({"image_width", "image_Width", "width", "Camera.width"}));
  EVPOSE_ASSIGN_OR_RETURN(const std::string height,
                          fields.OneOf({"image_height", "image_Height", "height", "Camera.height"}));
  EVPOSE_ASSIGN_OR_RETURN(camera.width_px, fields.WholeNumber(width));
  EVPOSE_ASSIGN_OR_RETURN(camera.height_px, fields.WholeNumber(height));
  return absl::OkStatus();
}

// Whether the file says that the lens is a fisheye lens: by a flag (OpenCV's fisheye_model, DV's use_fisheye_model), or
// by the name of the model (DV). Error if they contradict each other.
absl::StatusOr<bool> IsFisheye(const CameraFields& fields) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string flag, fields.OneOf({"fisheye_model", "use_fisheye_model"}));
  EVPOSE_ASSIGN_OR_RETURN(const bool is_fisheye, fields.Flag(flag));
  EVPOSE_ASSIGN_OR_RETURN(std::string model, fields.Word("distortion_model"));
  absl::AsciiStrToLower(&model);
  if (model.empty()) return is_fisheye;
  const bool is_named_fisheye = absl::StrContains(model, "equidistant") || absl::StrContains(model, "fisheye");
  const bool is_named_brown = absl::StrContains(model, "rad") || absl::StrContains(model, "plumb") || model == "none";
  if (!is_named_fisheye && !is_named_brown) {
    return fields.Error("distortion_model",
                        absl::StrCat(Quoted(model), " is not supported; radial-tangential and equidistant are read"));
  }
  if (fields.Has(flag) && is_fisheye != is_named_fisheye) {
    return fields.Error("distortion_model", absl::StrCat(Quoted(model), " contradicts ", flag));
  }
  return is_named_fisheye;
}

absl::Status TakeMatrices(const CameraFields& fields, bool is_fisheye, CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string matrix_key, fields.OneOf(MatrixKeys()));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> matrix, fields.Matrix(matrix_key));
  EVPOSE_RETURN_IF_ERROR(TakeCameraMatrix(fields, matrix_key, matrix, camera));
  EVPOSE_ASSIGN_OR_RETURN(const std::string distortion_key, fields.OneOf(DistortionKeys()));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> coefficients, fields.Matrix(distortion_key));
  camera.lens_model = is_fisheye                ? LensModel::kFisheye
                      : coefficients.size() > 5 ? LensModel::kRational
                                                : LensModel::kBrown;
  if (coefficients.empty() && !is_fisheye) return absl::OkStatus();
  return TakeDistortion(fields, distortion_key, coefficients, camera);
}

// ", RMS 0.21 px", if the file has it.
std::string RmsOf(const CameraFields& fields) {
  for (const char* key :
       {"overall_rms_reprojection_error", "avg_reprojection_error", "Avg_Reprojection_Error", "calibration_error"}) {
    const absl::StatusOr<double> rms = fields.Number(key);
    if (rms.ok()) return absl::StrFormat(", RMS %.3g px", *rms);
  }
  return "";
}

absl::StatusOr<CameraFile> ReadMetavision(const CameraFields& root) {
  CameraFile file = {.format = "metavision", .description = absl::StrCat("Metavision intrinsics", RmsOf(root))};
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> size, root.Numbers("image_size"));
  EVPOSE_RETURN_IF_ERROR(TakeImageSize(root, "image_size", size, file.camera));
  EVPOSE_ASSIGN_OR_RETURN(const std::string key, root.OneOf(DistortionKeys()));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> coefficients, root.Matrix(key));
  if (coefficients.size() != 4 && coefficients.size() != 5) {
    return root.Error(key,
                      absl::StrFormat("has %d numbers; Metavision's calibration writes 5 for its pinhole model and "
                                      "4 for --fisheye",
                                      coefficients.size()));
  }
  // The file does not name the model: its pinhole calibration writes 5 coefficients, cv::fisheye::calibrate 4.
  EVPOSE_RETURN_IF_ERROR(TakeMatrices(root, coefficients.size() == 4, file.camera));
  return file;
}

// ORB-SLAM's settings: single numbers, without a matrix.
absl::StatusOr<CameraFile> ReadSettings(const CameraFields& root) {
  CameraFile file = {.format = "opencv", .description = "settings of ORB-SLAM"};
  CameraModel& camera = file.camera;
  EVPOSE_RETURN_IF_ERROR(TakeSize(root, camera));
  EVPOSE_ASSIGN_OR_RETURN(camera.fx_px, root.Number("Camera.fx"));
  EVPOSE_ASSIGN_OR_RETURN(camera.fy_px, root.Number("Camera.fy"));
  EVPOSE_ASSIGN_OR_RETURN(camera.cx_px, root.Number("Camera.cx"));
  EVPOSE_ASSIGN_OR_RETURN(camera.cy_px, root.Number("Camera.cy"));
  EVPOSE_ASSIGN_OR_RETURN(const std::string type, root.Word("Camera.type"));
  if (!type.empty() && type != "PinHole" && type != "KannalaBrandt8") {
    return root.Error("Camera.type", absl::StrCat(Quoted(type), " is not supported; use PinHole or KannalaBrandt8"));
  }
  const bool is_fisheye = type == "KannalaBrandt8";
  if (is_fisheye) camera.lens_model = LensModel::kFisheye;
  const std::vector<std::string> names = is_fisheye ? std::vector<std::string>{"k1", "k2", "k3", "k4"}
                                                    : std::vector<std::string>{"k1", "k2", "p1", "p2", "k3"};
  for (size_t i = 0; i < names.size(); ++i) {
    const std::string key = absl::StrCat("Camera.", names[i]);
    if (names[i] == "k3" && !is_fisheye && !root.Has(key)) continue;
    EVPOSE_ASSIGN_OR_RETURN(camera.distortion[i], root.Number(key));
  }
  return file;
}

}  // namespace

bool IsOpenCv(const CameraTree& tree, const CameraFields& root) {
  if (tree.syntax != CameraSyntax::kYaml || root.Has("Camera.fx") || IsMetavision(root) || !DvCameras(root).empty()) {
    return true;
  }
  return std::any_of(MatrixKeys().begin(), MatrixKeys().end(), [&root](const std::string& key) {
    return root.IsMap(key) && (key != "camera_matrix" || root.Child(key).Has("dt"));
  });
}

absl::StatusOr<CameraFile> ReadOpenCv(const CameraTree& tree, const CameraFields& root, const std::string& file,
                                      const std::string& selection) {
  const std::vector<std::string> cameras = HasMatrix(root) ? std::vector<std::string>() : DvCameras(root);
  if (cameras.empty()) EVPOSE_RETURN_IF_ERROR(CheckNotSelected(file, selection));
  if (IsMetavision(root)) return ReadMetavision(root);
  if (root.Has("Camera.fx")) return ReadSettings(root);
  const char* const syntax = tree.syntax == CameraSyntax::kXml    ? "XML"
                             : tree.syntax == CameraSyntax::kJson ? "JSON"
                                                                  : "YAML";
  CameraFile result = {.format = "opencv",
                       .description = absl::StrCat("OpenCV FileStorage (", syntax, ")", RmsOf(root))};
  std::string name;
  if (!cameras.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(name, SelectCamera(cameras, file, selection));
    result.format = "dv";
    result.description = absl::StrCat("camera ", Escaped(name), " of a DV calibration");
  }
  const CameraFields fields = name.empty() ? root : root.Child(name);
  EVPOSE_RETURN_IF_ERROR(TakeSize(fields, result.camera));
  // In a DV file the flag is beside the node of the camera.
  const bool has_model = fields.Has("use_fisheye_model") || fields.Has("distortion_model");
  EVPOSE_ASSIGN_OR_RETURN(const bool is_fisheye, IsFisheye(has_model ? fields : root));
  EVPOSE_RETURN_IF_ERROR(TakeMatrices(fields, is_fisheye, result.camera));
  return result;
}

}  // namespace evpose
