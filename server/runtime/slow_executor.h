// SPDX-License-Identifier: Apache-2.0

// Fair execution of work that takes milliseconds to seconds, such as waiting for the store or preparing a model: no
// tenant delays another one by more than the rest of the items that are running, and an item that computes for long
// delays none.
#pragma once

#include <atomic>
#include <boost/asio/any_io_executor.hpp>
#include <chrono>
#include <cstdint>
#include <deque>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "core/base/yield_point.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {

// Tells work to end early. Thread-safe.
class Cancellation {
 public:
  void Cancel() { cause_ = Cause::kCaller; }          // for the call that wants the work
  void CancelByServer() { cause_ = Cause::kServer; }  // for SlowExecutor::Stop()
  bool is_cancelled() const { return cause_ != Cause::kNone; }
  // The status of work that has ended early: OK if it was not cancelled; CANCELLED; UNAVAILABLE (DRAINING).
  absl::Status status() const;

 private:
  enum class Cause { kNone, kCaller, kServer };
  std::atomic<Cause> cause_ = Cause::kNone;
};

// One queue for each tenant, which runs in order and one item at a time; the queues take turns. Because a tenant has at
// most one running item, it leaves the other threads to the other tenants. Thread-safe.
class SlowExecutor {
 public:
  // Is called exactly once, on a thread of the executor, unless the executor is destroyed before. `admitted`:
  //   OK                      the turn of the item has come
  //   CANCELLED               the turn of the item has come, but the item was cancelled
  //   UNAVAILABLE (DRAINING)  Stop() was called
  // With an error, the work only reports it to its caller. If memory is exhausted, only the item ends; work that must
  // report even then guards itself (out_of_memory.h).
  using Work = absl::AnyInvocable<void(const absl::Status& admitted)>;

  // Runs at most `max_running` items at a time on `threads`, which must outlive this object. Beside them, up to
  // `max_long` items that compute for long in OrCancelled() go on, so that they do not delay the others.
  SlowExecutor(boost::asio::any_io_executor threads, int max_running, int max_long = 0)
      : threads_(std::move(threads)), max_running_(max_running), max_long_(max_long) {}
  // Locks, so that ThreadSanitizer sees that all calls precede the destruction.
  ~SlowExecutor() { const std::lock_guard lock(mutex_); }

  // Throws std::bad_alloc if there is no memory for the item, which is then not called.
  void Post(const std::string& tenant, Work work,
            std::shared_ptr<Cancellation> cancellation = std::make_shared<Cancellation>());
  // Does the same as Post(), for callers that end a call if this fails. `work` is any function that Work can hold.
  // Errors: RESOURCE_EXHAUSTED (OUT_OF_MEMORY); `work` is then not called.
  template <typename Function>
  absl::Status TryPost(const std::string& tenant, Function&& work,
                       std::shared_ptr<Cancellation> cancellation = nullptr) {
    return OrOutOfMemory([&] {
      if (cancellation == nullptr) cancellation = std::make_shared<Cancellation>();
      Post(tenant, Work(std::forward<Function>(work)), std::move(cancellation));
      return absl::OkStatus();
    });
  }
  // Work of the server itself, which has a queue like a tenant. It is omitted after Stop().
  void PostOwn(absl::AnyInvocable<void()> work);

  // Cancels the running items, and rejects the waiting and all later ones.
  void Stop();

  // The cancellation of the item that runs on the present thread. On a thread that runs none: one that is never
  // cancelled.
  static const Cancellation& Running();
  // Returns what `work` returns, a status or absl::StatusOr. When the item that runs on the present thread is
  // cancelled, the work ends at its next yield point (core/base/yield_point.h), and the status of the cancellation is
  // returned. An item that has taken kLongItem lets the next item of another tenant begin. Everything that `work`
  // changes must be released by destructors, or must not be used afterwards; no lock that other items need is held.
  template <typename Work>
  static auto OrCancelled(Work&& work) -> decltype(work()) {
    if (running_ == nullptr) return std::forward<Work>(work)();
    try {
      const ScopedYielder scope(*running_);
      return std::forward<Work>(work)();
    } catch (const Ended&) {
      return Running().status();
    }
  }

  // Longer than the creation of most sessions, and short against a person's patience.
  static constexpr std::chrono::milliseconds kLongItem{50};

 private:
  // Ends the work in OrCancelled().
  class Ended : public std::exception {};
  // The item that runs on the present thread, from its construction to its destruction.
  class RunningItem : public Yielder {
   public:
    RunningItem(SlowExecutor& executor, std::shared_ptr<Cancellation> cancellation)
        : executor_(executor), cancellation_(std::move(cancellation)) {
      running_ = this;
    }
    ~RunningItem() override { running_ = outer_; }
    RunningItem(const RunningItem&) = delete;
    RunningItem& operator=(const RunningItem&) = delete;

    void Yield() override;
    const Cancellation& cancellation() const { return *cancellation_; }
    bool has_left_place() const { return has_left_place_; }

   private:
    SlowExecutor& executor_;
    const std::shared_ptr<Cancellation> cancellation_;
    RunningItem* const outer_ = running_;  // for tests, whose items run others
    std::chrono::steady_clock::time_point long_at_ = std::chrono::steady_clock::now() + kLongItem;
    bool has_left_place_ = false;
  };
  struct Item {
    Work work;
    std::shared_ptr<Cancellation> cancellation;
  };
  struct Queue {
    std::deque<Item> waiting;  // the first one may be about to run
    std::shared_ptr<Cancellation> running;
    bool has_thread = false;  // an item runs, or is about to
    uint64_t turn = 0;
  };
  using Queues = std::map<std::string, Queue>;

  // Posts Run() for the queues that FindNext() selects, until max_running_ items run or no queue has a waiting item. If
  // posting fails for lack of memory, the next call of Dispatch() tries again.
  void Dispatch() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  Queues::iterator FindNext() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The item that is about to run; without `work` if Stop() has rejected it.
  Item TakeItem(Queues::iterator queue);
  void Run(Queues::iterator queue);
  // Gives the place of a long item to the next one. Returns false if there are max_long_ such items.
  bool LeavePlace();
  absl::Status Admission(const Item& item);
  void Reject(Item item) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const boost::asio::any_io_executor threads_;
  const int max_running_;
  const int max_long_;
  std::mutex mutex_;
  bool is_stopped_ ABSL_GUARDED_BY(mutex_) = false;
  Queues queues_ ABSL_GUARDED_BY(mutex_);        // by tenant; removed when they are empty and have no thread
  int num_running_ ABSL_GUARDED_BY(mutex_) = 0;  // without the long ones
  int num_long_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t last_turn_ ABSL_GUARDED_BY(mutex_) = 0;

  static inline thread_local constinit RunningItem* running_ = nullptr;
};

}  // namespace evpose::server
