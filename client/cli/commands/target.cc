// SPDX-License-Identifier: Apache-2.0

// evpose target: writes the printable target of a camera calibration, and its model.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/cli/commands/commands.h"
#include "client/cli/pictures/png.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/calibration/calibration_target.h"
#include "core/events/image_size.h"

namespace evpose::client {
namespace {

constexpr int kMaxScreenPx = 16384;  // twice the width of an 8K display; bounds the picture

struct TargetArguments {
  std::string page = "A4";
  std::string screen;
  double screen_mm = 0.0;
  std::string out;
  bool is_json = false;
};

absl::StatusOr<cv::Size> ParseScreen(const std::string& text) {
  const SensorGeometry size = ParseImageSize(text).value_or(SensorGeometry{});
  const auto [shorter, longer] = std::minmax(size.width_px, size.height_px);
  if (shorter >= 64 && longer <= kMaxScreenPx) return cv::Size(size.width_px, size.height_px);
  return UsageError(
      absl::StrCat("--screen ", text, ": WIDTHxHEIGHT in pixels, 64 to ", kMaxScreenPx, " each, such as 1920x1080"));
}

// Returns the target as a PNG file for a screen of the same shape. Pixels that an edge crosses have their mean shade.
absl::StatusOr<std::string> DrawScreen(const CalibrationTarget& target, const cv::Size& size) {
  constexpr int kFractionBits = 8;  // of OpenCV's fixed-point coordinates: 1/256 px
  cv::Mat image(size, CV_8UC1, cv::Scalar(255));
  const double px_per_mm = size.width / target.width_mm;
  // OpenCV has integers at the centres of pixels.
  const auto at = [&](const Eigen::Vector2d& point) {
    const auto fixed = [](double px) { return static_cast<int>(std::lround((px - 0.5) * (1 << kFractionBits))); };
    return cv::Point(fixed(px_per_mm * point.x()), fixed(px_per_mm * (target.height_mm - point.y())));
  };
  for (const auto& polygon : target.ink) {
    std::vector<cv::Point> corners;
    for (const Eigen::Vector2d& corner : polygon) corners.push_back(at(corner));
    cv::fillConvexPoly(image, corners, cv::Scalar(0), cv::LINE_AA, kFractionBits);
  }
  const Eigen::Vector2d end = target.ruler_mm + Eigen::Vector2d(target.ruler_length_mm, 0.0);
  cv::line(image, at(target.ruler_mm), at(end), cv::Scalar(0), 1, cv::LINE_AA, kFractionBits);
  for (const Eigen::Vector2d& tick : {target.ruler_mm, end}) {
    const Eigen::Vector2d half(0.0, 1.5);
    cv::line(image, at(tick - half), at(tick + half), cv::Scalar(0), 1, cv::LINE_AA, kFractionBits);
  }
  return EncodePng(image);
}

// An error if the file exists and was not written by this command.
absl::Status CheckIsReplaceable(const std::string& model) {
  std::error_code error;
  if (!std::filesystem::exists(model, error)) return absl::OkStatus();
  std::string begin(sizeof(kTargetObjBegin) - 1, ' ');
  std::ifstream(model).read(begin.data(), static_cast<std::streamsize>(begin.size()));
  if (begin == kTargetObjBegin) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(model, " exists and is not the model of a target: the model is written beside the drawing, so give ",
                   "--out another name, or move that file"));
}

absl::Status RunTarget(const TargetArguments& arguments, CliContext& context) {
  const bool is_screen = !arguments.screen.empty();
  const std::string extension = is_screen ? ".png" : ".pdf";
  if (!absl::EndsWithIgnoreCase(arguments.out, extension) || arguments.out.size() == extension.size()) {
    return UsageError(absl::StrCat("--out ", arguments.out, ": the name must end in ", extension,
                                   is_screen ? "" : "; for .png give --screen and --screen-mm"));
  }
  CalibrationTarget target;
  std::string drawing;
  if (is_screen) {
    EVPOSE_ASSIGN_OR_RETURN(const cv::Size size, ParseScreen(arguments.screen));
    const absl::StatusOr<CalibrationTarget> made =
        MakeCalibrationTarget(arguments.screen_mm, arguments.screen_mm * size.height / size.width);
    if (!made.ok()) return AsUsageError(made.status(), "--screen-mm: ");
    target = *made;
    EVPOSE_ASSIGN_OR_RETURN(drawing, DrawScreen(target, size));
  } else {
    const absl::StatusOr<CalibrationTarget> made = ParseCalibrationTarget(arguments.page);
    if (!made.ok()) return AsUsageError(made.status(), "--page: ");
    target = *made;
    drawing = TargetToPdf(target);
  }
  const std::string model = absl::StrCat(arguments.out.substr(0, arguments.out.size() - extension.size()), ".obj");
  EVPOSE_RETURN_IF_ERROR(CheckIsReplaceable(model));
  EVPOSE_ASSIGN_OR_RETURN(OutputFile drawing_file, OutputFile::Create(arguments.out));
  EVPOSE_ASSIGN_OR_RETURN(OutputFile model_file, OutputFile::Create(model));
  EVPOSE_RETURN_IF_ERROR(drawing_file.Append(drawing));
  EVPOSE_RETURN_IF_ERROR(model_file.Append(TargetToObj(target)));
  EVPOSE_RETURN_IF_ERROR(drawing_file.Commit());
  EVPOSE_RETURN_IF_ERROR(model_file.Commit());
  const Json json = {{"drawing", arguments.out},
                     {"model", model},
                     {"width_mm", target.width_mm},
                     {"height_mm", target.height_mm},
                     {"ruler_mm", target.ruler_length_mm}};
  return PrintResult(context, arguments.is_json, json, [&](std::ostream& out) {
    out << arguments.out << ": " << target.width_mm << " x " << target.height_mm << " mm; the ruler must measure "
        << target.ruler_length_mm << " mm, or give calibrate --scale MEASURED/" << target.ruler_length_mm << "\n"
        << model << ": its model, in metres\n";
  });
}

}  // namespace

CommandRunner AddTargetCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<TargetArguments>();
  app.option_defaults()->group("Target");
  CLI::Option* page = app.add_option("--page", arguments->page,
                                     "Size of the sheet: A4, A3, letter (landscape), or its sides in millimetres")
                          ->type_name("NAME|WIDTHxHEIGHT")
                          ->capture_default_str();
  CLI::Option* screen =
      app.add_option("--screen", arguments->screen,
                     "Instead of a sheet, a picture for a screen of this size in pixels, to be shown at full size")
          ->type_name("WIDTHxHEIGHT")
          ->excludes(page);
  CLI::Option* screen_mm =
      app.add_option("--screen-mm", arguments->screen_mm, "Width of the picture on the screen: the scale of the model")
          ->type_name("MILLIMETRES")
          ->needs(screen);
  screen->needs(screen_mm);
  app.option_defaults()->group(kOutputGroup);
  AddOutputFile(app, "-o,--out", arguments->out,
                "Drawing: .pdf, or .png for a screen; the model is written beside it, with the extension .obj")
      ->required();
  AddJson(app, arguments->is_json);
  app.footer(
      "Print at 100 %, measure the ruler, and glue the sheet onto a flat board. Record it moving through the whole "
      "image, near and far, tilted to all sides by 30 degrees and more: a few recordings of 10 s.\n\n"
      "Example:\n"
      "  evpose target --page A4 --out target.pdf\n"
      "  evpose simulate --model target.obj --front --duration 0.2 --out moving-target");
  return [arguments, &context] { return RunTarget(*arguments, context); };
}

}  // namespace evpose::client
