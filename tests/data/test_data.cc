// SPDX-License-Identifier: Apache-2.0

#include "tests/data/test_data.h"

#include <filesystem>

namespace evpose {

std::string FindTestData(const std::string& name) {
  for (const char* folder : {EVPOSE_TEST_DATA, EVPOSE_SHARED_DATA}) {
    const std::filesystem::path path = std::filesystem::path(folder) / name;
    if (std::filesystem::exists(path)) return path.string();
  }
  return "";
}

}  // namespace evpose
