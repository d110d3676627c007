// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/calibration_picture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/pictures/png.h"

namespace evpose::client {
namespace {

// Pixels.
constexpr int kPanelWidth = 640;
constexpr int kPanelHeight = 400;
constexpr int kTitleHeight = 44;
constexpr int kLegendHeight = 44;
constexpr int kMarginLeft = 84;
constexpr int kMarginRight = 24;
constexpr int kMarginTop = 40;
constexpr int kMarginBottom = 56;

const cv::Scalar kWhite(255, 255, 255);
const cv::Scalar kBlack(30, 30, 30);
const cv::Scalar kGrey(215, 215, 215);

// The mean residual of the passages of a bin; the mean less and plus 2 standard errors; the mean residual of the fitted
// profile; and the difference of both means. x is the mean of the quantity on the x axis.
struct Bin {
  double x, mean, low, high, fitted, left;
};

// Divides the passages into bins with about the same number of them.
std::vector<Bin> BinBy(std::vector<EdgePassage> passages, const SensorProfile& profile,
                       double (*key)(const EdgePassage&)) {
  // A curve has at most kBins points. Each point is the mean of at least kMinInBin passages. With fewer passages in a
  // point the curve follows the errors of single passages; with fewer points it hides how the residual changes with x.
  constexpr size_t kBins = 16;
  constexpr size_t kMinInBin = 8;
  std::sort(passages.begin(), passages.end(),
            [key](const EdgePassage& a, const EdgePassage& b) { return key(a) < key(b); });
  std::vector<Bin> binned;
  const size_t bins = std::clamp<size_t>(passages.size() / kMinInBin, 1, kBins);
  for (size_t bin = 0; bin < bins; ++bin) {
    const size_t begin = bin * passages.size() / bins, end = (bin + 1) * passages.size() / bins;
    if (end - begin < 2) continue;
    const double n = static_cast<double>(end - begin);
    double x = 0.0, mean = 0.0, squares = 0.0, fitted = 0.0;
    for (size_t i = begin; i < end; ++i) {
      x += key(passages[i]) / n;
      mean += passages[i].residual_px / n;
      squares += passages[i].residual_px * passages[i].residual_px / n;
      fitted += ExpectedResidualPx(profile, passages[i]) / n;
    }
    const double error = std::sqrt(std::max(0.0, squares - mean * mean) / n);
    binned.push_back({x, mean, mean - 2.0 * error, mean + 2.0 * error, fitted, mean - fitted});
  }
  return binned;
}

double SpeedOf(const EdgePassage& passage) { return passage.speed_px_per_s; }
double DensityOf(const EdgePassage& passage) { return passage.rates.events_per_px2 + passage.rates.reversals_per_px2; }

struct Polarity {
  const char* name;
  cv::Scalar color;  // blue, green, red
  std::vector<EdgePassage> passages;
};

enum class TextAlign { kLeft, kCentre, kRight };

void DrawText(cv::Mat& image, const std::string& text, cv::Point at, TextAlign align, double scale = 0.45) {
  constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
  int baseline = 0;
  const cv::Size size = cv::getTextSize(text, kFont, scale, 1, &baseline);
  if (align == TextAlign::kCentre) at.x -= size.width / 2;
  if (align == TextAlign::kRight) at.x -= size.width;
  cv::putText(image, text, at, kFont, scale, kBlack, 1, cv::LINE_AA);
}

// Returns a distance of 1, 2 or 5 times a power of ten that divides the range into four to ten parts.
double TickStep(double range) {
  constexpr double kMinParts = 4.0;  // with fewer labels a value between two of them is hard to read
  const double power = std::pow(10.0, std::floor(std::log10(range / kMinParts)));
  for (const double factor : {5.0, 2.0}) {
    if (range / (factor * power) >= kMinParts) return factor * power;
  }
  return power;
}

// A diagram with linear axes.
class Panel {
 public:
  Panel(cv::Mat& image, cv::Point corner, const std::string& title, const std::string& x_label,
        const std::string& y_label)
      : image_(image),
        area_(corner.x + kMarginLeft, corner.y + kMarginTop, kPanelWidth - kMarginLeft - kMarginRight,
              kPanelHeight - kMarginTop - kMarginBottom) {
    DrawText(image, title, {area_.x + area_.width / 2, area_.y - 14}, TextAlign::kCentre, 0.5);
    DrawText(image, x_label, {area_.x + area_.width / 2, area_.y + area_.height + 44}, TextAlign::kCentre);
    DrawText(image, y_label, {corner.x + 8, area_.y - 14}, TextAlign::kLeft);
  }

