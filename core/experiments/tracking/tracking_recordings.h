// SPDX-License-Identifier: Apache-2.0

// Events of a simulation, generated for each run or stored in a directory and read again.
#pragma once

#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/simulation/simulator.h"

namespace evpose {

using EventConsumer = std::function<absl::Status(absl::Span<const Event>)>;

// Passes the events of a run to `on_events` in order of time. With a `directory` they are read from its recording
// (recording.raw, truth.tum, model.obj, camera.yaml, and simulation.txt, which describes the simulation and the number
// of events). If the directory has no recording, or one of another simulation, it is simulated first; `on_simulated` is
// called with the finished share, in [0, 1], and ends it with CANCELLED by returning false. Errors: those of
// `on_events` and of SimulateToDirectory(); DATA_LOSS naming the directory if a recording is incomplete.
absl::Status PlayRun(const SimulationOptions& run, const std::string& directory, const EventConsumer& on_events,
                     const std::function<bool(double)>& on_simulated = nullptr);

}  // namespace evpose
