// SPDX-License-Identifier: Apache-2.0

// Density of the clutter beside each line, by side and polarity (core/estimation/README.md, section 1).
//
// Clutter beside a line is produced by the object's own surface under a flickering lamp, or by the background behind
// the moving object. It is seldom equal on both sides, and a density common to both would displace an outline towards
// the side with more clutter. It also differs by polarity: while a lamp becomes brighter, its events are ON and do not
// compete with the OFF events of a line.
#pragma once

#include <array>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/base/state_io.h"
#include "core/numerics/robust.h"

namespace evpose {

// Densities that determine the likelihood of an event near one line.
struct LineDensities {
  ByPolarity own = {1.0, 1.0};  // factors on MixtureDensity::Line(), by polarity; their mean is 1
  // Clutter at negative and at positive distances, by polarity, 1/px; replaces MixtureDensity::Outlier().
  std::array<ByPolarity, 2> beside = {};

  static LineDensities Of(const MixtureDensity& density) {
    const ByPolarity outlier = {density.Outlier(), density.Outlier()};
    return {{1.0, 1.0}, {outlier, outlier}};
  }
  friend bool operator==(const LineDensities&, const LineDensities&) = default;
};

// Counts of the observations of one line in a window.
struct LineCounts {
  ByPolarity own = {};  // observations attributed to the line, by polarity
  // Clutter farther from the line than kLateralRatio of the gate, by side and polarity.
  std::array<ByPolarity, 2> beside = {};

  void Add(const LineCounts& other) {
    for (int polarity = 0; polarity < 2; ++polarity) {
      own[polarity] += other.own[polarity];
      for (int side = 0; side < 2; ++side) beside[side][polarity] += other.beside[side][polarity];
    }
  }
  static constexpr double kLateralRatio = 2.0 / 3.0;  // beyond it the events of the line itself are negligible
};

// Averages the counts of each edge curve over about the last hundred events. The counts of the elements of a curve in a
// window are summed.
class LineClutter {
 public:
  explicit LineClutter(const CameraModel& camera) : camera_(camera) {}

  // Computes the densities of each line of `tracked`; `lines` are their images in the same order. `counts` are those of
  // an earlier pass over the same window with gates of half-width `counts_gate_px`, or empty: the flanks of a
  // flickering lamp last a few milliseconds, and an average over past windows would lag behind them. `density` has the
  // spread, the outlier ratio and the gate.
  //
  // No density is below density.Outlier(): absence of clutter in the past must not make the next clutter event count as
  // one of the line. For a line at rest both sides get the larger of the two densities, because clutter on one side may
  // move to the other one.
  void Densities(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                 absl::Span<const LineCounts> counts, double counts_gate_px, const MixtureDensity& density,
                 std::vector<LineDensities>& densities) const;
  // Adds the counts of the last pass over an accepted window, with gates of half-width `gate_px`.
  void Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
             absl::Span<const LineCounts> counts, double gate_px);

  static void VisitState(auto& archive, auto& self) {
    auto& [camera, curves] = self;
    archive(curves);
  }

 private:
  struct Memory {
    // Rates by polarity, for motion along the normal; the polarities of a line that moves against it are exchanged.
    ByPolarity own = {};
    std::array<ByPolarity, 2> beside_per_px = {};

    static void VisitState(auto& archive, auto& self) {
      auto& [own, beside_per_px] = self;
      constexpr double kMax = 1e6;  // events; a bound far above kMemoryEvents of line_clutter.cc
      bool is_empty = own == ByPolarity() && beside_per_px == std::array<ByPolarity, 2>();
      archive(is_empty);
      if (is_empty) return;
      archive(AtMost(own[0], kMax), AtMost(own[1], kMax));
      for (auto& side : beside_per_px) archive(AtMost(side[0], kMax), AtMost(side[1], kMax));
    }
  };
  // +1 or -1 for motion along or against the normal; 0 at rest.
  int Direction(const ImageLine& line) const;
  static void Add(const LineCounts& counts, int direction, double gate_px, Memory& memory);
  // Densities of one line from the counts of its curve. `line` has the densities without clutter beside it.
  static void SetDensities(const Memory& memory, int direction, const MixtureDensity& density, LineDensities& line);

  const CameraModel camera_;
  std::vector<Memory> curves_;  // indexed by TrackedLine::curve
};

}  // namespace evpose