  // Widens the range of the axes to the values.
  void Include(const std::vector<Bin>& bins, double Bin::*y) {
    for (const Bin& bin : bins) {
      x_high_ = std::max(x_high_, bin.x);
      y_low_ = std::min(y_low_, bin.*y);
      y_high_ = std::max(y_high_, bin.*y);
    }
  }

  void DrawAxes() {
    // An axis without values, or with a single one, still has a range.
    if (!(x_high_ > 0.0)) x_high_ = 1.0;
    if (!(y_high_ > y_low_)) y_high_ = y_low_ + 1.0;
    x_high_ *= 1.05;
    const double margin = 0.05 * (y_high_ - y_low_);
    y_low_ -= margin;
    y_high_ += margin;
    const double x_step = TickStep(x_high_), y_step = TickStep(y_high_ - y_low_);
    for (int i = 0; i * x_step <= x_high_; ++i) {
      const int x = At(i * x_step, y_low_).x;
      cv::line(image_, {x, area_.y}, {x, area_.y + area_.height}, kGrey, 1);
      DrawText(image_, absl::StrFormat("%.6g", i * x_step), {x, area_.y + area_.height + 20}, TextAlign::kCentre);
    }
    for (int i = static_cast<int>(std::ceil(y_low_ / y_step)); i * y_step <= y_high_; ++i) {
      const int y = At(0.0, i * y_step).y;
      cv::line(image_, {area_.x, y}, {area_.x + area_.width, y}, kGrey, 1);
      DrawText(image_, absl::StrFormat("%.6g", i * y_step), {area_.x - 8, y + 5}, TextAlign::kRight);
    }
    cv::rectangle(image_, area_, kBlack, 1);
  }

  void DrawBand(const std::vector<Bin>& bins, double Bin::*low, double Bin::*high, const cv::Scalar& color) {
    constexpr double kOpacity = 0.25;  // the bands of both polarities overlap, and both stay visible
    std::vector<cv::Point> outline = Points(bins, low);
    const std::vector<cv::Point> upper = Points(bins, high);
    outline.insert(outline.end(), upper.rbegin(), upper.rend());
    if (outline.empty()) return;
    cv::Mat shaded = image_.clone();
    cv::fillPoly(shaded, std::vector<std::vector<cv::Point>>{outline}, color);
    cv::addWeighted(shaded, kOpacity, image_, 1.0 - kOpacity, 0.0, image_);
  }
  void DrawLine(const std::vector<Bin>& bins, double Bin::*y, const cv::Scalar& color) {
    cv::polylines(image_, std::vector<std::vector<cv::Point>>{Points(bins, y)}, false, color, 2, cv::LINE_AA);
  }
  void DrawPoints(const std::vector<Bin>& bins, double Bin::*y, const cv::Scalar& color) {
    for (const cv::Point& point : Points(bins, y)) cv::circle(image_, point, 4, color, cv::FILLED, cv::LINE_AA);
  }

 private:
  cv::Point At(double x, double y) const {
    return {area_.x + static_cast<int>(std::lround(x / x_high_ * area_.width)),
            area_.y + static_cast<int>(std::lround((y_high_ - y) / (y_high_ - y_low_) * area_.height))};
  }
  std::vector<cv::Point> Points(const std::vector<Bin>& bins, double Bin::*y) const {
    std::vector<cv::Point> points;
    for (const Bin& bin : bins) points.push_back(At(bin.x, bin.*y));
    return points;
  }

