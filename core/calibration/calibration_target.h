// SPDX-License-Identifier: Apache-2.0

// The printable target of a camera calibration: its pattern, its model and its pages (core/calibration/README.md,
// section 1).
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose {

// Black convex polygons on a white sheet. Coordinates are millimetres from the lower left corner of the sheet, x to the
// right and y upwards.
struct CalibrationTarget {
  double width_mm = 0.0;
  double height_mm = 0.0;
  std::vector<std::vector<Eigen::Vector2d>> ink;  // counter-clockwise
  // The ruler: a line of this length from its left end. A page has a tick every 10 mm, a screen one at each end.
  Eigen::Vector2d ruler_mm = Eigen::Vector2d::Zero();
  double ruler_length_mm = 0.0;
};

// Sizes of a sheet, millimetres, for which the pattern and its ruler are drawn.
inline constexpr double kMinSheetMm = 80.0;
inline constexpr double kMaxSheetMm = 5000.0;

// Makes the target of a sheet; the pattern is as wide and as high as the margins of a printer allow. Error:
// INVALID_ARGUMENT for a side outside kMinSheetMm to kMaxSheetMm.
absl::StatusOr<CalibrationTarget> MakeCalibrationTarget(double width_mm, double height_mm);

// Parses "A4", "A3", "letter" (landscape) or WIDTHxHEIGHT in millimetres, with or without "mm": "600x400mm". Error:
// INVALID_ARGUMENT listing these.
absl::StatusOr<CalibrationTarget> ParseCalibrationTarget(const std::string& page);

// OBJ text in metres. The origin is the middle of the sheet, x points to the right, y upwards and z to the reader. The
// faces are the white part of the sheet; the line elements are the borders of the ink, which are all edges of the
// model: those of the sheet depend on the printer.
std::string TargetToObj(const CalibrationTarget& target);
// The first words of that text.
inline constexpr char kTargetObjBegin[] = "# evpose target ";

// A PDF file of one page that prints at the true scale.
std::string TargetToPdf(const CalibrationTarget& target);

}  // namespace evpose
