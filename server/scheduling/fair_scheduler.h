// SPDX-License-Identifier: Apache-2.0

// The threads that decode and track for all sessions. They divide their time among the sessions in the order of
// FairQueue, in turns of bounded processor time.
#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "server/scheduling/fair_queue.h"

namespace evpose::server {

class FairScheduler;

// Runs the steps of one session, one at a time. Thread-safe.
class SessionTurns : private SessionShare, public std::enable_shared_from_this<SessionTurns> {
 public:
  struct Use {
    double cpu_per_s = 0.0;         // processor seconds per second, averaged with a time constant of one second
    double limit = 0.0;             // bound of cpu_per_s; 0: none
    double tenant_cpu_per_s = 0.0;  // as cpu_per_s, of all sessions of the tenant
    double tenant_limit = 0.0;      // bound of tenant_cpu_per_s; 0: none
  };

  // Runs `step` in a turn of the session. At most one step may wait; the step that runs may post the next one, which
  // then belongs to the same turn as long as the turn's time lasts. `received_at`: of the oldest data that wait.
  // `arrival`: ArrivalMonitor::arrival(); determines the part of the processor time that is counted.
  void Post(std::function<void()> step, CpuMeter::Time received_at, Arrival arrival = Arrival::kLive);
  Use use() const;

 private:
  friend class FairScheduler;
  class Pause;
  enum class State { kIdle, kWaiting, kRunning };

  SessionTurns(FairScheduler& scheduler, std::shared_ptr<TenantShare> its_tenant, std::string trace_id)
      : scheduler_(scheduler), trace_id_(std::move(trace_id)) {
    tenant = std::move(its_tenant);
  }

  FairScheduler& scheduler_;
  const std::string trace_id_;
  // The lock of the scheduler guards these members and the share.
  State state_ = State::kIdle;
  std::function<void()> step_;
  CpuMeter::Time step_ended_at_{};
  Pause* paused_ = nullptr;             // the step in progress, while it is paused
  std::shared_ptr<SessionTurns> self_;  // while not idle
};

// Thread-safe. Must outlive its sessions.
class FairScheduler {
 public:
  struct Options {
    CpuLimits limits;
    std::function<CpuMeter::Time()> now = std::chrono::steady_clock::now;
    std::function<std::chrono::nanoseconds()> cpu_now = ThreadCpuTime;  // processor time of the calling thread
    // Called after each turn with its processor time and the trace ID of its session. It must not block.
    std::function<void(std::chrono::nanoseconds, const std::string&)> on_turn = [](std::chrono::nanoseconds,
                                                                                   const std::string&) {};
  };

  // Work runs on `num_threads` threads at a time. A step that reaches a yield point (core/base/yield_point.h) after its
  // time hands its place to another thread and is paused: there are at most as many further threads as paused steps.
  FairScheduler(int num_threads, Options options);
  // Uses the caller's executor, which runs one step at a time, and pauses none. Limits are not supported.
  FairScheduler(boost::asio::any_io_executor executor, Options options);
  // Steps that have not begun are dropped.
  ~FairScheduler() ABSL_NO_THREAD_SAFETY_ANALYSIS;

  // Processor time of a turn, as long as other sessions wait: one pose period at 1 kHz. With shorter turns, more time
  // goes into changing between sessions; longer ones delay the poses of the others.
  static constexpr std::chrono::milliseconds kTurn{1};
  static std::chrono::nanoseconds ThreadCpuTime();

  // `trace_id` is only passed on to Options::on_turn.
  std::shared_ptr<SessionTurns> AddSession(const std::string& tenant, const std::string& trace_id = "");
  // Returns when all steps have finished, or were ended in a ScopedEndableWork at the first yield point after a turn.
  // Nothing may be posted afterwards, except by steps. Does nothing with the caller's executor.
  void Join();

 private:
  friend class SessionTurns;
  using Lock = std::unique_lock<std::mutex>;

  static SessionTurns& TurnsOf(SessionShare& share) { return static_cast<SessionTurns&>(share); }
  void Post(SessionTurns& session, std::function<void()> step, CpuMeter::Time received_at, Arrival arrival);
  // Gives free places to the sessions that wait. `caller_is_idle`: the caller takes the first of begun_ itself.
  void Dispatch(bool caller_is_idle) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RunThread() ABSL_NO_THREAD_SAFETY_ANALYSIS;
  void RunOne() ABSL_NO_THREAD_SAFETY_ANALYSIS;  // on the caller's executor
  void Charge(SessionTurns& session, std::chrono::nanoseconds cpu) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Runs steps of the session for the time of a turn. The lock is released while a step runs.
  void RunTurn(SessionTurns& session, Lock& lock) ABSL_NO_THREAD_SAFETY_ANALYSIS;
  void RunStep(SessionTurns& session, Lock& lock) ABSL_NO_THREAD_SAFETY_ANALYSIS;
  // Counts the end of a turn. Returns whether the session is idle now; it may have been deleted then.
  bool EndTurn(SessionTurns& session) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Whether another thread can take the place of a step that pauses; starts a thread if necessary. Invariant: idle
  // threads - size of begun_ >= free places.
  bool HasSpareThread() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsFinished() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { return num_running_ == 0 && queue_.size() == 0; }
  void End(bool drops_steps);

  const Options options_;
  const size_t num_places_;
  const boost::asio::any_io_executor executor_;  // empty: own threads
  mutable std::mutex mutex_;
  std::condition_variable idle_;  // notifies the threads without a turn
  FairQueue queue_ ABSL_GUARDED_BY(mutex_);
  std::deque<SessionTurns*> begun_ ABSL_GUARDED_BY(mutex_);  // have a place, but no thread yet
  size_t num_running_ ABSL_GUARDED_BY(mutex_) = 0;           // places in use
  size_t num_idle_ ABSL_GUARDED_BY(mutex_) = 0;              // threads without a turn
  bool is_ending_ ABSL_GUARDED_BY(mutex_) = false;
  bool drops_steps_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<std::thread> threads_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
