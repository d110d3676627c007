// SPDX-License-Identifier: Apache-2.0

// Distances to the nearest edge of a direction, in a part of the image (core/initialization/templates/README.md,
// section 2).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/initialization/templates/event_edges.h"
#include "core/initialization/templates/orientation.h"

namespace evpose {

// A rectangle in undistorted pixels.
struct ImageBox {
  Eigen::Vector2d low_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d high_px = Eigen::Vector2d::Zero();

  Eigen::Vector2d size_px() const { return high_px - low_px; }
};

// The edge points of one cell and direction: means.
struct MapEdge {
  Eigen::Vector2f at = Eigen::Vector2f::Zero();    // in cells: the centre of the first cell is (0, 0)
  Eigen::Vector2f flow = Eigen::Vector2f::Zero();  // cells per second
  float weight = 0.0f;
  uint8_t bin = 0;
};

// Immutable after construction.
class EdgeDistanceMap {
 public:
  // Largest distance, cells, that is distinguished; farther away is as bad as no edge. Ten cells are a twelfth of the
  // box, about the error of a template halfway between two views. With a larger reach edges of other parts attract a
  // template.
  static constexpr int kReach = 10;
  // Cells along the longer side of the box; the map has a margin of a quarter of it on each side. Memory and time of a
  // map grow with the square of this number; larger cells hide differences between similar views.
  static constexpr int kCellsOfBox = 120;
  static constexpr uint16_t kNoEdge = 0xffff;

  EdgeDistanceMap(absl::Span<const EventEdgePoint> points, const ImageBox& box);

  int width() const { return width_; }
  int height() const { return height_; }
  double cell_px() const { return cell_px_; }
  const ImageBox& box() const { return box_; }
  Eigen::Vector2d ToCells(const Eigen::Vector2d& at_px) const { return (at_px - origin_px_) / cell_px_; }
  // The camera whose pixels are the cells. Its image is the map.
  CameraModel CameraOf(const CameraModel& camera) const;

  const std::vector<MapEdge>& edges() const { return edges_; }
  double edge_weight() const { return edge_weight_; }  // sum over the edges

  // Returns 255 in the cell of an edge with a direction in the bin or in a neighbouring one, and less in cells farther
  // from the nearest such edge: 0 from kReach on, and outside the map.
  int Nearness(int bin, int x, int y) const { return IsInside(x, y) ? nearness_[bin][Place(x, y)] : 0; }
  // Index into edges() of this edge, or kNoEdge.
  uint16_t Nearest(int bin, int x, int y) const { return IsInside(x, y) ? nearest_[bin][Place(x, y)] : kNoEdge; }
  bool IsInside(int x, int y) const { return x >= 0 && y >= 0 && x < width_ && y < height_; }
  size_t Place(int x, int y) const { return static_cast<size_t>(y) * width_ + x; }

 private:
  void CollectEdges(absl::Span<const EventEdgePoint> points);
  void FillDistances();

  const ImageBox box_;
  double cell_px_ = 1.0;
  Eigen::Vector2d origin_px_ = Eigen::Vector2d::Zero();  // centre of the first cell
  int width_ = 0;
  int height_ = 0;
  std::vector<MapEdge> edges_;
  double edge_weight_ = 0.0;
  std::array<std::vector<uint8_t>, kOrientationBins> nearness_;
  std::array<std::vector<uint16_t>, kOrientationBins> nearest_;
};

}  // namespace evpose
