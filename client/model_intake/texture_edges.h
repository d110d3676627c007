// SPDX-License-Identifier: Apache-2.0

// Edges of an image, to a fraction of a pixel (client/model_intake/README.md, section 2).
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "absl/status/status.h"

namespace evpose::client {

struct TextureEdge {
  // Pixels, at least two; (0, 0) is the centre of the first pixel. A ring ends with its first point.
  std::vector<Eigen::Vector2d> points;
  double contrast = 0.0;  // mean change of the natural logarithm of light across the edge
};

struct TextureEdgeOptions {
  // Weaker edges cause few events: sensors have thresholds of 0.15 to 0.35.
  double min_contrast = 0.3;
  // Standard deviation, pixels, of the smoothing: the least at which the position of an edge has no bias by the grid.
  double smoothing_px = 1.0;
  // Shorter edges are noise, letters and the grain of photographs.
  double min_length_px = 12.0;
  // Largest distance, pixels, between an edge and the chords that replace it.
  double max_deviation_px = 0.5;

  absl::Status Validate() const;
};

// The edges of a grey 8-bit image at the pixels where `mask` (8 bits, the same size) is not 0. The first pixels along
// the boundary of the image have none. `options` must be valid.
std::vector<TextureEdge> FindTextureEdges(const cv::Mat& grey, const cv::Mat& mask,
                                          const TextureEdgeOptions& options = {});

}  // namespace evpose::client
