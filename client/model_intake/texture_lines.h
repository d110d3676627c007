// SPDX-License-Identifier: Apache-2.0

// Painted lines from the images on a mesh.
#pragma once

#include <cstddef>

#include "absl/status/status.h"
#include "client/model_intake/scene_reader.h"
#include "client/model_intake/texture_edges.h"

namespace evpose::client {

struct TextureLineOptions {
  // Largest number of painted lines of a model. The images of a carton with labels have some hundred lines. Those of a
  // photograph can have more than this number; then the strongest lines are kept.
  size_t max_lines = 2000;
  // Edges that are shorter on the object, relative to the diagonal of its bounding box: 3 px at a size of 300 px.
  double min_length_ratio = 0.01;
  TextureEdgeOptions edges;

  absl::Status Validate() const;
};

// Appends the edges of the images to `scene.mesh.lines`: those with the largest product of length and contrast. A
// notice says how many were found. Error: INVALID_ARGUMENT for invalid options or an image that OpenCV cannot process.
absl::Status AddTextureLines(Scene& scene, const TextureLineOptions& options = {});

}  // namespace evpose::client
