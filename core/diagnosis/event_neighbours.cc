// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/event_neighbours.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace evpose {
namespace {

constexpr int64_t kNeverHadEvent = INT64_MIN;

// Expected neighbours of a noise event by chance, up to which the share of isolated events determines the noise: beyond
// 1, more noise has fewer isolated events.
constexpr double kMaxChanceNeighbours = 0.5;

// Bins up to 0.1 ms, which are used in any case: signal has an age of less at high event rates, noise hardly ever.
constexpr int kMinBins = 26;

// The smaller solution N of N exp(-a N) = `isolated`; -1 if there is none with a N <= kMaxChanceNeighbours.
double SolveNoise(double isolated, double chance_per_event) {
  double noise = isolated;
  for (int i = 0; i < 100; ++i) {
    const double next = isolated * std::exp(chance_per_event * noise);
    if (chance_per_event * next > kMaxChanceNeighbours) return -1.0;
    if (next - noise <= 1e-9 * next) return next;
    noise = next;
  }
  return noise;
}

}  // namespace

EventNeighbours::EventNeighbours(SensorGeometry geometry)
    : geometry_(geometry),
      stride_(static_cast<size_t>(geometry.width_px) + 2),
      last_us_(stride_ * (static_cast<size_t>(geometry.height_px) + 2), kNeverHadEvent) {}

int EventNeighbours::BinOf(int64_t age_us) {
  if (age_us < 1) return 0;
  const int octave = 63 - std::countl_zero(static_cast<uint64_t>(age_us));
  // The two bits below the highest one.
  const uint64_t scaled =
      octave >= 2 ? static_cast<uint64_t>(age_us) >> (octave - 2) : static_cast<uint64_t>(age_us) << (2 - octave);
  return std::min(kStepsPerOctave * octave + static_cast<int>(scaled & 3), kNumBins);
}

double EventNeighbours::LowerEdgeUs(int bin) {
  return std::ldexp(1.0 + (bin % kStepsPerOctave) / static_cast<double>(kStepsPerOctave), bin / kStepsPerOctave);
}

void EventNeighbours::Add(absl::Span<const Event> events, std::vector<int64_t>& ages_us) {
  ages_us.clear();
  for (const Event& event : events) {
    int64_t* const centre = last_us_.data() + (event.y + size_t{1}) * stride_ + event.x + 1;
    const int64_t* const above = centre - stride_;
    const int64_t* const below = centre + stride_;
    const int64_t newest =
        std::max({above[-1], above[0], above[1], centre[-1], centre[1], below[-1], below[0], below[1]});
    const int64_t age = newest == kNeverHadEvent ? kNoNeighbour : std::max<int64_t>(0, event.t_us - newest);
    ages_us.push_back(age);
    ++ages_[static_cast<size_t>(BinOf(age))];
    *centre = event.t_us;
  }
  num_events_ += events.size();
}

double EventNeighbours::NoiseShare(int64_t duration_us) const {
  if (num_events_ == 0 || duration_us <= 0) return 0.0;
  const double pixel_us = 1.0 * geometry_.width_px * geometry_.height_px * static_cast<double>(duration_us);
  double least = static_cast<double>(num_events_);
  double older = least;  // events with an age above the lower edge of the bin
  for (int bin = 1; bin <= kNumBins; ++bin) {
    older -= static_cast<double>(ages_[static_cast<size_t>(bin - 1)]);
    const double chance_per_event = 8.0 * LowerEdgeUs(bin) / pixel_us;
    // `least` is not below the noise, so that the smaller solution is the right one up to here.
    if (chance_per_event * least > kMaxChanceNeighbours && bin > kMinBins) break;
    const double noise = SolveNoise(older, chance_per_event);
    if (noise >= 0.0) least = std::min(least, noise);
  }
  return least / static_cast<double>(num_events_);
}

}  // namespace evpose
