// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_readers.h"

namespace evpose {
namespace {

// COLMAP's models and the order of their parameters: where each goes, in the order of the file. 'f' is both focal
// lengths, '0' to '7' a coefficient of the lens (colmap/colmap: src/colmap/sensor/models.h).
struct ColmapModel {
  const char* name;
  LensModel lens_model;
  const char* parameters;
};
constexpr ColmapModel kColmapModels[] = {
    {"SIMPLE_PINHOLE", LensModel::kBrown, "fuv"},        {"PINHOLE", LensModel::kBrown, "xyuv"},
    {"SIMPLE_RADIAL", LensModel::kBrown, "fuv0"},        {"RADIAL", LensModel::kBrown, "fuv01"},
    {"OPENCV", LensModel::kBrown, "xyuv0123"},           {"FULL_OPENCV", LensModel::kRational, "xyuv01234567"},
    {"OPENCV_FISHEYE", LensModel::kFisheye, "xyuv0123"}, {"SIMPLE_RADIAL_FISHEYE", LensModel::kFisheye, "fuv0"},
    {"RADIAL_FISHEYE", LensModel::kFisheye, "fuv01"},
};
// COLMAP's (0, 0) is the corner of the top-left pixel, whose centre is here (0, 0).
constexpr double kCornerToCentrePx = 0.5;

using Words = std::vector<std::string>;

// The lines that are neither empty nor comments, as words.
std::vector<Words> CameraLines(const std::string& text) {
  std::vector<Words> lines;
  for (const absl::string_view line : absl::StrSplit(text, '\n')) {
    const absl::string_view stripped = absl::StripAsciiWhitespace(line);
    if (stripped.empty() || stripped.front() == '#') continue;
    lines.push_back(absl::StrSplit(stripped, absl::ByAnyChar(" \t"), absl::SkipEmpty()));
  }
  return lines;
}

bool IsCameraLine(const Words& words) {
  int number = 0;
  return words.size() >= 5 && absl::SimpleAtoi(words[0], &number) && absl::SimpleAtoi(words[2], &number) &&
         absl::SimpleAtoi(words[3], &number) &&
         std::all_of(words[1].begin(), words[1].end(), [](char c) { return absl::ascii_isupper(c) || c == '_'; });
}

void TakeParameter(char place, double value, CameraModel& camera) {
  if (place == 'f') camera.fx_px = camera.fy_px = value;
  if (place == 'x') camera.fx_px = value;
  if (place == 'y') camera.fy_px = value;
  if (place == 'u') camera.cx_px = value - kCornerToCentrePx;
  if (place == 'v') camera.cy_px = value - kCornerToCentrePx;
  if (absl::ascii_isdigit(place)) camera.distortion[place - '0'] = value;
}

absl::StatusOr<CameraModel> ReadLine(const Words& words, const std::string& file) {
  const std::string field = absl::StrCat("camera ", Escaped(words[0]));
  if (!IsCameraLine(words)) return CameraFieldError(file, field, "is not ID MODEL WIDTH HEIGHT PARAMETERS");
  const auto* const model = std::find_if(std::begin(kColmapModels), std::end(kColmapModels),
                                         [&words](const ColmapModel& each) { return words[1] == each.name; });
  if (model == std::end(kColmapModels)) {
    const std::string known = absl::StrJoin(
        kColmapModels, ", ", [](std::string* out, const ColmapModel& each) { absl::StrAppend(out, each.name); });
    return CameraFieldError(file, field,
                            absl::StrCat("the model ", Escaped(words[1]), " is not supported; known are ", known));
  }
  const absl::string_view places = model->parameters;
  if (words.size() != 4 + places.size()) {
    return CameraFieldError(
        file, field,
        absl::StrCat(words[1], " has ", places.size(), " parameters, but ", words.size() - 4, " are given"));
  }
  CameraModel camera;
  camera.lens_model = model->lens_model;
  // IsCameraLine() has read these numbers.
  (void)absl::SimpleAtoi(words[2], &camera.width_px);
  (void)absl::SimpleAtoi(words[3], &camera.height_px);
  for (size_t i = 0; i < places.size(); ++i) {
    double value = 0.0;
    if (!absl::SimpleAtod(words[4 + i], &value)) {
      return CameraFieldError(file, field,
                              absl::StrCat("parameter ", i + 1, ", ", Escaped(words[4 + i]), ", is not a number"));
    }
    TakeParameter(places[i], value, camera);
  }
  return camera;
}

}  // namespace

bool IsColmap(const std::string& text) {
  const std::vector<Words> lines = CameraLines(text);
  return !lines.empty() && IsCameraLine(lines.front());
}

absl::StatusOr<CameraFile> ReadColmap(const std::string& text, const std::string& file, const std::string& selection) {
  const std::vector<Words> lines = CameraLines(text);
  std::vector<std::string> names;
  for (const Words& words : lines) names.push_back(words.front());
  EVPOSE_ASSIGN_OR_RETURN(const std::string name, SelectCamera(names, file, selection));
  CameraFile result = {.format = "colmap",
                       .description = absl::StrCat("camera ", Escaped(name), " of COLMAP's cameras.txt")};
  const size_t index = std::find(names.begin(), names.end(), name) - names.begin();
  EVPOSE_ASSIGN_OR_RETURN(result.camera, ReadLine(lines[index], file));
  return result;
}

}  // namespace evpose
