// SPDX-License-Identifier: Apache-2.0

// Slow work on a thread beside that of a test, which can tell that the work waits for a lock.
#pragma once

#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <future>
#include <memory>
#include <utility>

#include "server/runtime/slow_executor.h"

namespace evpose::server {

class SlowWorkBeside {
 public:
  SlowWorkBeside() = default;
  ~SlowWorkBeside() { Join(); }
  SlowWorkBeside(const SlowWorkBeside&) = delete;
  SlowWorkBeside& operator=(const SlowWorkBeside&) = delete;

  // Begins `work`, and returns when it has ended or waits for a lock of KeyedMutexes. To be called once.
  void BeginUntilItWaits(std::function<void()> work,
                         std::shared_ptr<Cancellation> cancellation = std::make_shared<Cancellation>()) {
    slow_.Post(
        "tenant", [work = std::move(work)](const absl::Status&) { work(); }, std::move(cancellation));
    // The item of another tenant begins when the first one has ended or has left its place to wait.
    const auto has_place = std::make_shared<std::promise<void>>();
    slow_.Post("another tenant", [has_place](const absl::Status&) { has_place->set_value(); });
    has_place->get_future().wait();
  }
  // Returns when the work has ended.
  void Join() { threads_.join(); }

 private:
  boost::asio::thread_pool threads_{2};
  SlowExecutor slow_{threads_.get_executor(), {.running = 1, .long_items = 1}};
};

}  // namespace evpose::server
