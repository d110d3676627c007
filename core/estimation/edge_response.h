// SPDX-License-Identifier: Apache-2.0

// Where a pixel that deficit_counts to the logarithm of its light, in steps of a threshold, puts the events of a moving
// edge (core/estimation/README.md, section 3; the pixel model of Lichtsteiner et al. 2008).
//
// In the image an edge of log contrast L is a blurred step. A level l above its dark side, 0 < l < L, lies where the
// blurred light reaches it: at x = blur PhiInv((e^l - 1) / (e^L - 1)) from the true edge, towards the bright side: the
// levels' mean lies on the dark side. Events come at the levels that the pixel crosses, a threshold apart. Where the
// pixel's last event had the other polarity the first of them needs a whole threshold more, on average over where its
// memory stands: the levels are uniform over what is left, and the events lag.
#pragma once

#include <array>

namespace evpose {

class EdgeResponse {
 public:
  // The same for all sensors; computed once.
  static const EdgeResponse& Get();

  // Mean distance of an edge's events from its true place, along its motion (negative: they lag), in units of the blur.
  // `contrast`: L; the first levels, a share `hysteresis` of L, are skipped. Both are clamped to what is tabulated:
  // (0, 5] and [0, 0.9].
  double Brighter(double contrast, double hysteresis) const;  // ON events
  double Darker(double contrast, double hysteresis) const;    // OFF events

 private:
  static constexpr int kContrastSteps = 40;
  static constexpr double kMaxContrast = 5.0;
  static constexpr int kHysteresisSteps = 18;
  static constexpr double kMaxHysteresis = 0.9;
  using Table = std::array<std::array<double, kHysteresisSteps + 1>, kContrastSteps + 1>;

  EdgeResponse();
  void Tabulate(int contrast_index);
  static double Interpolate(const Table& table, double contrast, double hysteresis);

  Table brighter_ = {};
  Table darker_ = {};
};

}  // namespace evpose
