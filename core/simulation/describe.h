// SPDX-License-Identifier: Apache-2.0

// A simulation's options as text: what tells whether a recording is that of the same simulation.
#pragma once

#include <string>

#include "core/simulation/simulator.h"

namespace evpose {

// Every option on a line of its own, "scene.motion.depth_m 1", numbers with all their digits: equal texts, equal
// options.
std::string DescribeSimulation(const SimulationOptions& options);

}  // namespace evpose
