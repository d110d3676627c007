// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/pixel_runs.h"

#include <algorithm>
#include <cmath>

namespace evpose {
namespace {

// An event of an edge has a neighbour within the time in which an edge at 50 px/s moves by a pixel; slower ones have
// neighbours along themselves.
constexpr int64_t kMaxNeighbourAgeUs = 20'000;
// Two events of a pixel that are further apart belong to two edges.
constexpr int64_t kMaxIntervalUs = 50'000;

// The plane t(x, y) of the begins of the runs around a pixel, among 5 x 5 pixels: over more of them an edge may be
// curved, and with fewer than kMinPlanePixels the residuals say little about its three unknowns.
constexpr int kPlaneRadius = 2;
constexpr int kMinPlanePixels = 10;
// Events of a run: the spread of two events depends on where the thresholds lie.
constexpr int kMinPassageEvents = 3;
// Root mean square of the distances from the plane, in pixels of motion: an edge that is straight, or a corner, or not
// one edge.
constexpr double kMaxPlaneRmsPx = 0.6;
// Variance of the logarithm of the speeds, among which proportionality is visible: a factor of 1.2.
constexpr double kMinLogVariance = 0.04;

// Quantile of the standard normal distribution by Acklam's rational approximation of its central part, |p - 1/2| <
// 0.475, relative error 1e-9; enough for 1 / (2 n) with n up to 20.
double CentralNormalQuantile(double p) {
  constexpr double kA[] = {-39.69683028665376, 220.9460984245205,  -275.9285104469687,
                           138.3577518672690,  -30.66479806614716, 2.506628277459239};
  constexpr double kB[] = {-54.47609879822406, 161.5858368580409, -155.6989798598866, 66.80131188771972,
                           -13.28068155288572};
  const double q = p - 0.5;
  const double r = q * q;
  const double numerator = (((((kA[0] * r + kA[1]) * r + kA[2]) * r + kA[3]) * r + kA[4]) * r + kA[5]) * q;
  return numerator / (((((kB[0] * r + kB[1]) * r + kB[2]) * r + kB[3]) * r + kB[4]) * r + 1.0);
}

// Distance between the first and the last of n events at equal steps of a Gaussian edge, in standard deviations.
double SpreadOfRun(int n) { return 2.0 * CentralNormalQuantile(1.0 - 0.5 / std::min(n, 20)); }

}  // namespace

PixelRuns::PixelRuns(SensorGeometry geometry)
    : geometry_(geometry), pixels_(static_cast<size_t>(geometry.width_px) * static_cast<size_t>(geometry.height_px)) {}

void PixelRuns::Add(absl::Span<const Event> events, absl::Span<const int64_t> ages_us) {
  for (size_t k = 0; k < events.size(); ++k) {
    const Event& event = events[k];
    if (ages_us[k] > kMaxNeighbourAgeUs) continue;
    Pixel& pixel = pixels_[static_cast<size_t>(event.y) * static_cast<size_t>(geometry_.width_px) + event.x];
    const bool is_new_passage = pixel.polarity != event.polarity || event.t_us - pixel.last_us > kMaxIntervalUs;
    if (is_new_passage) {
      if (pixel.length >= kMinPassageEvents) MeasurePassage(event.x, event.y);
      pixel.begin_us[event.polarity] = event.t_us;
      pixel.length = 0;
      pixel.polarity = event.polarity;
    }
    events_[event.polarity] += 1.0;
    pixel.length = static_cast<uint16_t>(std::min<int>(pixel.length + 1, UINT16_MAX));
    pixel.last_us = event.t_us;
  }
}

void PixelRuns::MeasurePassage(int x, int y) {
  const auto at = [this](int u, int v) -> const Pixel& {
    return pixels_[static_cast<size_t>(v) * static_cast<size_t>(geometry_.width_px) + static_cast<size_t>(u)];
  };
  const Pixel& centre = at(x, y);
  const int64_t begin_us = centre.begin_us[centre.polarity];
  double n = 0.0, su = 0.0, sv = 0.0, st = 0.0, suu = 0.0, suv = 0.0, svv = 0.0, sut = 0.0, svt = 0.0, stt = 0.0;
  for (int v = std::max(0, y - kPlaneRadius); v <= std::min(geometry_.height_px - 1, y + kPlaneRadius); ++v) {
    for (int u = std::max(0, x - kPlaneRadius); u <= std::min(geometry_.width_px - 1, x + kPlaneRadius); ++u) {
      const double t = 1e-6 * static_cast<double>(at(u, v).begin_us[centre.polarity] - begin_us);
      if (std::abs(t) > 1e-6 * kMaxIntervalUs * kPlaneRadius) continue;
      const double du = u - x, dv = v - y;
      n += 1.0;
      su += du, sv += dv, st += t;
      suu += du * du, suv += du * dv, svv += dv * dv;
      sut += du * t, svt += dv * t, stt += t * t;
    }
  }
  if (n < kMinPlanePixels) return;
  const double a = suu - su * su / n, b = suv - su * sv / n, d = svv - sv * sv / n;
  const double p = sut - su * st / n, q = svt - sv * st / n;
  const double determinant = a * d - b * b;
  if (determinant < 1e-3 * a * d) return;
  const double slope_u = (d * p - b * q) / determinant;
  const double slope_v = (a * q - b * p) / determinant;
  const double slope_s = std::sqrt(slope_u * slope_u + slope_v * slope_v);  // seconds per pixel
  const double residual = std::max(0.0, stt - st * st / n - slope_u * p - slope_v * q);
  if (!(slope_s > 0.0) || residual > n * kMaxPlaneRmsPx * kMaxPlaneRmsPx * slope_s * slope_s) return;
  const double duration_s = 1e-6 * static_cast<double>(centre.last_us - begin_us) / SpreadOfRun(centre.length);
  if (duration_s < 0.0) return;  // the clock stepped back within the run
  const auto bin = static_cast<size_t>(duration_s / slope_s / kBlurBinPx);
  ++blurs_[std::min<size_t>(bin, kBlurBins - 1)];
  const double log_slope = std::log(slope_s), log_duration = std::log(std::max(duration_s, 1e-6));
  sums_.slope += log_slope, sums_.duration += log_duration;
  sums_.slope_slope += log_slope * log_slope, sums_.slope_duration += log_slope * log_duration;
}

PixelRuns::Blur PixelRuns::MeasureBlur() const {
  Blur blur;
  for (const uint64_t count : blurs_) blur.num_passages += count;
  const auto n = static_cast<double>(blur.num_passages);
  const double variance = sums_.slope_slope - sums_.slope * sums_.slope / n;
  blur.has_speeds = variance > kMinLogVariance * n;
  if (blur.has_speeds) blur.exponent = (sums_.slope_duration - sums_.slope * sums_.duration / n) / variance;
  uint64_t below = 0;
  for (int bin = 0; bin < kBlurBins; ++bin) {
    const uint64_t count = blurs_[static_cast<size_t>(bin)];
    if (count > 0 && 2 * (below + count) >= blur.num_passages) {
      const double inside =
          (0.5 * static_cast<double>(blur.num_passages) - static_cast<double>(below)) / static_cast<double>(count);
      blur.median_px = (bin + inside) * kBlurBinPx;
      break;
    }
    below += count;
  }
  return blur;
}

}  // namespace evpose