  cv::Mat& image_;
  const cv::Rect area_;
  double x_high_ = 0.0;  // the x axis begins at 0
  double y_low_ = 0.0;
  double y_high_ = 0.0;
};

void DrawRow(cv::Mat& image, int y, const std::vector<Polarity>& polarities, const SensorProfile& profile,
             const std::string& x_label, double (*key)(const EdgePassage&)) {
  Panel residuals(image, {0, y}, "Displacement of the events along the motion", x_label, "px");
  Panel left(image, {kPanelWidth, y}, "Remainder after the correction", x_label, "px");
  std::vector<std::vector<Bin>> binned;
  for (const Polarity& polarity : polarities) {
    binned.push_back(BinBy(polarity.passages, profile, key));
    const std::vector<Bin>& bins = binned.back();
    residuals.Include(bins, &Bin::low);
    residuals.Include(bins, &Bin::high);
    residuals.Include(bins, &Bin::fitted);
    left.Include(bins, &Bin::left);
  }
  residuals.DrawAxes();
  left.DrawAxes();
  for (size_t i = 0; i < polarities.size(); ++i) {
    const std::vector<Bin>& bins = binned[i];
    const cv::Scalar& color = polarities[i].color;
    residuals.DrawBand(bins, &Bin::low, &Bin::high, color);
    residuals.DrawLine(bins, &Bin::fitted, color);
    residuals.DrawPoints(bins, &Bin::mean, color);
    left.DrawLine(bins, &Bin::left, color);
    left.DrawPoints(bins, &Bin::left, color);
  }
}

void DrawLegend(cv::Mat& image, const std::vector<Polarity>& polarities) {
  // Pixels: the longest entry fits.
  constexpr int kEntryWidth = 620;
  constexpr int kFirstX = 40;
  const int y = image.rows - kLegendHeight / 2;
  for (size_t i = 0; i < polarities.size(); ++i) {
    const int x = kFirstX + kEntryWidth * static_cast<int>(i);
    cv::line(image, {x, y}, {x + 40, y}, polarities[i].color, 2, cv::LINE_AA);
    cv::circle(image, {x + 20, y}, 4, polarities[i].color, cv::FILLED, cv::LINE_AA);
    DrawText(image,
             absl::StrCat(polarities[i].name, ": points mean of a bin, band 2 standard errors, line fitted profile"),
             {x + 52, y + 5}, TextAlign::kLeft);
  }
}

}  // namespace

absl::StatusOr<std::string> DrawCalibration(const SensorCalibration& calibration,
                                            absl::Span<const CalibrationRecording> recordings) {
  // Blue and vermilion of Okabe and Ito, which colour-blind people can distinguish.
  std::vector<Polarity> polarities = {{"ON", {178, 114, 0}, {}}, {"OFF", {0, 94, 213}, {}}};
  for (const CalibrationRecording& recording : recordings) {
    for (const EdgePassage& passage : StepEdges(recording.passages, {})) {
      polarities[passage.IsBrighter() ? 0 : 1].passages.push_back(passage);
    }
  }
  cv::Mat image(kTitleHeight + 2 * kPanelHeight + kLegendHeight, 2 * kPanelWidth, CV_8UC3, kWhite);
  const SensorProfile& profile = calibration.profile;
  DrawText(image,
           absl::StrFormat("Sensor %s: blur %.3f px, threshold %.3f, latency %.0f us", profile.name, profile.blur_px,
                           profile.contrast_threshold, profile.latency_us),
           {kPanelWidth, 28}, TextAlign::kCentre, 0.6);
  DrawRow(image, kTitleHeight, polarities, profile, "speed, px/s", SpeedOf);
  DrawRow(image, kTitleHeight + kPanelHeight, polarities, profile, "events and polarity changes per swept square pixel",
          DensityOf);
  DrawLegend(image, polarities);
  return EncodePng(image);
}

}  // namespace evpose::client
