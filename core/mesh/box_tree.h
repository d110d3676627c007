// SPDX-License-Identifier: Apache-2.0

// Bounding volume hierarchy over boxes, for edges and triangles near a place.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

class BoxTree {
 public:
  explicit BoxTree(absl::Span<const Eigen::AlignedBox3f> boxes);

  // A lower bound of the nodes that a search visits in the tree of so many boxes if its query meets one of them.
  static size_t LeastNodes(size_t num_boxes);

  // Calls `visit` with the index of every box that meets `query`, in an order that depends on the boxes only. Each node
  // visited takes one from `budget`. Returns false if the budget ended first.
  template <typename Visit>  // void(uint32_t)
  bool VisitMeeting(const Eigen::AlignedBox3f& query, size_t& budget, const Visit& visit) const;

 private:
  struct Node {
    Eigen::AlignedBox3f box;
    uint32_t first = 0;  // leaf: first index in `order_`; else: right child (the left one follows its parent)
    uint32_t count = 0;  // leaf: number of boxes; else 0
  };
  // Halving 2^32 boxes gives 32 levels, and the stack has at most one sibling of each.
  static constexpr int kMaxDepth = 40;

  // Appends the tree of order_[begin, end) and reorders this range.
  void Build(absl::Span<const Eigen::AlignedBox3f> boxes, size_t begin, size_t end);

  std::vector<Eigen::AlignedBox3f> boxes_;  // in leaf order
  std::vector<uint32_t> order_;             // indices of the boxes in leaf order
  std::vector<Node> nodes_;                 // depth first
};

template <typename Visit>
bool BoxTree::VisitMeeting(const Eigen::AlignedBox3f& query, size_t& budget, const Visit& visit) const {
  if (nodes_.empty()) return true;
  std::array<uint32_t, kMaxDepth> waiting;
  int waiting_count = 0;
  uint32_t current = 0;
  while (true) {
    if (budget == 0) return false;
    --budget;
    const Node& node = nodes_[current];
    if (node.box.intersects(query)) {
      if (node.count == 0) {
        waiting[waiting_count++] = node.first;
        ++current;
        continue;
      }
      for (uint32_t i = node.first; i < node.first + node.count; ++i) {
        if (boxes_[i].intersects(query)) visit(order_[i]);
      }
    }
    if (waiting_count == 0) return true;
    current = waiting[--waiting_count];
  }
}

}  // namespace evpose
