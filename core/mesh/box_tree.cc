// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/box_tree.h"

#include <algorithm>
#include <numeric>

namespace evpose {
namespace {

// A usual compromise: smaller leaves need more boxes, larger ones more tests.
constexpr size_t kMaxLeafBoxes = 4;

}  // namespace

BoxTree::BoxTree(absl::Span<const Eigen::AlignedBox3f> boxes) : order_(boxes.size()) {
  if (boxes.empty()) return;
  std::iota(order_.begin(), order_.end(), 0u);
  nodes_.reserve(boxes.size());
  Build(boxes, 0, boxes.size());
  boxes_.reserve(boxes.size());
  for (const uint32_t index : order_) boxes_.push_back(boxes[index]);
}

// The search visits both children of each node on the way to the leaf.
size_t BoxTree::LeastNodes(size_t num_boxes) {
  size_t nodes = num_boxes > 0 ? 1 : 0;
  for (; num_boxes > kMaxLeafBoxes; num_boxes /= 2) nodes += 2;
  return nodes;
}

void BoxTree::Build(absl::Span<const Eigen::AlignedBox3f> boxes, size_t begin, size_t end) {
  const size_t node = nodes_.size();
  nodes_.emplace_back();
  Eigen::AlignedBox3f box, centres;
  for (size_t i = begin; i < end; ++i) {
    box.extend(boxes[order_[i]]);
    centres.extend(boxes[order_[i]].center());
  }
  nodes_[node].box = box;
  if (end - begin <= kMaxLeafBoxes) {
    nodes_[node].first = static_cast<uint32_t>(begin);
    nodes_[node].count = static_cast<uint32_t>(end - begin);
    return;
  }
  int axis;
  centres.sizes().maxCoeff(&axis);
  const size_t half = begin + (end - begin) / 2;
  const auto at = [&](size_t i) { return order_.begin() + static_cast<std::ptrdiff_t>(i); };
  // Ties are broken by index, so that the tree is a function of the boxes.
  std::nth_element(at(begin), at(half), at(end), [&](uint32_t a, uint32_t b) {
    const float centre_a = boxes[a].min()[axis] + boxes[a].max()[axis];
    const float centre_b = boxes[b].min()[axis] + boxes[b].max()[axis];
    return centre_a != centre_b ? centre_a < centre_b : a < b;
  });
  Build(boxes, begin, half);
  nodes_[node].first = static_cast<uint32_t>(nodes_.size());
  Build(boxes, half, end);
}

}  // namespace evpose
