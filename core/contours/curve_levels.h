// SPDX-License-Identifier: Apache-2.0

// The curved edges of a model as chords, at each level of detail (core/contours/README.md, section 3).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "core/contours/edge_elements.h"
#include "core/models/object_model.h"

namespace evpose {

// Size of a pixel at the object, relative to the diameter of the object, for which a level is made.
double PixelSizeOfLevel(int level);

// Immutable after construction. Keeps a reference: `model` must outlive it.
class CurveLevels {
 public:
  CurveLevels(const ObjectModel& model, double sagitta_px);

  // Calls visit(element, curve) with each chord of the model's curves, in order.
  template <typename Visit>
  void VisitChords(int level, const Visit& visit) const {
    for (size_t curve = 0; curve < model_.curves.size(); ++curve) {
      const std::vector<uint32_t>& cuts = cuts_[level][curve];
      for (size_t i = 1; i < cuts.size(); ++i) visit(MakeChord(curve, cuts[i - 1], cuts[i]), curve);
    }
  }

 private:
  // Integrals along a curve from its first point to each of its points.
  struct Integral {
    double length_m = 0.0;
    Eigen::Vector3d position = Eigen::Vector3d::Zero();  // integral of the position over the length
  };

  EdgeElement MakeChord(size_t curve, uint32_t first, uint32_t last) const;

  const ObjectModel& model_;
  std::vector<std::vector<Integral>> integrals_;                           // by curve
  std::array<std::vector<std::vector<uint32_t>>, kNumDetailLevels> cuts_;  // by level and curve: indices of points
};

}  // namespace evpose
