// SPDX-License-Identifier: Apache-2.0

// Mean displacement of the events of an edge, beside clutter.
#pragma once

#include "absl/types/span.h"
#include "core/numerics/robust.h"

namespace evpose {

struct EventDisplacement {
  double mean_px = 0.0;
  double spread_px = 0.0;   // standard deviation about the mean
  double num_events = 0.0;  // without clutter; 0 if no event belongs to the edge
};

// Returns the component of the edge in a mixture with uniform clutter (core/estimation/README.md, section 1) of signed
// distances within +- gate_px, estimated as in the tracker. The iteration starts at `start_px`. With `companions_px`,
// the edge is several parallel ones with equally many events: at 0 and at these distances, displaced together; gate_px
// is then half of the width in which there are events.
EventDisplacement FitDisplacement(absl::Span<const double> distances_px, double gate_px, double start_px,
                                  const ExpTable& table, absl::Span<const double> companions_px = {});

}  // namespace evpose
