// SPDX-License-Identifier: Apache-2.0
#include <string>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/types/span.h"
#include "core/camera_files/camera_file.h"

namespace evpose {
namespace {

// 17 significant digits determine a double.
std::string Number(double value) { return absl::StrFormat("%.17g", value); }

std::string List(absl::Span<const double> values) {
  return absl::StrJoin(values, ", ", [](std::string* out, double value) { absl::StrAppend(out, Number(value)); });
}

// The camera matrix, row by row.
std::string MatrixOf(const CameraModel& camera) {
  return absl::StrJoin({Number(camera.fx_px), std::string("0"), Number(camera.cx_px), std::string("0"),
                        Number(camera.fy_px), Number(camera.cy_px), std::string("0, 0, 1")},
                       ", ");
}

const char* RosName(LensModel model) {
  return model == LensModel::kBrown      ? "plumb_bob"
         : model == LensModel::kRational ? "rational_polynomial"
                                         : "equidistant";
}

absl::StatusOr<std::string> ToKalibr(const CameraModel& camera) {
  if (camera.lens_model == LensModel::kRational) {
    return absl::InvalidArgumentError("Kalibr's files have no rational lens; ros and opencv do");
  }
  if (camera.lens_model == LensModel::kBrown && camera.distortion[4] != 0.0) {
    return absl::InvalidArgumentError("Kalibr's radtan has no k3, which is not 0 here; ros and opencv do");
  }
  return absl::StrFormat(
      "cam0:\n"
      "  camera_model: pinhole\n"
      "  intrinsics: [%s]\n"
      "  distortion_model: %s\n"
      "  distortion_coeffs: [%s]\n"
      "  resolution: [%d, %d]\n"
      "  rostopic: /cam0/image_raw\n",
      List({camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px}),
      camera.lens_model == LensModel::kBrown ? "radtan" : "equidistant", List(camera.Coefficients().first(4)),
      camera.width_px, camera.height_px);
}

std::string JsonMatrix(int rows, int cols, const std::string& data) {
  return absl::StrFormat(
      "{\n        \"type_id\": \"opencv-matrix\",\n        \"rows\": %d,\n        \"cols\": %d,\n        \"dt\": "
      "\"d\",\n"
      "        \"data\": [ %s ]\n    }",
      rows, cols, data);
}

absl::StatusOr<std::string> ToMetavision(const CameraModel& camera) {
  if (camera.lens_model == LensModel::kRational) {
    return absl::InvalidArgumentError("Metavision's files have no rational lens; ros and opencv do");
  }
  const int count = NumCoefficients(camera.lens_model);
  return absl::StrFormat(
      "{\n    \"image_size\": [ %d, %d ],\n    \"camera_matrix\": %s,\n    \"distortion_coefficients\": %s\n}\n",
      camera.width_px, camera.height_px, JsonMatrix(3, 3, MatrixOf(camera)),
      JsonMatrix(camera.lens_model == LensModel::kBrown ? 1 : count, camera.lens_model == LensModel::kBrown ? count : 1,
                 List(camera.Coefficients())));
}

std::string ToOpenCv(const CameraModel& camera) {
  const auto matrix = [](const char* name, int rows, int cols, const std::string& data) {
    return absl::StrFormat("%s: !!opencv-matrix\n   rows: %d\n   cols: %d\n   dt: d\n   data: [ %s ]\n", name, rows,
                           cols, data);
  };
  return absl::StrFormat(
      "%%YAML:1.0\n---\nimage_width: %d\nimage_height: %d\n%s%sfisheye_model: %d\n", camera.width_px, camera.height_px,
      matrix("camera_matrix", 3, 3, MatrixOf(camera)),
      matrix("distortion_coefficients", NumCoefficients(camera.lens_model), 1, List(camera.Coefficients())),
      camera.lens_model == LensModel::kFisheye ? 1 : 0);
}

}  // namespace

absl::StatusOr<std::string> FormatCamera(const CameraModel& camera, CameraFormat format) {
  switch (format) {
    case CameraFormat::kRos:
      return CameraModelToYaml(camera);
    case CameraFormat::kKalibr:
      return ToKalibr(camera);
    case CameraFormat::kMetavision:
      return ToMetavision(camera);
    case CameraFormat::kOpenCv:
      return ToOpenCv(camera);
  }
  return absl::InvalidArgumentError("an unknown format of camera files");
}

// Writes also the matrices of a rectification, those of a single camera, because ROS does not read a file without them.
std::string CameraModelToYaml(const CameraModel& camera) {
  const std::string projection = List({camera.fx_px, 0, camera.cx_px, 0, 0, camera.fy_px, camera.cy_px, 0, 0, 0, 1, 0});
  return absl::StrFormat(
      "image_width: %d\n"
      "image_height: %d\n"
      "camera_name: camera\n"
      "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [%s]\n"
      "distortion_model: %s\n"
      "distortion_coefficients:\n  rows: 1\n  cols: %d\n  data: [%s]\n"
      "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
      "projection_matrix:\n  rows: 3\n  cols: 4\n  data: [%s]\n",
      camera.width_px, camera.height_px, MatrixOf(camera), RosName(camera.lens_model), camera.Coefficients().size(),
      List(camera.Coefficients()), projection);
}

}  // namespace evpose
