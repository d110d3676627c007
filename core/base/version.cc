// SPDX-License-Identifier: Apache-2.0
#include "core/base/version.h"

#include "absl/strings/str_cat.h"

namespace evpose {

BuildVersion ThisBuild() { return {EVPOSE_VERSION, EVPOSE_COMMIT_OF_BUILD}; }

std::string VersionLine(const std::string& program) {
  const BuildVersion build = ThisBuild();
  return absl::StrCat(program, " ", build.version, " (", build.commit, ")");
}

}  // namespace evpose
