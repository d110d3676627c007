// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/flicker_spectrum.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Least number of events of a part of the image in a segment: with fewer, the spectrum is chance.
constexpr double kMinPartEvents = 50.0;
// Parts of the image that have events: fewer may show a single machine (DiagnosisOptions::min_flicker_parts).
constexpr size_t kMinParts = 3;
// The power beside a line: the median of the frequencies this far away (94 Hz), without those into which the window
// spreads the line.
constexpr int kBackgroundBins = 24;
constexpr int kLineBins = 3;

}  // namespace

FlickerSpectrum::FlickerSpectrum(SensorGeometry geometry)
    : geometry_(geometry), bins_(kBins), window_(kBins), cosines_(kBins) {
  for (int i = 0; i < kBins; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / kBins;
    cosines_[static_cast<size_t>(i)] = std::cos(angle);
    window_[static_cast<size_t>(i)] = 0.5 - 0.5 * std::cos(angle);
  }
}

void FlickerSpectrum::Add(absl::Span<const Event> events) {
  for (const Event& event : events) {
    if (!has_begun_) {
      has_begun_ = true;
      begin_us_ = event.t_us;
    }
    if (event.t_us < begin_us_ + begin_bin_ * kBinUs) {
      // Slightly out of order events are left out; after a jump back a new segment begins.
      if (event.t_us >= begin_us_ + (begin_bin_ - kBins) * kBinUs) continue;
      begin_us_ = event.t_us;
      begin_bin_ = 0;
      std::fill(bins_.begin(), bins_.end(), Counts());
    }
    const int64_t bin = (event.t_us - begin_us_) / kBinUs;
    if (bin >= begin_bin_ + kBins) Advance(bin);
    const int part = event.y * kSide / geometry_.height_px * kSide + event.x * kSide / geometry_.width_px;
    Counts& counts = bins_[static_cast<size_t>(bin - begin_bin_)];
    ++counts.sum[static_cast<size_t>(part)];
    counts.difference[static_cast<size_t>(part)] += event.polarity != 0 ? 1 : -1;
  }
}

void FlickerSpectrum::Advance(int64_t bin) {
  constexpr int kHalf = kBins / 2;
  if (bin >= begin_bin_ + int64_t{2} * kBins) {
    // A gap, which a segment must not contain; the time after it may be any multiple of the step later.
    AddSegment();
    begin_bin_ += (bin - begin_bin_) / kHalf * kHalf;
    std::fill(bins_.begin(), bins_.end(), Counts());
    return;
  }
  while (bin >= begin_bin_ + kBins) {
    AddSegment();
    std::move(bins_.begin() + kHalf, bins_.end(), bins_.begin());
    std::fill(bins_.begin() + kHalf, bins_.end(), Counts());
    begin_bin_ += kHalf;
  }
}

void FlickerSpectrum::AddSegment() {
  std::array<double, kParts> events = {};
  for (const Counts& counts : bins_) {
    for (size_t part = 0; part < kParts; ++part) events[part] += counts.sum[part];
  }
  std::vector<size_t> parts;
  for (size_t part = 0; part < kParts; ++part) {
    if (events[part] >= kMinPartEvents) parts.push_back(part);
  }
  if (parts.size() < kMinParts) return;
  ++num_segments_;
  for (size_t i = 0; i < kBins; ++i) {
    for (const size_t part : parts) weighted_events_ += window_[i] * bins_[i].sum[part];
  }
  std::vector<double> series(kBins);
  std::vector<double> common_real(kFrequencies, 0.0), common_imaginary(kFrequencies, 0.0),
      magnitudes(kFrequencies, 0.0);
  for (const size_t part : parts) {
    for (size_t i = 0; i < kBins; ++i) series[i] = window_[i] * bins_[i].difference[part];
    for (size_t k = 1; k < kFrequencies; ++k) {
      double real = 0.0, imaginary = 0.0;
      for (size_t i = 0; i < kBins; ++i) {
        const size_t phase = i * k % kBins;
        real += series[i] * cosines_[phase];
        imaginary += series[i] * cosines_[(phase + kBins / 4) % kBins];
      }
      common_real[k] += real;
      common_imaginary[k] += imaginary;
      power_[k] += real * real + imaginary * imaginary;
      magnitudes[k] += std::sqrt(real * real + imaginary * imaginary);
    }
  }
  for (size_t k = 1; k < kFrequencies; ++k) {
    const double common = common_real[k] * common_real[k] + common_imaginary[k] * common_imaginary[k];
    common_power_[k] += common;
    amplitude_[k] += std::sqrt(common);
    magnitude_[k] += magnitudes[k];
    squared_magnitude_[k] += magnitudes[k] * magnitudes[k];
  }
}

FlickerSpectrum::Result FlickerSpectrum::Measure(const DiagnosisOptions& options) const {
  Result result;
  result.num_segments = num_segments_;
  if (num_segments_ == 0) return result;
  // An exponentially distributed power exceeds its median by this factor with the probability of a false alarm at one
  // of the frequencies. The mean over several segments does so more rarely.
  const double least = std::log(kFrequencies / options.false_alarm_probability) / std::numbers::ln2;
  const double step_hz = 1e6 / (kBins * static_cast<double>(kBinUs));
  for (int k = 1; k + 1 < kFrequencies; ++k) {
    const auto index = static_cast<size_t>(k);
    const double power = common_power_[index];
    if (k * step_hz < options.min_flicker_hz || power < common_power_[index - 1] || power <= common_power_[index + 1]) {
      continue;
    }
    std::vector<double> beside;
    for (int j = std::max(1, k - kBackgroundBins); j < std::min(kFrequencies, k + kBackgroundBins + 1); ++j) {
      if (std::abs(j - k) > kLineBins) beside.push_back(common_power_[static_cast<size_t>(j)]);
    }
    Line line;
    line.prominence = power / std::max(UpperMedian(beside), 1e-12);
    line.coherence = amplitude_[index] / std::max(magnitude_[index], 1e-12);
    line.num_parts = squared_magnitude_[index] / std::max(power_[index], 1e-12);
    // The vertex of a parabola through the logarithms of three powers, exact to 0.1 steps for the Hann window.
    const double left = std::log(std::max(common_power_[index - 1], 1e-12)), centre = std::log(power),
                 right = std::log(std::max(common_power_[index + 1], 1e-12));
    const double curvature = left - 2.0 * centre + right;
    line.frequency_hz = (k + (curvature < 0.0 ? 0.5 * (left - right) / curvature : 0.0)) * step_hz;
    // A signed rate a cos(w t) has the sum a / 2 of window times phase, and the mean event rate 2 a / pi.
    line.share = std::min(1.0, 4.0 / std::numbers::pi * amplitude_[index] / weighted_events_);
    const bool is_common = line.coherence >= options.min_coherence && line.num_parts >= options.min_flicker_parts;
    if (line.prominence >= least && is_common) result.lines.push_back(line);
  }
  std::sort(result.lines.begin(), result.lines.end(), [](const Line& a, const Line& b) { return a.share > b.share; });
  return result;
}

}  // namespace evpose
