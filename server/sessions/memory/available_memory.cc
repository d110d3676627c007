// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/memory/available_memory.h"

#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace evpose::server {
namespace {

// The limit in a file of a control group; no limit if there is no such file, or it says "max".
uint64_t ReadLimit(const std::filesystem::path& file) {
  std::string text;
  std::ifstream(file) >> text;
  uint64_t limit = 0;
  return absl::SimpleAtoi(text, &limit) ? limit : UINT64_MAX;
}

// Path of the process's control group for memory, from a line such as "0::/system.slice/evpose.service" or
// "4:memory:/docker/x".
std::string MemoryGroupOf(const std::string& root) {
  std::ifstream file(root + "/proc/self/cgroup");
  std::string line;
  std::string group = "/";
  while (std::getline(file, line)) {
    const size_t first = line.find(':');
    const size_t second = line.find(':', first + 1);
    if (first == std::string::npos || second == std::string::npos) continue;
    const absl::string_view controllers = absl::string_view(line).substr(first + 1, second - first - 1);
    if (controllers.empty() || absl::StrContains(controllers, "memory")) group = line.substr(second + 1);
    if (!controllers.empty() && absl::StrContains(controllers, "memory")) break;
  }
  return group;
}

}  // namespace

uint64_t AvailableMemoryBytes(const std::string& root) {
  uint64_t bytes = static_cast<uint64_t>(sysconf(_SC_PHYS_PAGES)) * static_cast<uint64_t>(sysconf(_SC_PAGE_SIZE));
  const std::string base = root + "/sys/fs/cgroup";
  // In a container the path may be that outside it: the groups that are not visible are skipped.
  for (std::filesystem::path group = MemoryGroupOf(root);; group = group.parent_path()) {
    const std::string path = group == "/" ? "" : group.string();
    bytes = std::min({bytes, ReadLimit(absl::StrCat(base, path, "/memory.max")),
                      ReadLimit(absl::StrCat(base, "/memory", path, "/memory.limit_in_bytes"))});
    if (!group.has_relative_path()) return bytes;
  }
}

}  // namespace evpose::server
