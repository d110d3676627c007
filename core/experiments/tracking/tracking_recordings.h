// SPDX-License-Identifier: Apache-2.0

// The events of a simulation: made at once, or kept in a directory and read again.
#pragma once

#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/simulation/simulator.h"

namespace evpose {

using EventConsumer = std::function<absl::Status(absl::Span<const Event>)>;

// Hands the run's events over, in order of time. With a `directory` they are those of the recording in it
// (recording.raw, truth.tum, model.obj, camera.yaml, and simulation.txt, which says of which simulation it is and how
// many events there are). A recording of another simulation, or none, is replaced by a simulation first; `on_simulated`
// is told how much of that is done, [0, 1], false ends it with CANCELLED. Errors: those of `on_events` and
// SimulateToDirectory(); DATA_LOSS naming the directory when a recording is not whole.
absl::Status PlayRun(const SimulationOptions& run, const std::string& directory, const EventConsumer& on_events,
                     const std::function<bool(double)>& on_simulated = nullptr);

}  // namespace evpose
