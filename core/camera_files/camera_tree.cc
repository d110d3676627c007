// SPDX-License-Identifier: Apache-2.0
#include "core/camera_files/camera_tree.h"

#include <algorithm>
#include <cstdint>
#include <new>
#include <pugixml.hpp>
#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

constexpr size_t kMaxNumbers = 32;  // a projection matrix has 12, the longest list of coefficients 14
// Largest depth of the elements of an XML file. OpenCV writes 3 or 4.
constexpr int kMaxDepth = 16;
// Largest number of keys of the outermost map and of each map in it. A camera has some dozens.
constexpr size_t kMaxKeys = 1000;
constexpr size_t kMaxInnerKeys = 10'000;  // of all maps in the outermost one

std::string LineOf(const std::string& text, std::ptrdiff_t offset) {
  const auto end = text.begin() + std::clamp<std::ptrdiff_t>(offset, 0, static_cast<std::ptrdiff_t>(text.size()));
  return absl::StrCat("line ", 1 + std::count(text.begin(), end, '\n'));
}

// The value of an XML element: a map if it has elements, otherwise its words, one as a scalar and several as a list.
YAML::Node FromXml(const pugi::xml_node& element, int depth) {
  YAML::Node node;
  if (depth > kMaxDepth) return node;
  for (const pugi::xml_node& child : element.children()) {
    if (child.type() == pugi::node_element) node.force_insert(std::string(child.name()), FromXml(child, depth + 1));
  }
  if (node.IsMap()) return node;
  const std::string text(absl::StripAsciiWhitespace(element.child_value()));
  if (text.empty()) return node;
  const std::vector<std::string> words = absl::StrSplit(text, absl::ByAnyChar(" \t\r\n"), absl::SkipEmpty());
  if (text.front() == '"' || (words.size() == 1 && std::string_view(element.name()) != "data")) {
    return YAML::Node(std::string(absl::StripSuffix(absl::StripPrefix(text, "\""), "\"")));
  }
  for (const std::string& word : words) node.push_back(word);
  return node;
}

absl::StatusOr<YAML::Node> ParseXml(const std::string& text, const std::string& file) {
  pugi::xml_document document;
  const pugi::xml_parse_result result = document.load_buffer(text.data(), text.size());
  if (!result) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": ", LineOf(text, result.offset), ": not XML: ", result.description()));
  }
  const pugi::xml_node root = document.document_element();
  if (std::string_view(root.name()) != "opencv_storage") {
    return absl::InvalidArgumentError(absl::StrCat(
        file, ": not a camera file: of XML, only files of OpenCV and DV, with the element opencv_storage, are read"));
  }
  return FromXml(root, 0);
}

absl::StatusOr<YAML::Node> ParseYaml(const std::string& text, const std::string& file) {
  try {
    return YAML::Load(text);
  } catch (const YAML::Exception& e) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s: line %d: not YAML: %s", file, e.mark.line + 1, Escaped(e.msg, kMaxParserText)));
  } catch (const std::bad_alloc&) {
    throw;  // memory is exhausted: no fault of the file
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": not a camera file: ", e.what()));
  }
}

// The first line of OpenCV's YAML is no directive of YAML. It becomes a comment, so that lines keep their numbers.
std::string WithoutOpenCvDirective(const std::string& text) {
  return absl::StartsWith(text, "%YAML:") ? absl::StrCat("#", text.substr(1)) : text;
}

// Each look-up of a key compares it with all keys of its map, and readers look for each key of the outermost map and
// for several keys of the maps in it. An alias of YAML counts like the map that it names.
absl::Status CheckNumberOfKeys(const YAML::Node& root, const std::string& file) {
  const auto too_many = [&file](size_t limit) {
    return absl::InvalidArgumentError(absl::StrFormat("%s: has more than %d keys; not a camera file", file, limit));
  };
  if (root.size() > kMaxKeys) return too_many(kMaxKeys);
  size_t num_inner = 0;
  for (const auto& entry : root) {
    if (!entry.second.IsMap()) continue;
    const size_t size = entry.second.size();
    if (size > kMaxKeys) return too_many(kMaxKeys);
    num_inner += size;
    if (num_inner > kMaxInnerKeys) return too_many(kMaxInnerKeys);
  }
  return absl::OkStatus();
}

