// SPDX-License-Identifier: Apache-2.0

// Position of the events of a moving edge relative to the edge, for a pixel that responds to the logarithm of light in
// steps of a threshold (core/estimation/README.md, equation (9); pixel model of Lichtsteiner, Posch and Delbruck 2008).
//
// In the image an edge of log contrast L is a blurred step. The level l above its dark side, 0 < l < L, is reached at x
// = blur PhiInv((e^l - 1) / (e^L - 1)) from the true edge, towards the bright side; the mean over the levels lies on
// the dark side. Events occur at the levels that the pixel crosses, one threshold apart. If the previous event of the
// pixel had the other polarity, the first event needs one more threshold, on average over the reference level of the
// pixel: the levels are uniform over the rest, and the events lag.
#pragma once

#include <array>

namespace evpose {

class EdgeResponse {
 public:
  // The tables do not depend on the sensor; they are computed once.
  static const EdgeResponse& Get();

  // Mean distance of the events from the true edge along its motion, in units of the blur; negative: the events lag.
  // `contrast` is L, clamped to (0, 5]. The first levels, a fraction `hysteresis` of L, are skipped; it is clamped to
  // [0, 0.9]. The values are interpolated linearly in a table, with an error below 2e-3.
  double MeanOfOnEvents(double contrast, double hysteresis) const {
    return Interpolate(on_events_, contrast, hysteresis);
  }
  double MeanOfOffEvents(double contrast, double hysteresis) const {
    return Interpolate(off_events_, contrast, hysteresis);
  }

 private:
  // Size of the tables. L = 5 is a contrast of 1 : 150, which scenes do not exceed; steps of 0.125 in L and of 0.05 in
  // the hysteresis keep the interpolation error below 2e-3 (edge_response_test.cc).
  static constexpr int kContrastSteps = 40;
  static constexpr double kMaxContrast = 5.0;
  static constexpr int kHysteresisSteps = 18;
  static constexpr double kMaxHysteresis = 0.9;
  using Table = std::array<std::array<double, kHysteresisSteps + 1>, kContrastSteps + 1>;

  EdgeResponse();
  void Tabulate(int contrast_index);
  static double Interpolate(const Table& table, double contrast, double hysteresis);

  Table on_events_ = {};
  Table off_events_ = {};
};

}  // namespace evpose
