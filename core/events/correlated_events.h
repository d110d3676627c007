// SPDX-License-Identifier: Apache-2.0

// How many events of an edge count as one independent measurement.
#pragma once

namespace evpose {

// Number of events that counts as one independent event where the events of an edge are not displaced to their expected
// positions (core/estimation/README.md, section 3). An edge that passes a pixel causes several events, and those of
// neighbouring pixels have the same displacement. Distances of the events of one edge are therefore correlated, and
// their number overstates what they determine. The mixture, which corrects the displacement, has an option of its own
// (MixtureOptions::events_per_information).
inline constexpr double kCorrelatedEvents = 20.0;

}  // namespace evpose
