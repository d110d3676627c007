// SPDX-License-Identifier: Apache-2.0

// The options of a simulation as text. Recordings with equal texts are from the same simulation.
#pragma once

#include <string>

#include "core/simulation/simulator.h"

namespace evpose {

// Returns one line for each option, as in "scene.motion.depth_m 1", with all digits of a number. The texts of two
// simulations are equal if and only if their options are.
std::string DescribeSimulation(const SimulationOptions& options);

}  // namespace evpose
