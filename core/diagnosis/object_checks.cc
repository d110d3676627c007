// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/object_checks.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/length_text.h"
#include "core/tracking/object/event_extent.h"

namespace evpose {
namespace {

// The units of model files, in the order in which they are probable.
constexpr struct {
  const char* name;
  double factor;
} kUnits[] = {{"millimetres", 1e-3}, {"centimetres", 1e-2}, {"inches", 0.0254}, {"feet", 0.3048}, {"kilometres", 1e3}};

// The distance that an unknown unit is chosen for.
constexpr Range kLikelyDistanceM = {0.1, 10.0};

std::string SizeText(int width_px, int height_px) { return absl::StrCat(width_px, "x", height_px); }

}  // namespace

Finding CheckCamera(const CameraModel& camera, const RecordingHeader& header, const PixelCounts::Box& extent,
                    const DecodeCounts& counts) {
  Finding finding;
  finding.check = "camera";
  const std::string camera_size = SizeText(camera.width_px, camera.height_px);
  finding.text = absl::StrCat("the camera has ", camera_size, " pixels, as the recording");
  const SensorGeometry& sensor = header.geometry;
  if (header.geometry_is_known && (sensor.width_px != camera.width_px || sensor.height_px != camera.height_px)) {
    finding.verdict = Verdict::kProblem;
    finding.text = absl::StrCat("the camera has ", camera_size, " pixels, the recording ",
                                SizeText(sensor.width_px, sensor.height_px));
    finding.remedy = "give the file of the camera that made the recording; a crop needs a principal point of its own";
    return finding;
  }
  if (const absl::Status status = camera.CheckView(); !status.ok()) {
    finding.verdict = Verdict::kProblem;
    finding.text = std::string(status.message());
    finding.remedy = "check the camera file: evpose camera FILE; evpose calibrate makes one";
    return finding;
  }
  if (header.geometry_is_known) return finding;
  finding.text =
      absl::StrCat("the recording states no size; the camera has ", camera_size, " pixels, the events lie in columns ",
                   extent.x_min, " to ", extent.x_max, ", rows ", extent.y_min, " to ", extent.y_max);
  if (counts.dropped_outside_sensor > 0) {
    finding.verdict = Verdict::kProblem;
    absl::StrAppend(&finding.text, "; ", counts.dropped_outside_sensor, " events lie outside");
    finding.remedy = "give the file of the camera that made the recording";
  } else if (extent.x_max >= 0 && 2 * extent.x_max < camera.width_px && 2 * extent.y_max < camera.height_px) {
    finding.verdict = Verdict::kAdvice;
    finding.remedy = "no event lies in the right and in the lower half: is the camera that of the recording?";
  }
  return finding;
}

Finding CheckScale(double diameter_m, double scale, const CameraModel& camera, double extent_px,
                   const DiagnosisOptions& options) {
  Finding finding;
  finding.check = "model-scale";
  finding.text = absl::StrCat("the model is ", FormatLength(diameter_m), " across");
  const double metres_per_diameter = extent_px > 0.0 ? camera.MaxFocalPx() / extent_px : 0.0;
  const double distance_m = metres_per_diameter * diameter_m;
  if (extent_px > 0.0) {
    absl::StrAppend(&finding.text,
                    absl::StrFormat("; at a distance of %s its image is as large as the moving region, %.0f px",
                                    FormatLength(distance_m), extent_px));
  }
  const auto is_in = [&](const Range& diameters, const Range& distances) {
    return diameters.Contains(diameter_m) && (extent_px <= 0.0 || distances.Contains(distance_m));
  };
  SetMeasured(diameter_m, options.usual_diameter_m.high, "m", finding);
  if (is_in(options.usual_diameter_m, options.usual_distance_m)) return finding;
  finding.verdict =
      is_in(options.possible_diameter_m, options.possible_distance_m) ? Verdict::kAdvice : Verdict::kProblem;
  const Range& limits = finding.verdict == Verdict::kAdvice ? options.usual_diameter_m : options.possible_diameter_m;
  finding.limit = diameter_m < limits.low ? limits.low : limits.high;
  finding.remedy = "check the unit of the model file, and --scale";
  for (const auto& [name, factor] : kUnits) {
    if (!options.usual_diameter_m.Contains(factor * diameter_m)) continue;
    if (extent_px > 0.0 && !kLikelyDistanceM.Contains(factor * distance_m)) continue;
    finding.remedy = absl::StrFormat("the file is probably in %s: --scale %.6g", name, factor * scale);
    break;
  }
  return finding;
}

Finding CheckObjectSize(double extent_px) {
  if (extent_px <= 0.0) return NotChecked("object-size", "nothing moves; see motion");
  Finding finding;
  finding.check = "object-size";
  SetMeasured(extent_px, kMinSearchExtentPx, "px", finding);
  finding.text = absl::StrFormat("the moving region is %.0f px wide", extent_px);
  if (extent_px < kMinSearchExtentPx) {
    finding.verdict = Verdict::kAdvice;
    finding.remedy =
        "the search for a first pose may find too few lines: go nearer, use a longer lens, or give --init-pose";
  }
  return finding;
}

}  // namespace evpose
