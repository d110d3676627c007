// SPDX-License-Identifier: Apache-2.0
#include "server/program/thread_check.h"

#include <exception>
#include <future>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"

namespace evpose::server {

absl::Status CheckThreadsCanBeMade(int num_threads) {
  std::promise<void> end;
  const std::shared_future<void> ended = end.get_future().share();
  std::vector<std::thread> threads;
  threads.reserve(static_cast<size_t>(num_threads));
  std::string failure;
  try {
    for (int i = 0; i < num_threads; ++i) threads.emplace_back([ended] { ended.wait(); });
  } catch (const std::exception& error) {  // std::system_error or std::bad_alloc
    failure = error.what();
  }
  end.set_value();
  for (std::thread& thread : threads) thread.join();
  if (failure.empty()) return absl::OkStatus();
  return absl::ResourceExhaustedError(absl::StrCat(
      "only ", threads.size(), " of ", num_threads, " threads can be created (", failure,
      "): give fewer --workers, or raise the limit of address space or of processes (ulimit -v, ulimit -u, pids)"));
}

}  // namespace evpose::server
