// SPDX-License-Identifier: Apache-2.0

// evpose camera: prints, checks, converts and draws the calibration of a camera.
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/commands/camera_picture.h"
#include "client/cli/commands/commands.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/geometry/undistortion_table.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

struct CameraArguments {
  std::string file;
  std::string to;
  std::string out;
  std::string picture;
  bool is_json = false;
};

constexpr std::pair<const char*, CameraFormat> kFormats[] = {{"ros", CameraFormat::kRos},
                                                             {"kalibr", CameraFormat::kKalibr},
                                                             {"metavision", CameraFormat::kMetavision},
                                                             {"opencv", CameraFormat::kOpenCv}};

CameraFormat FormatByName(const std::string& name) {
  for (const auto& [known, format] : kFormats) {
    if (name == known) return format;
  }
  return CameraFormat::kRos;
}

Json CameraJson(const CameraFile& file) {
  const CameraModel& camera = file.camera;
  const absl::Span<const double> coefficients = camera.Coefficients();
  return {{"width", camera.width_px},
          {"height", camera.height_px},
          {"lens_model", LensModelName(camera.lens_model)},
          {"fx_px", camera.fx_px},
          {"fy_px", camera.fy_px},
          {"cx_px", camera.cx_px},
          {"cy_px", camera.cy_px},
          {"distortion", std::vector<double>(coefficients.begin(), coefficients.end())},
          {"format", file.format}};
}

// Returns the angle in degrees between the directions of two pixels; "beyond 170" if one of them has no direction.
std::string ViewBetween(const CameraModel& camera, const Eigen::Vector2d& first_px, const Eigen::Vector2d& last_px) {
  std::vector<Eigen::Vector3d> directions;
  for (const Eigen::Vector2d& pixel : {first_px, last_px}) {
    const auto point = UndistortNormalised(camera.lens_model, camera.distortion, BearingOf(camera, pixel).head<2>());
    if (!point) return "beyond 170";
    directions.push_back(Eigen::Vector3d(point->x(), point->y(), 1.0).normalized());
  }
  const double angle = std::atan2(directions[0].cross(directions[1]).norm(), directions[0].dot(directions[1]));
  return absl::StrFormat("%.1f", angle * kDegreesPerRadian);
}

void PrintCamera(const std::string& path, const CameraFile& file, std::ostream& out) {
  const CameraModel& camera = file.camera;
  const double right = camera.width_px - 1, bottom = camera.height_px - 1;
  out << path << ": read as " << file.description << "\n";
  out << absl::StrFormat("image       %dx%d px\n", camera.width_px, camera.height_px);
  out << absl::StrFormat("lens        %s, %s\n", LensModelName(camera.lens_model),
                         absl::StrJoin(camera.Coefficients(), " "));
  out << absl::StrFormat("focal       %.6g, %.6g px\n", camera.fx_px, camera.fy_px);
  out << absl::StrFormat("centre      %.6g, %.6g px\n", camera.cx_px, camera.cy_px);
  out << absl::StrFormat("view        %s degrees wide, %s high, %s diagonal\n",
                         ViewBetween(camera, {0.0, camera.cy_px}, {right, camera.cy_px}),
                         ViewBetween(camera, {camera.cx_px, 0.0}, {camera.cx_px, bottom}),
                         ViewBetween(camera, {0.0, 0.0}, {right, bottom}));
}

// A property for which a tracker refuses the camera is an error. Others are warnings: the principal point of a cropped
// image may lie outside of it.
absl::Status CheckCamera(const std::string& path, const CameraModel& camera, std::ostream& err) {
  const bool is_inside = camera.cx_px >= -0.5 && camera.cx_px <= camera.width_px - 0.5 && camera.cy_px >= -0.5 &&
                         camera.cy_px <= camera.height_px - 0.5;
  if (!is_inside) {
    err << absl::StrFormat(
        "evpose camera: warning: %s: camera_matrix: the principal point (%.6g, %.6g) lies outside the image of %dx%d "
        "pixels; this is right for a crop of a larger image only\n",
        path, camera.cx_px, camera.cy_px, camera.width_px, camera.height_px);
  }
  absl::Status status = camera.CheckView();
  if (status.ok()) status = UndistortionTable::Create(camera).status();
  if (status.ok()) return status;
  return absl::Status(status.code(), absl::StrCat(path, ": ", status.message()));
}

absl::Status RunCamera(const CameraArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const CameraFile file, ReadCameraFile(arguments.file));
  EVPOSE_RETURN_IF_ERROR(CheckCamera(arguments.file, file.camera, context.err));
  const bool is_converted = !arguments.to.empty() || !arguments.out.empty();
  std::string converted;
  if (is_converted) {
    const absl::StatusOr<std::string> text = FormatCamera(file.camera, FormatByName(arguments.to));
    if (!text.ok()) return absl::InvalidArgumentError(absl::StrCat(arguments.file, ": ", text.status().message()));
    converted = *text;
  }
  if (!arguments.picture.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string png, DrawCamera(file.camera));
    EVPOSE_RETURN_IF_ERROR(WriteFile(arguments.picture, png));
  }
  if (is_converted && arguments.out.empty()) {
    context.out << converted;
    return absl::OkStatus();
  }
  if (is_converted) EVPOSE_RETURN_IF_ERROR(WriteFile(arguments.out, converted));
  return PrintResult(context, arguments.is_json, CameraJson(file), [&](std::ostream& out) {
    PrintCamera(arguments.file, file, out);
    if (!arguments.out.empty()) out << "written     " << arguments.out << "\n";
  });
}

}  // namespace

CommandRunner AddCameraCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<CameraArguments>();
  AddFile(app, "file", arguments->file, kCameraFiles)->required()->group(kInputGroup);
  std::vector<std::string> names;
  for (const auto& [name, format] : kFormats) names.emplace_back(name);
  app.option_defaults()->group(kOutputGroup);
  CLI::Option* out = AddOutputFile(app, "-o,--out", arguments->out, "File for the converted calibration");
  CLI::Option* to = app.add_option("--to", arguments->to,
                                   "Convert to this format; without --out, to standard output. Default with --out: ros")
                        ->check(CLI::IsMember(names));
  AddPicture(app, "--picture", arguments->picture,
             "Picture (.png) of how the lens shows straight lines and equal angles");
  AddJson(app, arguments->is_json);
  app.footer(
      "Checks that the field of view is that of a lens, and that the distortion does not fold inside the image.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.1 --out cube\n"
      "  evpose camera cube/camera.yaml --to kalibr --out cube/camchain.yaml --picture cube/lens.png");
  return [arguments, to, out, &context]() -> absl::Status {
    if (arguments->is_json && to->count() > 0 && out->count() == 0) {
      return UsageError("--json and --to would both write to standard output; give --out FILE");
    }
    return RunCamera(*arguments, context);
  };
}

}  // namespace evpose::client
