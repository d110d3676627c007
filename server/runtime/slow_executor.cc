// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/slow_executor.h"

#include <sys/resource.h>

#include <algorithm>
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
  if (place_ != Place::kRunning) return;
  const auto now = std::chrono::steady_clock::now();
  if (now < long_at_) return;
  LeavePlace();
  long_at_ = now + kLongItem;
}

void SlowExecutor::RunningItem::LeavePlace() {
  if (place_ == Place::kRunning && executor_.LeavePlace()) place_ = Place::kLong;
}

void SlowExecutor::Post(const std::string& tenant, Work work, std::shared_ptr<Cancellation> cancellation,
                        Overlap overlap) {
  const std::lock_guard lock(mutex_);
  Item item = {std::move(work), std::move(cancellation), overlap};
  if (is_stopped_) return Reject(std::move(item.work));
  Queue& queue = queues_[tenant];
  if (queue.waiting.empty() && queue.running.empty()) queue.turn = ++last_turn_;
  queue.waiting.push_back(std::move(item));
  queue.num_overlapping += Overlaps(queue.waiting.back());
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
    for (Item& item : queue.running) {
      item.cancellation->CancelByServer();
      if (item.work != nullptr) Reject(std::exchange(item.work, nullptr));  // no thread has begun it
    }
    for (Item& item : queue.waiting) Reject(std::move(item.work));
    queue.waiting.clear();
    queue.num_overlapping = 0;
  }
}

SlowExecutor::Items::iterator SlowExecutor::FirstOverlapping(Queue& queue) {
  return std::find_if(queue.waiting.begin(), queue.waiting.end(), Overlaps);
}

SlowExecutor::Queues::iterator SlowExecutor::FindNext(absl::FunctionRef<bool(Queue&)> has_item) {
  auto next = queues_.end();
  for (auto queue = queues_.begin(); queue != queues_.end(); ++queue) {
    if (!has_item(queue->second)) continue;
    if (next == queues_.end() || queue->second.turn < next->second.turn) next = queue;
  }
  return next;
}

SlowExecutor::Queues::iterator SlowExecutor::FindNextOverlapping() {
  // The number is kept, because a tenant may have thousands of waiting items, and each Dispatch() visits all queues.
  const auto overlaps = [](Queue& queue) { return queue.num_overlapping > 0; };
  const auto has_none_running = [](Queue& queue) { return queue.running.empty() && !queue.waiting.empty(); };
  // A tenant without a running item is first. While there is one, no other tenant gets a further item.
  const auto next = FindNext([&](Queue& queue) { return has_none_running(queue) && overlaps(queue); });
  if (next != queues_.end() || FindNext(has_none_running) != queues_.end()) return next;
  return FindNext(overlaps);
}

void SlowExecutor::Dispatch() {
  while (used_.running < places_.running) {
    const auto next = FindNext([](Queue& queue) { return !queue.has_thread && !queue.waiting.empty(); });
    if (next == queues_.end()) break;
    if (!Start(next, next->second.waiting.begin(), Place::kRunning)) return;
  }
  while (used_.overlapping < places_.overlapping) {
    const auto next = FindNextOverlapping();
    if (next == queues_.end()) return;
    if (!Start(next, FirstOverlapping(next->second), Place::kOverlapping)) return;
  }
}

bool SlowExecutor::Start(Queues::iterator queue, Items::iterator item, Place place) {
  const absl::Status posted = OrOutOfMemory([this, queue, item, place] {
    boost::asio::post(threads_, [this, queue, item, place] { Run(queue, item, place); });
    return absl::OkStatus();
  });
  if (!posted.ok()) return false;
  queue->second.num_overlapping -= Overlaps(*item);
  queue->second.running.splice(queue->second.running.end(), queue->second.waiting, item);
  queue->second.has_thread |= place == Place::kRunning;
  queue->second.turn = ++last_turn_;
  ++NumIn(place);
  return true;
}

int& SlowExecutor::NumIn(Place place) {
  if (place == Place::kRunning) return used_.running;
  return place == Place::kLong ? used_.long_items : used_.overlapping;
}

SlowExecutor::Work SlowExecutor::TakeWork(Items::iterator item) {
  const std::lock_guard lock(mutex_);
  return std::exchange(item->work, nullptr);
}

absl::Status SlowExecutor::Admission(const Item& item) {
  const std::lock_guard lock(mutex_);
  return is_stopped_ ? HasStopped() : item.cancellation->status();
}

bool SlowExecutor::LeavePlace() {
  const std::lock_guard lock(mutex_);
  if (used_.long_items == places_.long_items) return false;
  ++used_.long_items;
  --used_.running;
  Dispatch();
  return true;
}

void SlowExecutor::Run(Queues::iterator queue, Items::iterator item, Place place) {
  setpriority(PRIO_PROCESS, 0, kNice);  // the priority of this thread; raising the number is always permitted
  Place last_place = place;
  if (Work work = TakeWork(item); work != nullptr) {
    const RunningItem running(*this, item->cancellation, place);
    RunUnlessOutOfMemory([this, &work, item] { work(Admission(*item)); });
    last_place = running.place();
  }  // what the work holds is released before the next item of the tenant
  const std::lock_guard lock(mutex_);
  --NumIn(last_place);
  queue->second.running.erase(item);
  if (place == Place::kRunning) queue->second.has_thread = false;
  queue->second.turn = ++last_turn_;
  if (queue->second.waiting.empty() && queue->second.running.empty()) queues_.erase(queue);
  Dispatch();
}

// Calls the work on a thread of the executor, because the caller of Post() or Stop() may hold a lock that the work
// takes.
void SlowExecutor::Reject(Work work) {
  boost::asio::post(threads_,
                    [work = std::move(work)]() mutable { RunUnlessOutOfMemory([&work] { work(HasStopped()); }); });
}

}  // namespace evpose::server
