// SPDX-License-Identifier: Apache-2.0

#pragma once

#include <string>

namespace evpose {

// Returns the path of a file or folder of test data: in tests/data or else in the folder EVPOSE_SHARED_DATA of CMake.
// Empty if neither has it; then a test skips data that cannot be in the project because of licence or size.
std::string FindTestData(const std::string& name);

}  // namespace evpose
