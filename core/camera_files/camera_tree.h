// SPDX-License-Identifier: Apache-2.0

// The tree of a camera file, whatever its syntax, and the values in it. Errors have the name of the file and the path
// of the key.
#pragma once

#include <yaml-cpp/yaml.h>

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/quoted.h"
#include "core/geometry/camera.h"

namespace evpose {

// Bytes of a message of the parser that an error repeats: it may contain words of the file.
inline constexpr size_t kMaxParserText = 200;

enum class CameraSyntax { kYaml, kJson, kXml };

struct CameraTree {
  YAML::Node root;  // a map
  CameraSyntax syntax = CameraSyntax::kYaml;
};

absl::Status CameraFieldError(const std::string& file, const std::string& field, const std::string& what);

// Parses YAML (its first document), JSON or the XML of OpenCV's FileStorage, whose matrices become maps of rows, cols
// and data. Errors: INVALID_ARGUMENT with the line, where known; also for a key of the outermost map that is given
// twice, and for a map of more than 1000 keys, because the time of a look-up grows with their number.
absl::StatusOr<CameraTree> ParseCameraTree(const std::string& text, const std::string& file);

// A map of a file, with the path to it ("cam0.") in front of the names of its keys.
class CameraFields {
 public:
  CameraFields(const YAML::Node& node, std::string file, std::string path = "")
      : node_(node), file_(std::move(file)), path_(std::move(path)) {}

  bool Has(const std::string& key) const;
  bool IsMap(const std::string& key) const { return Has(key) && node_[key].IsMap(); }
  bool IsSequence(const std::string& key) const { return Has(key) && node_[key].IsSequence(); }
  // The only one of these keys that the map has; the first if it has none. Error if it has several.
  absl::StatusOr<std::string> OneOf(const std::vector<std::string>& keys) const;

  absl::StatusOr<int> WholeNumber(const std::string& key) const;
  absl::StatusOr<double> Number(const std::string& key) const;
  // "" for a key that is missing or null.
  absl::StatusOr<std::string> Word(const std::string& key) const;
  // True for true and 1; false for false, 0 and a missing key.
  absl::StatusOr<bool> Flag(const std::string& key) const;
  // A list of numbers, at most 32.
  absl::StatusOr<std::vector<double>> Numbers(const std::string& key) const;
  // A matrix as a map of rows, cols and data, row by row.
  absl::StatusOr<std::vector<double>> Matrix(const std::string& key) const;
  CameraFields Child(const std::string& key) const { return {node_[key], file_, path_ + Escaped(key) + "."}; }
  // The names of all keys, in the order of the file.
  std::vector<std::string> Keys() const;

  absl::Status Error(const std::string& key, const std::string& what) const {
    return CameraFieldError(file_, path_ + key, what);
  }

 private:
  absl::StatusOr<std::vector<double>> NumbersOf(const YAML::Node& list, const std::string& key) const;

  const YAML::Node node_;
  const std::string file_;
  const std::string path_;
};

// Takes [fx, 0, cx, 0, fy, cy, 0, 0, 1], which the file has at `key`.
absl::Status TakeCameraMatrix(const CameraFields& fields, const std::string& key, const std::vector<double>& matrix,
                              CameraModel& camera);
// Takes [width, height].
absl::Status TakeImageSize(const CameraFields& fields, const std::string& key, const std::vector<double>& size,
                           CameraModel& camera);
// Takes the coefficients at `key` for camera.lens_model. Brown has 4, 5 or none (no distortion); rational 8, fisheye 4.
// More than 8 are those of OpenCV's thin prism and tilted models, and are accepted if the additional ones are 0.
absl::Status TakeDistortion(const CameraFields& fields, const std::string& key, std::vector<double> coefficients,
                            CameraModel& camera);

}  // namespace evpose
