// SPDX-License-Identifier: Apache-2.0

// The triangles of each region of a surface.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/types/smooth_surface.h"

namespace evpose {

class RegionTriangles {
 public:
  explicit RegionTriangles(const SmoothSurface& surface)
      : first_(surface.regions.size() + 1, 0), triangles_(surface.region_of.size()) {
    for (const uint32_t region : surface.region_of) ++first_[region + 1];
    for (size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
    std::vector<uint32_t> next(first_.begin(), first_.end() - 1);
    for (uint32_t t = 0; t < triangles_.size(); ++t) triangles_[next[surface.region_of[t]]++] = t;
  }

  // Ascending.
  absl::Span<const uint32_t> Of(size_t region) const {
    return absl::MakeConstSpan(triangles_).subspan(first_[region], first_[region + 1] - first_[region]);
  }

 private:
  std::vector<uint32_t> first_;  // index into `triangles_`; one more than there are regions
  std::vector<uint32_t> triangles_;
};

}  // namespace evpose
