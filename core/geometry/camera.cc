// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/camera.h"

#include <yaml-cpp/yaml.h>

#include <cmath>
#include <cstddef>
#include <exception>
#include <opencv2/calib3d.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "core/base/check_range.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// Twice the largest side that EVT3 can address, 2048 px. Bounds the undistortion table at 128 MiB, also for a file from
// an untrusted client.
constexpr int kMaxSidePx = 4096;
// A camera_info file has about 500 bytes; the limit leaves room for comments.
constexpr size_t kMaxFileBytes = 64 << 10;
// Largest distance between a pixel and the distorted projection of its bearing: far below the noise of an event.
constexpr double kMaxInversionErrorPx = 0.01;

absl::Status FieldError(const std::string& name, const std::string& field, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(name, ": ", field, ": ", what));
}

// The scalar at `key` of the map `parent`; `field` is its path and `type` its description in errors.
template <typename T>
absl::StatusOr<T> ReadScalar(const YAML::Node& parent, const std::string& key, const std::string& name,
                             const std::string& field, const char* type) {
  const YAML::Node node = parent[key];
  if (!node || node.IsNull()) return FieldError(name, field, absl::StrCat("is missing; give ", type));
  T value;
  if (!node.IsScalar() || !YAML::convert<T>::decode(node, value)) {
    return FieldError(name, field, absl::StrCat("is not ", type));
  }
  return value;
}

// A matrix as in camera_info: a map of rows, cols and data, row by row.
absl::StatusOr<std::vector<double>> ReadMatrix(const YAML::Node& root, const std::string& field,
                                               const std::string& name) {
  const YAML::Node node = root[field];
  if (!node || node.IsNull()) return FieldError(name, field, "is missing; give rows, cols and data");
  if (!node.IsMap()) return FieldError(name, field, "is not a map with rows, cols and data");
  EVPOSE_ASSIGN_OR_RETURN(const int rows, ReadScalar<int>(node, "rows", name, field + ".rows", "a whole number"));
  EVPOSE_ASSIGN_OR_RETURN(const int cols, ReadScalar<int>(node, "cols", name, field + ".cols", "a whole number"));
  const YAML::Node data = node["data"];
  if (!data || !data.IsSequence()) return FieldError(name, field + ".data", "is missing or not a list of numbers");
  if (rows < 0 || cols < 0 || static_cast<int64_t>(rows) * cols != static_cast<int64_t>(data.size())) {
    return FieldError(name, field,
                      absl::StrFormat("has %d rows and %d cols, but %d numbers in data", rows, cols, data.size()));
  }
  std::vector<double> values;
  for (size_t i = 0; i < data.size(); ++i) {
    double value;
    if (!data[i].IsScalar() || !YAML::convert<double>::decode(data[i], value)) {
      return FieldError(name, absl::StrFormat("%s.data[%d]", field, i), "is not a number");
    }
    values.push_back(value);
  }
  return values;
}

absl::Status ReadCameraMatrix(const YAML::Node& root, const std::string& name, CameraModel& camera) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> k, ReadMatrix(root, "camera_matrix", name));
  if (k.size() != 9) {
    return FieldError(name, "camera_matrix", absl::StrFormat("has %d numbers, but must have 3 x 3", k.size()));
  }
  if (k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0) {
    return FieldError(name, "camera_matrix", "must be [fx, 0, cx, 0, fy, cy, 0, 0, 1], row by row, without skew");
  }
  camera.fx_px = k[0];
  camera.cx_px = k[2];
  camera.fy_px = k[4];
  camera.cy_px = k[5];
  return absl::OkStatus();
}

absl::Status ReadDistortion(const YAML::Node& root, const std::string& name, CameraModel& camera) {
  std::string model;
  if (const YAML::Node node = root["distortion_model"]; node && !node.IsNull()) {
    EVPOSE_ASSIGN_OR_RETURN(model,
                            ReadScalar<std::string>(root, "distortion_model", name, "distortion_model", "a word"));
  }
  if (!model.empty() && model != "none" && model != "plumb_bob") {
    return FieldError(name, "distortion_model",
                      absl::StrCat("'", model, "' is not supported; use plumb_bob (k1, k2, p1, p2, k3) or none: ",
                                   "calibrate anew with that model, or undistort the recording"));
  }
  std::vector<double> coefficients;
  const YAML::Node given = root["distortion_coefficients"];
  if (model == "plumb_bob" || (given && !given.IsNull())) {
    EVPOSE_ASSIGN_OR_RETURN(coefficients, ReadMatrix(root, "distortion_coefficients", name));
  }
  if (model == "plumb_bob") {
    if (coefficients.size() != 4 && coefficients.size() != 5) {
      return FieldError(
          name, "distortion_coefficients",
          absl::StrFormat("has %d numbers, but plumb_bob has 4 or 5 (k1, k2, p1, p2, k3)", coefficients.size()));
    }
    for (size_t i = 0; i < coefficients.size(); ++i) camera.distortion[i] = coefficients[i];
    return absl::OkStatus();
  }
  for (const double coefficient : coefficients) {
    if (coefficient == 0.0) continue;
    return FieldError(name, "distortion_model",
                      "is missing or none, but distortion_coefficients are not 0; set it to plumb_bob");
  }
  return absl::OkStatus();
}

