// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_readers.h"

namespace evpose {
namespace {

// "cam0", "cam1", ...
std::vector<std::string> CameraNames(const CameraFields& root) {
  std::vector<std::string> names = root.Keys();
  std::erase_if(names, [&root](const std::string& name) {
    return !absl::StartsWith(name, "cam") || name.size() < 4 ||
           !std::all_of(name.begin() + 3, name.end(), [](char c) { return absl::ascii_isdigit(c); }) ||
           !root.IsMap(name);
  });
  return names;
}

absl::Status TakeIntrinsics(const CameraFields& fields, CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string model, fields.Word("camera_model"));
  if (model.empty()) return fields.Error("camera_model", "is missing; pinhole is read");
  if (model != "pinhole") {
    return fields.Error(
        "camera_model",
        absl::StrCat(Quoted(model), " is not supported; calibrate with pinhole-radtan or pinhole-equi"));
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> intrinsics, fields.Numbers("intrinsics"));
  if (intrinsics.size() != 4) {
    return fields.Error("intrinsics",
                        absl::StrCat("has ", intrinsics.size(), " numbers, but pinhole has 4 (fu, fv, pu, pv)"));
  }
  camera.fx_px = intrinsics[0];
  camera.fy_px = intrinsics[1];
  camera.cx_px = intrinsics[2];
  camera.cy_px = intrinsics[3];
  return absl::OkStatus();
}

absl::Status TakeKalibrDistortion(const CameraFields& fields, CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string model, fields.Word("distortion_model"));
  std::vector<double> coefficients;
  if (model != "none" || fields.Has("distortion_coeffs")) {
    EVPOSE_ASSIGN_OR_RETURN(coefficients, fields.Numbers("distortion_coeffs"));
  }
  if (model == "none") {
    if (std::all_of(coefficients.begin(), coefficients.end(), [](double k) { return k == 0.0; }))
      return absl::OkStatus();
    return fields.Error("distortion_model", "is none, but distortion_coeffs are not 0; set it to radtan");
  }
  if (model != "radtan" && model != "equidistant") {
    return fields.Error("distortion_model",
                        model.empty()
                            ? std::string("is missing; give radtan, equidistant or none")
                            : absl::StrCat(Quoted(model), " is not supported; use radtan, equidistant or none"));
  }
  if (coefficients.size() != 4) {
    return fields.Error("distortion_coeffs",
                        absl::StrCat("has ", coefficients.size(), " numbers, but ", model, " has 4"));
  }
  camera.lens_model = model == "radtan" ? LensModel::kBrown : LensModel::kFisheye;
  return TakeDistortion(fields, "distortion_coeffs", coefficients, camera);
}

}  // namespace

bool IsKalibr(const CameraFields& root) { return !CameraNames(root).empty(); }

absl::StatusOr<CameraFile> ReadKalibr(const CameraFields& root, const std::string& file, const std::string& selection) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string name, SelectCamera(CameraNames(root), file, selection));
  CameraFile result = {.format = "kalibr", .description = absl::StrCat(Escaped(name), " of Kalibr's camchain")};
  const CameraFields fields = root.Child(name);
  EVPOSE_RETURN_IF_ERROR(TakeIntrinsics(fields, result.camera));
  EVPOSE_RETURN_IF_ERROR(TakeKalibrDistortion(fields, result.camera));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> size, fields.Numbers("resolution"));
  EVPOSE_RETURN_IF_ERROR(TakeImageSize(fields, "resolution", size, result.camera));
  return result;
}

}  // namespace evpose
