// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/slow_executor.h"

#include <sys/resource.h>

#include <boost/asio/post.hpp>

#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

// The queue of the server's own work. No tenant has this name, because names contain no line feed.
constexpr char kOwnQueue[] = "\n";

// The priority of the threads, and of the processes that they start: while the workers need all cores, slow work gets
// about a quarter of a core for each of its threads, so that it delays poses little and is not starved.
constexpr int kNice = 5;

absl::Status HasStopped() { return WithReason(absl::UnavailableError("the server has shut down"), v1::DRAINING); }

}  // namespace

void SlowExecutor::Post(const std::string& tenant, Work work, std::shared_ptr<Cancellation> cancellation) {
  const std::lock_guard lock(mutex_);
  Item item = {std::move(work), std::move(cancellation)};
  if (is_stopped_) return Reject(std::move(item));
  std::deque<Item>& queue = queues_[tenant];
  queue.push_back(std::move(item));
  if (queue.size() == 1 && !running_.contains(tenant)) turns_.push_back(tenant);
  Dispatch();
}

void SlowExecutor::PostOwn(absl::AnyInvocable<void()> work) {
  Post(kOwnQueue, [work = std::move(work)](const absl::Status& admitted) mutable {
    if (admitted.ok()) work();
  });
}

void SlowExecutor::Stop() {
  const std::lock_guard lock(mutex_);
  is_stopped_ = true;
  for (const auto& [tenant, cancellation] : running_) cancellation->Cancel();
  for (auto& [tenant, queue] : queues_) {
    for (Item& item : queue) Reject(std::move(item));
  }
  queues_.clear();
  turns_.clear();
}

void SlowExecutor::Dispatch() {
  while (!turns_.empty() && running_.size() < max_running_) {
    const std::string tenant = std::move(turns_.front());
    turns_.pop_front();
    const auto queue = queues_.find(tenant);
    Item item = std::move(queue->second.front());
    queue->second.pop_front();
    if (queue->second.empty()) queues_.erase(queue);
    running_[tenant] = item.cancellation;
    boost::asio::post(threads_, [this, tenant, item = std::move(item)]() mutable { Run(tenant, std::move(item)); });
  }
}

absl::Status SlowExecutor::Admission(const Item& item) {
  const std::lock_guard lock(mutex_);
  if (is_stopped_) return HasStopped();
  return item.cancellation->is_cancelled() ? absl::CancelledError("the call was cancelled") : absl::OkStatus();
}

void SlowExecutor::Run(const std::string& tenant, Item item) {
  setpriority(PRIO_PROCESS, 0, kNice);  // the priority of this thread; raising the number is always permitted
  RunUnlessOutOfMemory([this, &item] { item.work(Admission(item)); });
  item = {};  // what the work holds is released before the next item of the tenant
  const std::lock_guard lock(mutex_);
  running_.erase(tenant);
  if (queues_.contains(tenant)) turns_.push_back(tenant);
  Dispatch();
}

// On a thread of the executor, because the caller of Post() or Stop() may hold a lock that the work takes.
void SlowExecutor::Reject(Item item) {
  boost::asio::post(threads_,
                    [work = std::move(item.work)]() mutable { RunUnlessOutOfMemory([&work] { work(HasStopped()); }); });
}

}  // namespace evpose::server
