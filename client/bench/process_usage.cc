// SPDX-License-Identifier: Apache-2.0
#include "client/bench/process_usage.h"

#include <ctime>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/experiments/speed/measured_time.h"

namespace evpose::client {
namespace {

absl::Status NoSuchProcess(pid_t pid) { return absl::NotFoundError(absl::StrCat("there is no process ", pid)); }

}  // namespace

absl::StatusOr<double> ProcessorSeconds(pid_t pid) {
  clockid_t clock = {};
  if (clock_getcpuclockid(pid, &clock) != 0) return NoSuchProcess(pid);
  return SecondsOfClock(clock);
}

absl::StatusOr<ProcessMemory> MemoryOf(pid_t pid) {
  constexpr double kMbPerKb = 1.0 / 1024.0;
  std::ifstream status(absl::StrCat("/proc/", pid, "/status"));
  ProcessMemory memory;
  for (std::string name; status >> name; std::getline(status, name)) {
    double* const value_mb = name == "VmRSS:" ? &memory.resident_mb : name == "VmHWM:" ? &memory.peak_mb : nullptr;
    if (value_mb == nullptr) continue;
    status >> *value_mb;
    *value_mb *= kMbPerKb;
  }
  if (!(memory.resident_mb > 0.0)) return NoSuchProcess(pid);
  return memory;
}

}  // namespace evpose::client