absl::Status CheckKeys(const YAML::Node& root, const std::string& file) {
  EVPOSE_RETURN_IF_ERROR(CheckNumberOfKeys(root, file));
  std::set<std::string> keys;
  for (const auto& entry : root) {
    if (!entry.first.IsScalar()) continue;
    if (!keys.insert(entry.first.Scalar()).second) {
      return CameraFieldError(file, Escaped(entry.first.Scalar()), "is given twice; keep one");
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CameraFieldError(const std::string& file, const std::string& field, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(file, ": ", field, ": ", what));
}

absl::StatusOr<CameraTree> ParseCameraTree(const std::string& text, const std::string& file) {
  CameraTree tree;
  const std::string content(absl::StripPrefix(text, "\xef\xbb\xbf"));  // the mark that some editors write
  const absl::string_view start = absl::StripLeadingAsciiWhitespace(content);
  if (absl::StartsWith(start, "<")) {
    tree.syntax = CameraSyntax::kXml;
    EVPOSE_ASSIGN_OR_RETURN(tree.root, ParseXml(content, file));
  } else {
    if (absl::StartsWith(start, "{")) tree.syntax = CameraSyntax::kJson;
    EVPOSE_ASSIGN_OR_RETURN(tree.root, ParseYaml(WithoutOpenCvDirective(content), file));
  }
  if (!tree.root.IsMap()) {
    return absl::InvalidArgumentError(absl::StrCat(
        file, ": not a camera file; ROS camera_info or Kalibr YAML, JSON of Metavision, files of OpenCV or ",
        "DV, or COLMAP's cameras.txt are expected"));
  }
  EVPOSE_RETURN_IF_ERROR(CheckKeys(tree.root, file));
  return tree;
}

bool CameraFields::Has(const std::string& key) const {
  const YAML::Node node = node_[key];
  return node && !node.IsNull();
}

absl::StatusOr<std::string> CameraFields::OneOf(const std::vector<std::string>& keys) const {
  std::string found;
  for (const std::string& key : keys) {
    if (!Has(key)) continue;
    if (!found.empty()) return Error(key, absl::StrCat("is given as ", path_, found, ", too; keep one"));
    found = key;
  }
  return found.empty() ? keys.front() : found;
}

absl::StatusOr<int> CameraFields::WholeNumber(const std::string& key) const {
  if (!Has(key)) return Error(key, "is missing; give a whole number");
  const YAML::Node node = node_[key];
  int value = 0;
  if (!node.IsScalar() || !YAML::convert<int>::decode(node, value)) return Error(key, "is not a whole number");
  return value;
}

absl::StatusOr<double> CameraFields::Number(const std::string& key) const {
  if (!Has(key)) return Error(key, "is missing; give a number");
  const YAML::Node node = node_[key];
  double value = 0.0;
  if (!node.IsScalar() || !YAML::convert<double>::decode(node, value)) return Error(key, "is not a number");
  return value;
}

absl::StatusOr<std::string> CameraFields::Word(const std::string& key) const {
  if (!Has(key)) return std::string();
  const YAML::Node node = node_[key];
  if (!node.IsScalar()) return Error(key, "is not a word");
  return node.Scalar();
}

absl::StatusOr<bool> CameraFields::Flag(const std::string& key) const {
  EVPOSE_ASSIGN_OR_RETURN(const std::string word, Word(key));
  const std::string lower = absl::AsciiStrToLower(word);
  if (lower == "1" || lower == "true") return true;
  if (lower.empty() || lower == "0" || lower == "false") return false;
  return Error(key, "is neither true nor false");
}

absl::StatusOr<std::vector<double>> CameraFields::NumbersOf(const YAML::Node& list, const std::string& key) const {
  if (list.size() > kMaxNumbers) return Error(key, absl::StrCat("has more than ", kMaxNumbers, " numbers"));
  std::vector<double> values;
  for (size_t i = 0; i < list.size(); ++i) {
    double value = 0.0;
    if (!list[i].IsScalar() || !YAML::convert<double>::decode(list[i], value)) {
      return Error(absl::StrFormat("%s[%d]", key, i), "is not a number");
    }
    values.push_back(value);
  }
  return values;
}

absl::StatusOr<std::vector<double>> CameraFields::Numbers(const std::string& key) const {
  if (!Has(key)) return Error(key, "is missing; give a list of numbers");
  if (!node_[key].IsSequence()) return Error(key, "is not a list of numbers");
  return NumbersOf(node_[key], key);
}

absl::StatusOr<std::vector<double>> CameraFields::Matrix(const std::string& key) const {
  if (!Has(key)) return Error(key, "is missing; give rows, cols and data");
  if (!node_[key].IsMap()) return Error(key, "is not a map with rows, cols and data");
  const CameraFields matrix = Child(key);
  EVPOSE_ASSIGN_OR_RETURN(const int rows, matrix.WholeNumber("rows"));
  EVPOSE_ASSIGN_OR_RETURN(const int cols, matrix.WholeNumber("cols"));
  const YAML::Node data = node_[key]["data"];
  if (!data || !data.IsSequence()) return Error(key + ".data", "is missing or not a list of numbers");
  if (rows < 0 || cols < 0 || static_cast<int64_t>(rows) * cols != static_cast<int64_t>(data.size())) {
    return Error(key, absl::StrFormat("has %d rows and %d cols, but %d numbers in data", rows, cols, data.size()));
  }
  return NumbersOf(data, key + ".data");
}

std::vector<std::string> CameraFields::Keys() const {
  std::vector<std::string> keys;
  for (const auto& entry : node_) {
    if (entry.first.IsScalar()) keys.push_back(entry.first.Scalar());
  }
  return keys;
}

absl::Status TakeCameraMatrix(const CameraFields& fields, const std::string& key, const std::vector<double>& matrix,
                              CameraModel& camera) {
  if (matrix.size() != 9) {
    return fields.Error(key, absl::StrFormat("has %d numbers, but must have 3 x 3", matrix.size()));
  }
  if (matrix[1] != 0.0 || matrix[3] != 0.0 || matrix[6] != 0.0 || matrix[7] != 0.0 || matrix[8] != 1.0) {
    const bool is_zero = std::all_of(matrix.begin(), matrix.end(), [](double value) { return value == 0.0; });
    return fields.Error(key, is_zero ? "is 0: the camera is not calibrated"
                                     : "must be [fx, 0, cx, 0, fy, cy, 0, 0, 1], row by row, without skew");
  }
  camera.fx_px = matrix[0];
  camera.cx_px = matrix[2];
  camera.fy_px = matrix[4];
  camera.cy_px = matrix[5];
  return absl::OkStatus();
}

absl::Status TakeImageSize(const CameraFields& fields, const std::string& key, const std::vector<double>& size,
                           CameraModel& camera) {
  constexpr double kMaxSide = 1e6;  // fits int; CameraModel::Validate() has the limit of a camera
  const auto is_whole = [](double side) { return side >= 0.0 && side <= kMaxSide && side == static_cast<int>(side); };
  if (size.size() != 2 || !is_whole(size[0]) || !is_whole(size[1])) {
    return fields.Error(key, "is not [width, height], whole numbers of pixels");
  }
  camera.width_px = static_cast<int>(size[0]);
  camera.height_px = static_cast<int>(size[1]);
  return absl::OkStatus();
}

absl::Status TakeDistortion(const CameraFields& fields, const std::string& key, std::vector<double> coefficients,
                            CameraModel& camera) {
  const size_t wanted = NumCoefficients(camera.lens_model);
  if (camera.lens_model == LensModel::kRational) {
    for (size_t i = wanted; i < coefficients.size(); ++i) {
      if (coefficients[i] == 0.0) continue;
      return fields.Error(key, absl::StrFormat("has %d numbers, of which those beyond 8 are not 0: the thin prism and "
                                               "the tilted model are not supported; calibrate with 5 or 8",
                                               coefficients.size()));
    }
    coefficients.resize(std::min(coefficients.size(), wanted));
  }
  const bool is_short_brown =
      camera.lens_model == LensModel::kBrown && (coefficients.empty() || coefficients.size() == 4);
  if (coefficients.size() != wanted && !is_short_brown) {
    const char* const has = camera.lens_model == LensModel::kBrown ? "a Brown lens has 4 or 5 (k1, k2, p1, p2, k3)"
                            : camera.lens_model == LensModel::kRational
                                ? "a rational lens has 8 (k1, k2, p1, p2, k3 to k6)"
                                : "a fisheye lens has 4 (k1 to k4)";
    return fields.Error(key, absl::StrFormat("has %d numbers, but %s", coefficients.size(), has));
  }
  std::copy(coefficients.begin(), coefficients.end(), camera.distortion.begin());
  return absl::OkStatus();
}

}  // namespace evpose
