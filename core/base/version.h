// SPDX-License-Identifier: Apache-2.0

// The version of this build, for --version and the server's information.
#pragma once

#include <string>

namespace evpose {

struct BuildVersion {
  std::string version;  // MAJOR.MINOR.PATCH
  std::string commit;   // short hash; "unknown" for a build outside a repository
};

BuildVersion ThisBuild();

// "PROGRAM VERSION (COMMIT)", the output of --version.
std::string VersionLine(const std::string& program);

}  // namespace evpose
