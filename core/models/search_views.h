// SPDX-License-Identifier: Apache-2.0

// The views of a model from all sides, which the searches for a first pose compute with many rays. They are a function
// of the model and may be stored with it (core/initialization/README.md, section 7).
#pragma once

#include <Eigen/Core>
#include <vector>

namespace evpose {

// A point on a visible edge. A point on a contour moves in the image, to first order, like one that is fixed to the
// object (core/contours/README.md, section 1).
struct EdgeSample {
  Eigen::Vector3d point;  // object frame, metres
  Eigen::Vector3d along;  // from the point along the edge, object frame: half the distance of neighbouring samples
  float prior_contrast = 1.0f;  // EdgeElement::prior_contrast

  friend bool operator==(const EdgeSample&, const EdgeSample&) = default;
};

// A line in a view: the part that may be visible, and the length that is visible from every direction of the view's
// cell.
struct ViewLine {
  int line = 0;  // index into SearchModel::lines
  double begin = 0.0, end = 1.0;
  double certain_ratio = 0.0;

  friend bool operator==(const ViewLine&, const ViewLine&) = default;
};

// Lists with one element for each view. A list is empty if the search that needs it cannot find the model.
struct SearchViews {
  using Templates = std::vector<std::vector<EdgeSample>>;
  using LineViews = std::vector<std::vector<ViewLine>>;

  Templates templates;  // views of TemplateModel
  LineViews lines;      // views of SearchModel
};

}  // namespace evpose
