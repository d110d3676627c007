// SPDX-License-Identifier: Apache-2.0

// evpose-prepare-model: prepares one model for evpose-server within a budget (server/models/model_preparer.h). A server
// starts it for each uploaded model; it is not meant to be called by users.
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <fstream>
#include <iostream>
#include <memory>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "core/base/sanitized.h"
#include "core/initialization/search_views.h"
#include "core/models/object_model.h"
#include "server/models/mesh_message.h"
#include "server/models/model_preparer.h"
#include "server/models/prepared_model.h"
#include "server/runtime/enum_number.h"

namespace evpose::server {
namespace {

constexpr int kUsage = 2;
constexpr int kNiceness = 5;  // a third of the weight of a thread that tracks

struct Arguments {
  uint32_t format = 0;
  ModelOptions options;
  uint64_t cpu_seconds = 0;
  uint64_t memory_bytes = 0;
};

bool Parse(int argc, char** argv, Arguments& arguments) {
  return argc == 8 && absl::SimpleAtoi(argv[1], &arguments.format) &&
         absl::SimpleAtod(argv[2], &arguments.options.metres_per_unit) &&
         absl::SimpleAtod(argv[3], &arguments.options.crease_angle_deg) &&
         absl::SimpleAtob(argv[4], &arguments.options.is_smooth) &&
         absl::SimpleAtoi(argv[5], &arguments.options.max_bytes) && absl::SimpleAtoi(argv[6], &arguments.cpu_seconds) &&
         absl::SimpleAtoi(argv[7], &arguments.memory_bytes);
}

void SetLimit(__rlimit_resource resource, uint64_t soft, uint64_t hard) {
  const rlimit limit = {.rlim_cur = soft, .rlim_max = hard};
  setrlimit(resource, &limit);
}

// Seconds of processor time for the model and for the views, rounded up, and one more: at the hard limit, the kernel
// would kill the process as if the machine had no memory left.
uint64_t HardLimit(const Arguments& arguments) { return 2 * arguments.cpu_seconds + 3; }

// Limits the process: the kernel kills it when the server ends, and before the server when memory is short. Tracking
// has a higher priority, and the budget bounds processor time and memory.
void Limit(const Arguments& arguments) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  std::ofstream("/proc/self/oom_score_adj") << "1000";
  setpriority(PRIO_PROCESS, 0, kNiceness);
  SetLimit(RLIMIT_CORE, 0, 0);
  SetLimit(RLIMIT_CPU, arguments.cpu_seconds, HardLimit(arguments));
#ifndef EVPOSE_SANITIZED
  SetLimit(RLIMIT_AS, arguments.memory_bytes, arguments.memory_bytes);
#endif
}

// Gives the process the budget of processor time once more, from now on.
void RenewProcessorTime(const Arguments& arguments) {
  rusage used = {};
  getrusage(RUSAGE_SELF, &used);
  const auto used_s = static_cast<uint64_t>(used.ru_utime.tv_sec + used.ru_stime.tv_sec) + 1;
  SetLimit(RLIMIT_CPU, used_s + arguments.cpu_seconds, HardLimit(arguments));
}

std::vector<uint8_t> ReadInput() {
  constexpr size_t kPieceBytes = 1u << 20;  // the largest model is read in some 64 calls
  std::vector<uint8_t> bytes;
  size_t size = 0;
  for (ssize_t count = 1; count > 0; size += static_cast<size_t>(std::max<ssize_t>(count, 0))) {
    bytes.resize(size + kPieceBytes);
    count = read(STDIN_FILENO, bytes.data() + size, kPieceBytes);
  }
  bytes.resize(size);
  return bytes;
}

int Prepare(const Arguments& arguments) {
  absl::StatusOr<ObjectModel> model =
      ParseModelFile(ReadInput(), EnumValue<ModelFormat>(arguments.format), arguments.options,
                     [](absl::string_view step) { std::cout << kPreparationStep << step << std::endl; });
  if (!model.ok()) {
    std::cout << kPreparationError << model.status().message();
    return std::cout.flush() ? 0 : 1;
  }
  {
    const std::string encoded = EncodePreparedModel(*model);
    std::cout << kPreparationModel << encoded.size() << '\n' << encoded << std::flush;
  }
  RenewProcessorTime(arguments);
  const SearchViews views = MakeSearchViews(std::make_shared<const ObjectModel>(*std::move(model)));
  std::cout << EncodePreparedViews(views);
  return std::cout.flush() ? 0 : 1;
}

}  // namespace
}  // namespace evpose::server

int main(int argc, char** argv) {
  evpose::server::Arguments arguments;
  if (!evpose::server::Parse(argc, argv, arguments)) {
    std::cerr << "evpose-prepare-model: is started by evpose-server only" << std::endl;
    return evpose::server::kUsage;
  }
  try {
    evpose::server::Limit(arguments);
    return evpose::server::Prepare(arguments);
  } catch (const std::bad_alloc&) {
    return evpose::server::kPreparationOutOfMemory;
  }
}
