// SPDX-License-Identifier: Apache-2.0

// Whether the edges of a model determine a pose.
#pragma once

#include "absl/status/status.h"
#include "core/models/object_model.h"

namespace evpose {

// Error: INVALID_ARGUMENT if the model's lines determine no pose: fewer than three lines (collinear pieces count as
// one), all parallel, or all through one point.
absl::Status CheckLinesDeterminePose(const ObjectModel& model);

// Whether a search for lines can find the pose of the model: whether its straight lines determine one. A model with
// curved edges is found by its contours all the same (core/initialization/templates).
inline bool IsSearchable(const ObjectModel& model) { return CheckLinesDeterminePose(model).ok(); }
// Whether the model has edges beside its straight lines: curves, or curved surfaces or facets, which have contours.
inline bool HasCurvedEdges(const ObjectModel& model) {
  return !model.curves.empty() || !model.surface.empty() || !model.facet_edges.empty();
}
// OK if the model can be tracked; else the error of CheckLinesDeterminePose().
inline absl::Status CheckIsTrackable(const ObjectModel& model) {
  return HasCurvedEdges(model) ? absl::OkStatus() : CheckLinesDeterminePose(model);
}

}  // namespace evpose
