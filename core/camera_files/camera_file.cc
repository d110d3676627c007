// SPDX-License-Identifier: Apache-2.0
#include "core/camera_files/camera_file.h"

#include <yaml-cpp/yaml.h>

#include <cstddef>
#include <cstdint>
#include <exception>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// A camera_info file has about 500 bytes; the limit leaves room for comments.
constexpr size_t kMaxFileBytes = 64 << 10;

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

const char* RosName(LensModel model) {
  return model == LensModel::kBrown      ? "plumb_bob"
         : model == LensModel::kRational ? "rational_polynomial"
                                         : "equidistant";
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

}  // namespace

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
  const std::string d = absl::StrJoin(camera.Coefficients(), ", ",
                                      [&](std::string* out, double value) { absl::StrAppend(out, number(value)); });
  return absl::StrFormat(
      "image_width: %d\n"
      "image_height: %d\n"
      "camera_name: camera\n"
      "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [%s]\n"
      "distortion_model: %s\n"
      "distortion_coefficients:\n  rows: 1\n  cols: %d\n  data: [%s]\n",
      camera.width_px, camera.height_px, k, RosName(camera.lens_model), camera.Coefficients().size(), d);
}

}  // namespace evpose
