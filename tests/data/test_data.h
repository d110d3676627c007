// SPDX-License-Identifier: Apache-2.0

#pragma once

#include <string>

namespace evpose {

// The path of a file or folder of test data: in tests/data or, when it is not there, in the folder EVPOSE_SHARED_DATA
// that CMake was given. Empty when neither has it; a test of data whose licence or size allows no copy in the project
// is then skipped.
std::string FindTestData(const std::string& name);

}  // namespace evpose
