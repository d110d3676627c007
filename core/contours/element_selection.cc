// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <tuple>

#include "core/base/yield_point.h"
#include "core/contours/element_view.h"
#include "core/contours/segment_image.h"

namespace evpose {
namespace {

// Cells in which the elements of a view are counted: tiles of the box about all elements, and orientations of 45
// degrees. With more cells each has too few elements for a choice among them; with fewer the chosen elements may all be
// on one side of the object.
constexpr int kTilesPerSide = 4;
constexpr int kOrientations = 4;
constexpr size_t kCells = size_t{kTilesPerSide} * kTilesPerSide * kOrientations;

struct Ranked {
  uint32_t index = 0;
  bool is_outline = false;
  double weight = 0.0;
  SegmentImage image;
  int rank = 0;  // among those of one cell

  bool operator<(const Ranked& other) const {
    return std::tuple(!is_outline, rank, -weight, index) <
           std::tuple(!other.is_outline, other.rank, -other.weight, other.index);
  }
};

// Ranks elements, the strongest first, among those of the same cell.
void RankInCells(std::vector<Ranked>& ranked) {
  Eigen::AlignedBox2d box;
  for (const Ranked& element : ranked) box.extend(element.image.middle_px);
  const Eigen::Vector2d size = box.sizes();
  std::array<int, kCells> counts = {};
  const auto tile = [&](const Ranked& element, int axis) {
    if (!(size[axis] > 0.0)) return 0;
    const double position = (element.image.middle_px[axis] - box.min()[axis]) / size[axis];
    return std::min(static_cast<int>(kTilesPerSide * position), kTilesPerSide - 1);
  };
  for (Ranked& element : ranked) {
    const int orientation = ImageOctant(element.image.direction) % kOrientations;
    const int cell = (tile(element, 0) * kTilesPerSide + tile(element, 1)) * kOrientations + orientation;
    element.rank = counts[cell]++;
  }
}

// Keeps the candidates with these numbers in their order.
void Keep(std::vector<uint32_t> indices, std::vector<Candidate>& candidates) {
  std::sort(indices.begin(), indices.end());
  for (size_t i = 0; i < indices.size(); ++i) candidates[i] = candidates[indices[i]];
  candidates.resize(indices.size());
}

std::vector<uint32_t> IndicesOf(const std::vector<Ranked>& ranked) {
  std::vector<uint32_t> indices;
  indices.reserve(ranked.size());
  for (const Ranked& element : ranked) indices.push_back(element.index);
  return indices;
}

}  // namespace

bool KeepStrongest(size_t count, std::vector<Candidate>& candidates) {
  if (candidates.size() <= count) return false;
  std::vector<uint32_t> indices(candidates.size());
  std::iota(indices.begin(), indices.end(), 0u);
  std::nth_element(indices.begin(), indices.begin() + count, indices.end(), [&](uint32_t a, uint32_t b) {
    const double weight_a = candidates[a].weight(), weight_b = candidates[b].weight();
    return weight_a != weight_b ? weight_a > weight_b : a < b;
  });
  indices.resize(count);
  Keep(std::move(indices), candidates);
  return true;
}

bool SelectElements(int max_elements, std::vector<Candidate>& candidates) {
  std::vector<Ranked> ranked;
  ranked.reserve(candidates.size());
  for (uint32_t i = 0; i < candidates.size(); ++i) {
    const Candidate& candidate = candidates[i];
    const double length_px = candidate.length_px();
    if (!(length_px > 0.0)) continue;
    ranked.push_back({i, candidate.is_outline, candidate.weight(), SegmentBetween(candidate.p1_px, candidate.p2_px)});
  }
  std::sort(ranked.begin(), ranked.end());
  size_t kept = 0;
  for (size_t i = 0; i < ranked.size(); ++i) {
    YieldPoint(i);
    const Ranked element = ranked[i];
    const auto is_beside = [&element](const Ranked& stronger) { return IsBeside(element.image, stronger.image); };
    if (std::none_of(ranked.begin(), ranked.begin() + kept, is_beside)) ranked[kept++] = element;
  }
  ranked.resize(kept);
  const bool has_more = ranked.size() > static_cast<size_t>(max_elements);
  if (has_more) {
    RankInCells(ranked);
    std::sort(ranked.begin(), ranked.end());
    ranked.resize(max_elements);
  }
  Keep(IndicesOf(ranked), candidates);
  return has_more;
}

}  // namespace evpose
