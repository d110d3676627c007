// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/camera_report.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>

#include "absl/strings/str_format.h"
#include "client/cli/pictures/png.h"

namespace evpose::client {

Json CameraCalibrationJson(const CameraCalibration& calibration) {
  Json parameters = Json::object();
  for (const CalibratedParameter& parameter : calibration.parameters) {
    parameters[parameter.name] = {
        {"value", parameter.value},
        {"standard_error", parameter.is_fitted ? Json(parameter.standard_error) : Json(nullptr)},
        {"bound", parameter.is_fitted ? Json(parameter.bound) : Json(nullptr)}};
  }
  Json places = Json::array();
  for (const ProjectionUncertainty& place : calibration.uncertainties) {
    places.push_back({{"place", place.place},
                      {"x_px", place.pixel.x()},
                      {"y_px", place.pixel.y()},
                      {"sigma_px", place.sigma_px},
                      {"half_difference_px", place.half_difference_px}});
  }
  Json coverage = Json::array();
  for (const auto& row : calibration.coverage) {
    Json& counts = coverage.emplace_back(Json::array());
    for (const CoverageCell& cell : row) counts.push_back(cell.num_samples);
  }
  return {{"width", calibration.camera.width_px},
          {"height", calibration.camera.height_px},
          {"parameters", parameters},
          {"projection", places},
          {"rms_px", calibration.rms_px},
          {"intervals", calibration.num_intervals},
          {"samples", calibration.num_samples},
          {"events", std::llround(calibration.num_events)},
          {"rounds", calibration.num_rounds},
          {"is_converged", calibration.is_converged},
          {"coverage", coverage},
          {"warnings", calibration.warnings}};
}

void PrintCameraCalibration(const CameraCalibration& calibration, std::ostream& out) {
  out << absl::StrFormat("%d x %d px, %d intervals, %d positions of line pieces from %.0f events, %d rounds\n",
                         calibration.camera.width_px, calibration.camera.height_px, calibration.num_intervals,
                         calibration.num_samples, calibration.num_events, calibration.num_rounds);
  out << "value, standard error, and its bound, that of independent errors\n";
  for (const CalibratedParameter& parameter : calibration.parameters) {
    out << absl::StrFormat("%-16s %11.5g", parameter.name, parameter.value)
        << (parameter.is_fitted ? absl::StrFormat(" +- %-9.2g %.2g\n", parameter.standard_error, parameter.bound)
                                : std::string("  not determined\n"));
  }
  out << absl::StrFormat("residuals of the positions, rms: %.3f px\n", calibration.rms_px);
  out << "projection, px: one standard deviation; difference between two halves of the data\n";
  for (const ProjectionUncertainty& place : calibration.uncertainties) {
    out << absl::StrFormat("  %-20s %7.3f  %7.3f\n", place.place, place.sigma_px, place.half_difference_px);
  }
  out << "positions by part of the image, each of 1/16 x 1/9:\n";
  for (const auto& row : calibration.coverage) {
    for (const CoverageCell& cell : row) out << absl::StrFormat("%6d", cell.num_samples);
    out << "\n";
  }
}

absl::StatusOr<std::string> DrawCoverage(const CameraCalibration& calibration) {
  constexpr int kWidthPx = 1280;  // 80 px for each of the 16 columns: the text of a cell fits
  constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
  const int height_px = std::max(
      64, static_cast<int>(std::lround(1.0 * kWidthPx * calibration.camera.height_px / calibration.camera.width_px)));
  int most = 1;
  for (const auto& row : calibration.coverage) {
    for (const CoverageCell& cell : row) most = std::max(most, cell.num_samples);
  }
  cv::Mat image(height_px, kWidthPx, CV_8UC3, cv::Scalar(255, 255, 255));
  for (int row = 0; row < kCoverageRows; ++row) {
    for (int column = 0; column < kCoverageColumns; ++column) {
      const CoverageCell& cell = calibration.coverage[row][column];
      const cv::Rect area(cv::Point(column * kWidthPx / kCoverageColumns, row * height_px / kCoverageRows),
                          cv::Point((column + 1) * kWidthPx / kCoverageColumns, (row + 1) * height_px / kCoverageRows));
      // The square root makes cells with few samples visible; cells without samples are white.
      const int shade = static_cast<int>(std::lround(200.0 * std::sqrt(1.0 * cell.num_samples / most)));
      cv::rectangle(image, area, cv::Scalar(255, 255 - 0.5 * shade, 255 - shade), cv::FILLED);
      cv::rectangle(image, area, cv::Scalar(215, 215, 215), 1);
      if (cell.num_samples == 0) continue;
      cv::putText(image, absl::StrFormat("%.2f", cell.rms_px), {area.x + 6, area.y + area.height - 8}, kFont, 0.45,
                  cv::Scalar(30, 30, 30), 1, cv::LINE_AA);
    }
  }
  for (const ProjectionUncertainty& place : calibration.uncertainties) {
    const cv::Point at(
        std::clamp(static_cast<int>(place.pixel.x() * kWidthPx / calibration.camera.width_px), 8, kWidthPx - 120),
        std::clamp(static_cast<int>(place.pixel.y() * height_px / calibration.camera.height_px), 20, height_px - 30));
    cv::putText(image, absl::StrFormat("+- %.2f px", place.sigma_px), at, kFont, 0.5, cv::Scalar(0, 0, 190), 1,
                cv::LINE_AA);
  }
  return EncodePng(image);
}

}  // namespace evpose::client