absl::StatusOr<CameraModel> ReadCamera(const YAML::Node& root, const std::string& name) {
  if (!root.IsMap()) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": not a camera file; ROS camera_info YAML is expected (image_width, image_height, ",
                     "camera_matrix, distortion_model, distortion_coefficients)"));
  }
  CameraModel camera;
  EVPOSE_ASSIGN_OR_RETURN(camera.width_px,
                          ReadScalar<int>(root, "image_width", name, "image_width", "a whole number of pixels"));
  EVPOSE_ASSIGN_OR_RETURN(camera.height_px,
                          ReadScalar<int>(root, "image_height", name, "image_height", "a whole number of pixels"));
  EVPOSE_RETURN_IF_ERROR(ReadCameraMatrix(root, name, camera));
  EVPOSE_RETURN_IF_ERROR(ReadDistortion(root, name, camera));
  if (const absl::Status status = camera.Validate(); !status.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(name, ": ", status.message()));
  }
  return camera;
}

Eigen::Vector2d Normalised(const CameraModel& camera, double u_px, double v_px) {
  return {(u_px - camera.cx_px) / camera.fx_px, (v_px - camera.cy_px) / camera.fy_px};
}

// The plumb-bob distortion of a normalised point. Its Jacobian is symmetric. It is positive definite around the centre
// of the image (`is_regular`), but not where the map folds or mirrors the image.
struct Distorted {
  Eigen::Vector2d point;
  bool is_regular;
};

Distorted DistortNormalised(const std::array<double, 5>& d, const Eigen::Vector2d& p) {
  const double x = p.x(), y = p.y();
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
  const double radial_slope = 2.0 * (d[0] + r2 * (2.0 * d[1] + r2 * 3.0 * d[4]));  // d(radial)/dx = slope * x
  const double xx = radial + radial_slope * x * x + 2.0 * d[2] * y + 6.0 * d[3] * x;
  const double xy = radial_slope * x * y + 2.0 * d[2] * x + 2.0 * d[3] * y;  // symmetric
  const double yy = radial + radial_slope * y * y + 6.0 * d[2] * y + 2.0 * d[3] * x;
  return {{x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x),
           y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y},
          xx > 0.0 && xx * yy - xy * xy > 0.0};
}

// Bearings of the pixels of row `v`, by OpenCV's fixed-point iteration in double precision.
absl::StatusOr<std::vector<cv::Point2d>> UndistortRow(const CameraModel& camera, int v) {
  const cv::Matx33d k(camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1);
  const auto& d = camera.distortion;
  const cv::Vec<double, 5> coefficients(d[0], d[1], d[2], d[3], d[4]);
  std::vector<cv::Point2d> pixels(camera.width_px);
  for (int u = 0; u < camera.width_px; ++u) pixels[u] = {static_cast<double>(u), static_cast<double>(v)};
  std::vector<cv::Point2d> bearings;
  try {
    // Far more iterations than a regular lens needs; IsInverse() checks the result.
    const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 200, 1e-6);
    cv::undistortPoints(pixels, bearings, k, coefficients, cv::noArray(), cv::noArray(), criteria);
  } catch (const std::exception& e) {
    return absl::InternalError(absl::StrCat("distortion_coefficients: OpenCV: ", e.what()));
  }
  return bearings;
}

// Whether `bearing` is the bearing of pixel (u, v): its distortion is that pixel, on the branch of the map around the
// centre of the image (beyond a fold, two bearings have the same pixel).
bool IsInverse(const CameraModel& camera, const Eigen::Vector2d& bearing, int u, int v) {
  const Distorted distorted = DistortNormalised(camera.distortion, bearing);
  const double error_x = distorted.point.x() * camera.fx_px + camera.cx_px - u;
  const double error_y = distorted.point.y() * camera.fy_px + camera.cy_px - v;
  return error_x * error_x + error_y * error_y <= kMaxInversionErrorPx * kMaxInversionErrorPx && distorted.is_regular;
}

}  // namespace

absl::Status CameraModel::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("image_width", width_px, 1, kMaxSidePx));
  EVPOSE_RETURN_IF_ERROR(CheckRange("image_height", height_px, 1, kMaxSidePx));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("camera_matrix: fx", fx_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("camera_matrix: fy", fy_px));
  if (!std::isfinite(cx_px)) return absl::InvalidArgumentError("camera_matrix: cx is not a finite number");
  if (!std::isfinite(cy_px)) return absl::InvalidArgumentError("camera_matrix: cy is not a finite number");
  for (const double coefficient : distortion) {
    if (std::isfinite(coefficient)) continue;
    return absl::InvalidArgumentError("distortion_coefficients: every number must be finite");
  }
  return absl::OkStatus();
}

