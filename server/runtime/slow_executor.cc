// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/slow_executor.h"

#include <sys/resource.h>

#include <boost/asio/post.hpp>

#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

// The queue of the server's own work. No tenant has this name, because names contain no line feed.
constexpr char kOwnQueue[] = "\n";

// The priority of the threads, and of the processes that they start: while the workers need all cores, slow work gets
// about a quarter of a core for each of its threads, so that it delays poses little and is not starved.
constexpr int kNice = 5;

absl::Status HasStopped() { return WithReason(absl::UnavailableError("the server has shut down"), v1::DRAINING); }

}  // namespace

absl::Status Cancellation::status() const {
  switch (cause_) {
    case Cause::kNone:
      return absl::OkStatus();
    case Cause::kCaller:
      return absl::CancelledError("the call was cancelled");
    case Cause::kServer:
      break;
  }
  return HasStopped();
}

const Cancellation& SlowExecutor::Running() {
  static const Cancellation none;
  return running_ == nullptr ? none : running_->cancellation();
}

void SlowExecutor::RunningItem::Yield() {
  if (cancellation_->is_cancelled()) throw Ended();
  if (has_left_place_) return;
  const auto now = std::chrono::steady_clock::now();
  if (now < long_at_) return;
  has_left_place_ = executor_.LeavePlace();
  long_at_ = now + kLongItem;
}

void SlowExecutor::Post(const std::string& tenant, Work work, std::shared_ptr<Cancellation> cancellation) {
  const std::lock_guard lock(mutex_);
  Item item = {std::move(work), std::move(cancellation)};
  if (is_stopped_) return Reject(std::move(item));
  Queue& queue = queues_[tenant];
  if (queue.waiting.empty() && !queue.has_thread) queue.turn = ++last_turn_;
  queue.waiting.push_back(std::move(item));
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
  for (auto& [tenant, queue] : queues_) {
    if (queue.running != nullptr) queue.running->CancelByServer();
    for (Item& item : queue.waiting) Reject(std::move(item));
    queue.waiting.clear();
  }
}

SlowExecutor::Queues::iterator SlowExecutor::FindNext() {
  auto next = queues_.end();
  for (auto queue = queues_.begin(); queue != queues_.end(); ++queue) {
    if (queue->second.has_thread || queue->second.waiting.empty()) continue;
    if (next == queues_.end() || queue->second.turn < next->second.turn) next = queue;
  }
  return next;
}

void SlowExecutor::Dispatch() {
  while (num_running_ < max_running_) {
    const auto next = FindNext();
    if (next == queues_.end()) return;
    const absl::Status posted = OrOutOfMemory([this, next] {
      boost::asio::post(threads_, [this, next] { Run(next); });
      return absl::OkStatus();
    });
    if (!posted.ok()) return;
    next->second.has_thread = true;
    ++num_running_;
  }
}

SlowExecutor::Item SlowExecutor::TakeItem(Queues::iterator queue) {
  const std::lock_guard lock(mutex_);
  std::deque<Item>& waiting = queue->second.waiting;
  if (waiting.empty()) return {};
  Item item = std::move(waiting.front());
  waiting.pop_front();
  queue->second.running = item.cancellation;
  return item;
}

absl::Status SlowExecutor::Admission(const Item& item) {
  const std::lock_guard lock(mutex_);
  return is_stopped_ ? HasStopped() : item.cancellation->status();
}

bool SlowExecutor::LeavePlace() {
  const std::lock_guard lock(mutex_);
  if (num_long_ == max_long_) return false;
  ++num_long_;
  --num_running_;
  Dispatch();
  return true;
}

void SlowExecutor::Run(Queues::iterator queue) {
  setpriority(PRIO_PROCESS, 0, kNice);  // the priority of this thread; raising the number is always permitted
  bool has_left_place = false;
  if (Item item = TakeItem(queue); item.work != nullptr) {
    const RunningItem running(*this, item.cancellation);
    RunUnlessOutOfMemory([this, &item] { item.work(Admission(item)); });
    has_left_place = running.has_left_place();
  }  // what the work holds is released before the next item of the tenant
  const std::lock_guard lock(mutex_);
  --(has_left_place ? num_long_ : num_running_);
  queue->second.running.reset();
  queue->second.has_thread = false;
  queue->second.turn = ++last_turn_;
  if (queue->second.waiting.empty()) queues_.erase(queue);
  Dispatch();
}

// Calls the work on a thread of the executor, because the caller of Post() or Stop() may hold a lock that the work
// takes.
void SlowExecutor::Reject(Item item) {
  boost::asio::post(threads_,
                    [work = std::move(item.work)]() mutable { RunUnlessOutOfMemory([&work] { work(HasStopped()); }); });
}

}  // namespace evpose::server
