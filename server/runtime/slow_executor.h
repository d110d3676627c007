// SPDX-License-Identifier: Apache-2.0

// Fair execution of work that takes milliseconds to seconds, such as waiting for the store or preparing a model: no
// tenant delays another one by more than the rest of the items that are running, and an item that computes for long, or
// waits for another item, delays none.
#pragma once

#include <atomic>
#include <boost/asio/any_io_executor.hpp>
#include <chrono>
#include <cstdint>
#include <exception>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "absl/functional/function_ref.h"
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

// Whether an item may run at the same time as other items of its tenant.
enum class Overlap {
  kNone,  // the item begins when the items that were posted before it have ended or overlap it
  kAny,   // the item may overlap them: begin before those that wait, and run beside those that run
};

// One queue for each tenant, which runs in order and one item at a time; the queues take turns. Because a tenant has at
// most one running item, it leaves the other threads to the other tenants. Items with Overlap::kAny have further
// threads. On these a tenant with a running item begins another one only while each other tenant with items has a
// running one, too. Thread-safe.
class SlowExecutor {
 public:
  // Numbers of items that run at a time.
  struct Places {
    int running = 1;      // at most one for each tenant
    int long_items = 0;   // beside them: those that compute for long in OrCancelled(), or wait (LeavePlaceToWait())
    int overlapping = 0;  // beside them: those with Overlap::kAny
  };

  // Is called exactly once, on a thread of the executor, unless the executor is destroyed before. `admitted`:
  //   OK                      the turn of the item has come
  //   CANCELLED               the turn of the item has come, but the item was cancelled
  //   UNAVAILABLE (DRAINING)  Stop() was called
  // With an error, the work only reports it to its caller. If memory is exhausted, only the item ends; work that must
  // report even then guards itself (out_of_memory.h).
  using Work = absl::AnyInvocable<void(const absl::Status& admitted)>;

  // Runs the items on `threads`, which must outlive this object and should be as many as the places.
  SlowExecutor(boost::asio::any_io_executor threads, Places places) : threads_(std::move(threads)), places_(places) {}
  // Locks, so that ThreadSanitizer sees that all calls precede the destruction.
  ~SlowExecutor() { const std::lock_guard lock(mutex_); }

  // Throws std::bad_alloc if there is no memory for the item, which is then not called.
  void Post(const std::string& tenant, Work work,
            std::shared_ptr<Cancellation> cancellation = std::make_shared<Cancellation>(),
            Overlap overlap = Overlap::kNone);
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
  // changes must be released by destructors, or must not be used afterwards. The work is never paused, so that it may
  // hold a lock for which other items wait (WeakCache::Get()); its destructor releases the lock.
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

  // To be called before the item that runs on the present thread waits for another item or for a process: the next item
  // of another tenant begins meanwhile, as beside an item that has taken kLongItem. Does nothing on a thread that runs
  // no item, and when there are as many long items as permitted.
  static void LeavePlaceToWait() {
    if (running_ != nullptr) running_->LeavePlace();
  }

  // Longer than the creation of most sessions takes, and short compared with the time for which a person waits.
  static constexpr std::chrono::milliseconds kLongItem{50};

 private:
  // Ends the work in OrCancelled().
  class Ended : public std::exception {};
  enum class Place { kRunning, kLong, kOverlapping };
  // The item that runs on the present thread, from its construction to its destruction.
  class RunningItem : public Yielder {
   public:
    RunningItem(SlowExecutor& executor, std::shared_ptr<Cancellation> cancellation, Place place)
        : executor_(executor), cancellation_(std::move(cancellation)), place_(place) {
      running_ = this;
    }
    ~RunningItem() override { running_ = outer_; }
    RunningItem(const RunningItem&) = delete;
    RunningItem& operator=(const RunningItem&) = delete;

    void Yield() override;
    void LeavePlace();
    const Cancellation& cancellation() const { return *cancellation_; }
    Place place() const { return place_; }

   private:
    SlowExecutor& executor_;
    const std::shared_ptr<Cancellation> cancellation_;
    RunningItem* const outer_ = running_;  // for tests, whose items run others
    std::chrono::steady_clock::time_point long_at_ = std::chrono::steady_clock::now() + kLongItem;
    Place place_;
  };
  struct Item {
    Work work;
    std::shared_ptr<Cancellation> cancellation;
    Overlap overlap = Overlap::kNone;
  };
  using Items = std::list<Item>;
  struct Queue {
    Items waiting;
    size_t num_overlapping = 0;  // of those that wait, with Overlap::kAny
    Items running;               // with those that are about to
    bool has_thread = false;     // one of them has, or had, the tenant's place; the others overlap
    uint64_t turn = 0;
  };
  using Queues = std::map<std::string, Queue>;

  // Starts the items that have a place, until no place is free or no queue has an item for it. If posting fails for
  // lack of memory, the next call of Dispatch() tries again.
  void Dispatch() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Returns the queue with the earliest turn among those for which `has_item` is true.
  Queues::iterator FindNext(absl::FunctionRef<bool(Queue&)> has_item) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Returns the queue from which Dispatch() is to start an overlapping item, or the end of queues_.
  Queues::iterator FindNextOverlapping() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  static Items::iterator FirstOverlapping(Queue& queue);
  static bool Overlaps(const Item& item) { return item.overlap == Overlap::kAny; }
  // Posts Run() for an item. Returns false if there is no memory.
  bool Start(Queues::iterator queue, Items::iterator item, Place place) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The work of the item that is about to run; null if Stop() has rejected it.
  Work TakeWork(Items::iterator item);
  void Run(Queues::iterator queue, Items::iterator item, Place place);
  // Gives the place of a long item to the next one. Returns false if there are as many of them as permitted.
  bool LeavePlace();
  int& NumIn(Place place) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status Admission(const Item& item);
  void Reject(Work work) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const boost::asio::any_io_executor threads_;
  const Places places_;
  std::mutex mutex_;
  bool is_stopped_ ABSL_GUARDED_BY(mutex_) = false;
  Queues queues_ ABSL_GUARDED_BY(mutex_);  // by tenant; removed when they are empty and have no thread
  Places used_ ABSL_GUARDED_BY(mutex_) = {.running = 0};
  uint64_t last_turn_ ABSL_GUARDED_BY(mutex_) = 0;

  static inline thread_local constinit RunningItem* running_ = nullptr;
};

}  // namespace evpose::server
