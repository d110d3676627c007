// SPDX-License-Identifier: Apache-2.0

// What was built.
#pragma once

#include <string>

namespace evpose {

struct BuildVersion {
  std::string version;  // MAJOR.MINOR.PATCH
  std::string commit;   // short; "unknown" where it was built outside a repository
};

BuildVersion ThisBuild();

// "PROGRAM VERSION (COMMIT)", what --version prints.
std::string VersionLine(const std::string& program);

}  // namespace evpose
