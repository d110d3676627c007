// SPDX-License-Identifier: Apache-2.0

// The evidence for one of two poses, summed over windows (core/tracking/README.md, equation (3)).
#pragma once

#include <cstdint>

#include "core/base/state_io.h"

namespace evpose {

class ScoreComparison {
 public:
  // Adds a window with the sums D, S and E of equation (3) of the README. D is positive if the first pose is the better
  // one.
  void Add(double difference, double squares, double explained);
  // Standard deviations by which the first pose is the better one. `dispersion`: HealthOptions::dispersion;
  // `model_error_ratio`: InitializationOptions::model_error_ratio.
  double Sigma(double dispersion, double model_error_ratio) const;

  static void VisitState(auto& archive, auto& self);

 private:
  static constexpr int64_t kMaxWindows = int64_t{1} << 40;  // more than a stream can have

  double difference_ = 0.0;
  double squares_ = 0.0;
  double explained_ = 0.0;
  // Sums over the windows of D^2, D S and S^2.
  double differences2_ = 0.0;
  double products_ = 0.0;
  double squares2_ = 0.0;
  int64_t num_windows_ = 0;  // with differences
};

void ScoreComparison::VisitState(auto& archive, auto& self) {
  auto& [difference, squares, explained, differences2, products, squares2, num_windows] = self;
  archive(Finite(difference), Finite(squares), Finite(explained), Finite(differences2), Finite(products));
  archive(Finite(squares2));
  archive(InRange(num_windows, int64_t{0}, kMaxWindows));
}

}  // namespace evpose
