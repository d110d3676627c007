// SPDX-License-Identifier: Apache-2.0

// What comes beside a line and is no line's: the object's own surface under a flickering lamp, what it moves in front
// of. It is seldom the same on both sides, and what is on one side only would draw an outline inwards
// (core/estimation/README.md, section 1 has one density for all lines). Nor is it the same for both polarities: while a
// lamp grows brighter its events are ON, and a line whose own are OFF stands alone.
#pragma once

#include <array>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/base/state_io.h"
#include "core/numerics/robust.h"

namespace evpose {

// What an event's likelihood is made of, near a line.
struct LineDensities {
  ByPolarity own = {1.0, 1.0};            // factors on MixtureDensity::Line(), of mean 1
  std::array<ByPolarity, 2> beside = {};  // of distances below zero, and above: in the place of Outlier(), 1/px

  static LineDensities Of(const MixtureDensity& density) {
    const ByPolarity outlier = {density.Outlier(), density.Outlier()};
    return {{1.0, 1.0}, {outlier, outlier}};
  }
  friend bool operator==(const LineDensities&, const LineDensities&) = default;
};

// What a window's events say of one line.
struct LineCounts {
  ByPolarity own = {};                    // events that it explains
  std::array<ByPolarity, 2> beside = {};  // events from kLateralRatio of the gate on that nothing explains, by side
  static constexpr double kLateralRatio = 2.0 / 3.0;  // no event of the line itself is so far from it
};

// Remembers it for each line of a model, for as long as about a hundred events.
class LineClutter {
 public:
  explicit LineClutter(const CameraModel& camera) : camera_(camera) {}

  // One for each of `tracked`, whose images are `lines`. `counts`, of a first look at the window with gates of
  // `counts_gate_px`, or empty: a lamp's flicker has flanks of a few milliseconds, which memory is late for.
  // No density is less than density.Outlier(): that nothing was there is no reason to take the first thing that comes
  // for the line. A line at rest has the denser side's on both: what is on one side may be on its way to the other.
  void Densities(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                 absl::Span<const LineCounts> counts, double counts_gate_px, const MixtureDensity& density,
                 std::vector<LineDensities>& densities) const;
  // From an accepted window, whose gates were so wide at the end.
  void Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
             absl::Span<const LineCounts> counts, double gate_px);
  void Reset() { lines_.clear(); }

  static void VisitState(auto& archive, auto& self) {
    auto& [camera, lines] = self;
    archive(lines);
  }

 private:
  struct Memory {
    ByPolarity own = {};  // of a line that moves along its normal; of one that moves against it the other way round
    std::array<ByPolarity, 2> beside_per_px = {};

    static void VisitState(auto& archive, auto& self) {
      auto& [own, beside_per_px] = self;
      constexpr double kMax = 1e6;
      bool is_empty = own == ByPolarity() && beside_per_px == std::array<ByPolarity, 2>();
      archive(is_empty);
      if (is_empty) return;
      archive(AtMost(own[0], kMax), AtMost(own[1], kMax));
      for (auto& side : beside_per_px) archive(AtMost(side[0], kMax), AtMost(side[1], kMax));
    }
  };
  // +1 or -1 along its normal; 0 when it rests.
  int Direction(const ImageLine& line) const;
  static void Add(const LineCounts& counts, int direction, double gate_px, Memory& memory);

  const CameraModel camera_;
  std::vector<Memory> lines_;  // by model line
};

}  // namespace evpose
