// What comes beside a line and is no line's: the object's own surface under a flickering lamp, what it moves in front
// of. It is seldom the same on both sides, and what is on one side only would draw an outline inwards (method.md 2.6
// has one density for all lines).
#pragma once

#include <array>
#include <vector>

#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/tracking/association.h"
#include "core/tracking/robust.h"

namespace evpose {

// Of the distances below zero, and above.
using SideDensities = std::array<double, 2>;

// What a window's events say of one line.
struct LineCounts {
  double own = 0.0;                   // events that it explains
  std::array<double, 2> beside = {};  // events from kBesideRatio of the gate on that nothing explains, by side
  static constexpr double kBesideRatio = 2.0 / 3.0;  // no event of the line itself is so far from it
};

// Remembers it for each line of a model, for as long as about a hundred events: a lamp's flicker has flanks of a few
// milliseconds.
class LineClutter {
 public:
  explicit LineClutter(const CameraModel& camera) : camera_(camera) {}

  // One for each of `tracked`: the density that takes the place of density.Outlier() beside that line, 1/px, where its
  // own events have 1 - density.outlier_ratio in all. No less than density.Outlier(): that nothing was there is no
  // reason to take the first thing that comes for the line. `lines` are their images. A line at rest has
  // density.Outlier(): what is on one side of it may be on its way to the other.
  void Densities(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                 const MixtureDensity& density, std::vector<SideDensities>& densities) const;
  // From an accepted window, whose gates were so wide at the end. Of a line at rest, which makes no events itself,
  // nothing is learned.
  void Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
             absl::Span<const LineCounts> counts, double gate_px);
  void Reset() { lines_.clear(); }

  static void VisitState(auto& archive, auto& self) {
    auto& [camera, lines] = self;
    archive(lines);
  }

 private:
  struct Memory {
    double own = 0.0;
    std::array<double, 2> beside_per_px = {};

    static void VisitState(auto& archive, auto& self) {
      auto& [own, beside_per_px] = self;
      constexpr double kMax = 1e6;
      bool is_empty = own == 0.0 && beside_per_px == std::array<double, 2>();
      archive(is_empty);
      if (is_empty) return;
      archive(AtMost(own, kMax), AtMost(beside_per_px[0], kMax), AtMost(beside_per_px[1], kMax));
    }
  };
  bool IsMoving(const ImageLine& line) const;

  const CameraModel camera_;
  std::vector<Memory> lines_;  // by model line
};

}  // namespace evpose