absl::Status CameraModel::CheckView() const {
  // Focal lengths relative to the longer side: 1 / (2 tan(view / 2)) for views of 170 and 0.1 degrees.
  constexpr double kMinFocal = 0.0437;
  constexpr double kMaxFocal = 573.0;
  const double side_px = std::max(width_px, height_px);
  const auto check = [](const char* name, double value_px, double low_px, double high_px, const char* what) {
    if (value_px >= low_px && value_px <= high_px) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrFormat("camera_matrix: %s is %g px; with this image it must lie in [%g, %g]: %s", name, value_px,
                        low_px, high_px, what));
  };
  constexpr char kFocalRule[] = "a field of view of 0.1 to 170 degrees; give a calibration in pixels";
  constexpr char kCentreRule[] = "at most the longer side outside the image; give a calibration in pixels";
  EVPOSE_RETURN_IF_ERROR(check("fx", fx_px, kMinFocal * side_px, kMaxFocal * side_px, kFocalRule));
  EVPOSE_RETURN_IF_ERROR(check("fy", fy_px, kMinFocal * side_px, kMaxFocal * side_px, kFocalRule));
  EVPOSE_RETURN_IF_ERROR(check("cx", cx_px, -side_px, width_px + side_px, kCentreRule));
  return check("cy", cy_px, -side_px, height_px + side_px, kCentreRule);
}

Eigen::Vector2d CameraModel::Distort(const Eigen::Vector2d& undistorted_px) const {
  if (!HasDistortion()) return undistorted_px;
  const Eigen::Vector2d point =
      DistortNormalised(distortion, Normalised(*this, undistorted_px.x(), undistorted_px.y())).point;
  return {fx_px * point.x() + cx_px, fy_px * point.y() + cy_px};
}

bool CameraModel::IsInImage(const Eigen::Vector2d& undistorted_px) const {
  const Distorted distorted = DistortNormalised(distortion, Normalised(*this, undistorted_px.x(), undistorted_px.y()));
  const double u_px = fx_px * distorted.point.x() + cx_px, v_px = fy_px * distorted.point.y() + cy_px;
  return distorted.is_regular && u_px >= -0.5 && u_px <= width_px - 0.5 && v_px >= -0.5 && v_px <= height_px - 0.5;
}

absl::StatusOr<CameraModel> LoadCameraModel(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string yaml, ReadFile(path, kMaxFileBytes));
  return ParseCameraModel(yaml, path);
}

absl::StatusOr<CameraModel> ParseCameraModel(const std::string& yaml, const std::string& name_for_errors) {
  if (yaml.size() > kMaxFileBytes) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s: larger than %d bytes; not a camera file", name_for_errors, kMaxFileBytes));
  }
  try {
    return ReadCamera(YAML::Load(yaml), name_for_errors);
  } catch (const YAML::Exception& e) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s: line %d: not YAML: %s", name_for_errors, e.mark.line + 1, e.msg));
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(name_for_errors, ": not a camera file: ", e.what()));
  }
}

std::string CameraModelToYaml(const CameraModel& camera) {
  // 17 significant digits determine a double.
  const auto number = [](double value) { return absl::StrFormat("%.17g", value); };
  const std::string k = absl::StrJoin({number(camera.fx_px), std::string("0"), number(camera.cx_px), std::string("0"),
                                       number(camera.fy_px), number(camera.cy_px), std::string("0, 0, 1")},
                                      ", ");
  const std::string d = absl::StrJoin(camera.distortion, ", ",
                                      [&](std::string* out, double value) { absl::StrAppend(out, number(value)); });
  return absl::StrFormat(
      "image_width: %d\n"
      "image_height: %d\n"
      "camera_name: camera\n"
      "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [%s]\n"
      "distortion_model: plumb_bob\n"
      "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [%s]\n",
      camera.width_px, camera.height_px, k, d);
}

absl::StatusOr<UndistortionTable> UndistortionTable::Create(const CameraModel& camera) {
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  UndistortionTable table;
  for (int u = 0; u < camera.width_px; ++u) table.columns_.push_back(Normalised(camera, u, 0).cast<float>().x());
  for (int v = 0; v < camera.height_px; ++v) table.rows_.push_back(Normalised(camera, 0, v).cast<float>().y());
  if (!camera.HasDistortion()) return table;
  table.bearings_.reserve(static_cast<size_t>(camera.width_px) * camera.height_px);
  for (int v = 0; v < camera.height_px; ++v) {
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<cv::Point2d> row, UndistortRow(camera, v));
    for (int u = 0; u < camera.width_px; ++u) {
      const Eigen::Vector2d bearing(row[u].x, row[u].y);
      if (!IsInverse(camera, bearing, u, v)) {
        return absl::InvalidArgumentError(
            absl::StrFormat("distortion_coefficients: the distortion cannot be inverted at pixel (%d, %d); "
                            "calibrate with points up to the image's corners",
                            u, v));
      }
      table.bearings_.push_back(bearing.cast<float>());
    }
  }
  return table;
}

}  // namespace evpose
