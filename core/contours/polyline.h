// SPDX-License-Identifier: Apache-2.0

// Approximation of a polyline by chords (core/contours/README.md, section 3).
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

// Computes the error at which each point becomes a cut (Douglas and Peucker, 1973). For any tolerance from `stop_at`
// on, the chords between the points with larger errors are within the tolerance of the polyline. The ends have no
// error. A chord within `stop_at` is not divided: the points between its ends have the error 0. Cuts beyond `kMaxCuts`
// levels are made in the middle, so that the time is O(n log n) for any points.
template <typename Vector>
void FindCutErrors(absl::Span<const Vector> points, double stop_at, std::vector<double>& errors) {
  struct Chord {
    size_t first, last;
    double error;  // error of the cut that made the chord
    int depth;
  };
  // Cuts of successive parts of one chord. Cuts near the middle need log2(n) of them, 32 for any number of points with
  // indices of 32 bits, so that only chords with unfavourable points reach the limit.
  constexpr int kMaxCuts = 40;
  errors.assign(points.size(), 0.0);
  if (points.size() < 3) return;
  std::vector<Chord> waiting = {{0, points.size() - 1, std::numeric_limits<double>::infinity(), 0}};
  while (!waiting.empty()) {
    const Chord chord = waiting.back();
    waiting.pop_back();
    const Vector along = points[chord.last] - points[chord.first];
    const double length2 = along.squaredNorm();
    size_t farthest = chord.first;
    double largest2 = stop_at * stop_at;
    for (size_t i = chord.first + 1; i < chord.last; ++i) {
      const Vector offset = points[i] - points[chord.first];
      const double position = length2 > 0.0 ? std::clamp(offset.dot(along) / length2, 0.0, 1.0) : 0.0;
      const double distance2 = (offset - position * along).squaredNorm();
      if (!(distance2 > largest2)) continue;
      largest2 = distance2;
      farthest = i;
    }
    if (farthest == chord.first) continue;
    // Parts of a chord within the tolerance are not needed, even if they have larger errors.
    const double error = std::min(chord.error, std::sqrt(largest2));
    if (chord.depth >= kMaxCuts) farthest = chord.first + (chord.last - chord.first) / 2;
    errors[farthest] = error;
    waiting.push_back({chord.first, farthest, error, chord.depth + 1});
    waiting.push_back({farthest, chord.last, error, chord.depth + 1});
  }
}

}  // namespace evpose
