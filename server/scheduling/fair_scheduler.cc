// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/fair_scheduler.h"

#include <boost/asio/post.hpp>
#include <ctime>
#include <exception>
#include <system_error>
#include <utility>

#include "core/base/yield_point.h"
#include "server/scheduling/endable_work.h"

namespace evpose::server {
namespace {

// Thrown by a yield point when the scheduler ends. The sessions were closed before, so that no result is lost.
struct StepEnded : std::exception {};

}  // namespace

// Measures the processor time of a session's turn. When the time is over, its step is paused if others wait, and
// otherwise continues with another turn.
class SessionTurns::Pause : public Yielder {
 public:
  Pause(FairScheduler& scheduler, SessionTurns& session) : scheduler_(scheduler), session_(session) { Begin(); }

  void Yield() override {
    // Reading the processor time is a system call; it is never more than the time on the clock.
    const CpuMeter::Time now = scheduler_.options_.now();
    if (now < check_at_) return;
    const std::chrono::nanoseconds left = FairScheduler::kTurn - Used();
    if (left > std::chrono::nanoseconds::zero()) {
      check_at_ = now + left;
      return;
    }
    StartNextTurn(now);
  }
  std::chrono::nanoseconds Used() const { return scheduler_.options_.cpu_now() - cpu_begin_; }
  void Resume() {
    is_resumed_ = true;
    resumed_.notify_one();
  }

 private:
  void Begin() {
    cpu_begin_ = scheduler_.options_.cpu_now();
    check_at_ = scheduler_.options_.now() + FairScheduler::kTurn;
  }
  bool MustEnd() const ABSL_NO_THREAD_SAFETY_ANALYSIS { return scheduler_.is_ending_ && ScopedEndableWork::IsActive(); }
  void StartNextTurn(CpuMeter::Time now) ABSL_NO_THREAD_SAFETY_ANALYSIS {
    FairScheduler::Lock lock(scheduler_.mutex_);
    scheduler_.Charge(session_, Used());
    Begin();
    if (MustEnd()) throw StepEnded();
    if (scheduler_.queue_.size() == 0 || scheduler_.drops_steps_ || !scheduler_.HasSpareThread()) return;
    scheduler_.queue_.Push(session_);  // first, because it may throw: the step then ends
    session_.paused_ = this;
    session_.state_ = State::kWaiting;
    --scheduler_.num_running_;
    is_resumed_ = false;
    scheduler_.Dispatch(/*caller_is_idle=*/false);
    resumed_.wait(lock, [this] { return is_resumed_; });
    if (MustEnd()) throw StepEnded();
    lock.unlock();
    AddPausedTime(scheduler_.options_.now() - now);
    Begin();
  }

  FairScheduler& scheduler_;
  SessionTurns& session_;
  std::chrono::nanoseconds cpu_begin_{};
  CpuMeter::Time check_at_;
  std::condition_variable resumed_;
  bool is_resumed_ = false;  // guarded by the scheduler's lock
};

void SessionTurns::Post(std::function<void()> step, CpuMeter::Time first_received_at, Arrival its_arrival) {
  scheduler_.Post(*this, std::move(step), first_received_at, its_arrival);
}

SessionTurns::Use SessionTurns::use() const {
  const std::lock_guard lock(scheduler_.mutex_);
  const CpuMeter::Time now = scheduler_.options_.now();
  const CpuLimits& limits = scheduler_.options_.limits;
  return {meter.Rate(now), limits.session, tenant->meter.Rate(now), limits.tenant};
}

FairScheduler::FairScheduler(int num_threads, Options options)
    : options_(std::move(options)), num_places_(static_cast<size_t>(num_threads)), queue_(options_.limits) {
  const std::lock_guard lock(mutex_);
  for (int i = 0; i < num_threads; ++i) {
    threads_.emplace_back([this] { RunThread(); });
    ++num_idle_;
  }
}

FairScheduler::FairScheduler(boost::asio::any_io_executor executor, Options options)
    : options_(std::move(options)), num_places_(0), executor_(std::move(executor)), queue_({}) {}

FairScheduler::~FairScheduler() {
  End(/*drops_steps=*/true);
  // Steps that were posted after Join() keep their sessions alive.
  while (SessionShare* const next = queue_.Pop(options_.now())) begun_.push_back(&TurnsOf(*next));
  for (SessionTurns* const session : begun_) {
    const std::shared_ptr<SessionTurns> self = std::move(session->self_);
    const std::function<void()> step = std::exchange(self->step_, nullptr);
  }
}

std::chrono::nanoseconds FairScheduler::ThreadCpuTime() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

std::shared_ptr<SessionTurns> FairScheduler::AddSession(const std::string& tenant, const std::string& trace_id) {
  const std::lock_guard lock(mutex_);
  return std::shared_ptr<SessionTurns>(new SessionTurns(*this, queue_.FindTenant(tenant), trace_id));
}

void FairScheduler::Post(SessionTurns& session, std::function<void()> step, CpuMeter::Time received_at,
                         Arrival arrival) {
  const std::lock_guard lock(mutex_);
  session.step_ = std::move(step);
  session.received_at = received_at;
  FairQueue::SetArrival(session, arrival);
  // Nothing waited between the last step and the receipt of these data.
  if (received_at >= session.step_ended_at_) session.RecordDrained(received_at);
  if (session.state_ != SessionTurns::State::kIdle) return;
  queue_.Add(session);  // first, because it may throw
  session.state_ = SessionTurns::State::kWaiting;
  session.self_ = session.shared_from_this();
  if (executor_) {
    boost::asio::post(executor_, [this] { RunOne(); });
  } else {
    Dispatch(/*caller_is_idle=*/false);
  }
}

void FairScheduler::Dispatch(bool caller_is_idle) {
  while (num_running_ < num_places_) {
    SessionShare* const next = queue_.Pop(options_.now());
    if (next == nullptr) break;
    SessionTurns& session = TurnsOf(*next);
    session.state_ = SessionTurns::State::kRunning;
    ++num_running_;
    if (session.paused_ != nullptr) {
      std::exchange(session.paused_, nullptr)->Resume();
      continue;
    }
    begun_.push_back(&session);
    if (!std::exchange(caller_is_idle, false)) idle_.notify_one();
  }
  // Those that wait have reached their limits: a thread waits until they may continue.
  if (queue_.size() > 0 && num_running_ < num_places_) idle_.notify_one();
}

bool FairScheduler::HasSpareThread() {
  if (num_idle_ > num_places_ - num_running_ + begun_.size()) return true;
  try {
    threads_.emplace_back([this] { RunThread(); });
  } catch (const std::system_error&) {
    return false;  // the system permits no further thread: the step continues
  }
  ++num_idle_;
  return true;
}

void FairScheduler::RunThread() {
  Lock lock(mutex_);
  while (!(is_ending_ && IsFinished())) {
    if (begun_.empty()) {
      const auto next = num_running_ < num_places_ ? queue_.NextTurnAt() : std::nullopt;
      if (!next.has_value()) {
        idle_.wait(lock);
      } else if (idle_.wait_until(lock, *next) == std::cv_status::timeout) {
        Dispatch(/*caller_is_idle=*/true);
      }
      continue;
    }
    SessionTurns& session = *begun_.front();
    begun_.pop_front();
    --num_idle_;
    RunTurn(session, lock);
    EndTurn(session);
    --num_running_;
    ++num_idle_;
    Dispatch(/*caller_is_idle=*/true);
  }
  idle_.notify_all();
}

void FairScheduler::RunOne() {
  Lock lock(mutex_);
  SessionShare* const next = queue_.Pop(options_.now());
  if (next == nullptr) return;
  SessionTurns& session = TurnsOf(*next);
  session.state_ = SessionTurns::State::kRunning;
  const std::chrono::nanoseconds begin = options_.cpu_now();
  RunStep(session, lock);
  Charge(session, options_.cpu_now() - begin);
  if (!EndTurn(session)) boost::asio::post(executor_, [this] { RunOne(); });
}

void FairScheduler::Charge(SessionTurns& session, std::chrono::nanoseconds cpu) {
  queue_.Charge(session, cpu, options_.now());
  options_.on_turn(cpu, session.trace_id_);
}

void FairScheduler::RunTurn(SessionTurns& session, Lock& lock) {
  SessionTurns::Pause pause(*this, session);
  {
    const ScopedYielder scope(pause);
    do {
      RunStep(session, lock);
    } while (session.step_ != nullptr && pause.Used() < kTurn);
  }
  Charge(session, pause.Used());
}

void FairScheduler::RunStep(SessionTurns& session, Lock& lock) {
  std::function<void()> step = std::exchange(session.step_, nullptr);
  const bool is_dropped = drops_steps_;
  lock.unlock();
  try {
    if (!is_dropped) step();
  } catch (const StepEnded&) {
  }
  step = nullptr;  // without the lock: it may hold the last reference to its session
  lock.lock();
  session.step_ended_at_ = options_.now();
}

bool FairScheduler::EndTurn(SessionTurns& session) {
  if (session.step_ != nullptr) {
    session.state_ = SessionTurns::State::kWaiting;
    queue_.Push(session);
    return false;
  }
  session.state_ = SessionTurns::State::kIdle;
  queue_.Remove(session);
  session.self_.reset();  // may delete the object
  return true;
}

void FairScheduler::Join() { End(/*drops_steps=*/false); }

void FairScheduler::End(bool drops_steps) {
  std::vector<std::thread> threads;
  {
    const std::lock_guard lock(mutex_);
    is_ending_ = true;
    drops_steps_ |= drops_steps;
    queue_.RemoveLimits();
    Dispatch(/*caller_is_idle=*/false);
    idle_.notify_all();
  }
  // A running step may start further threads.
  while (true) {
    {
      const std::lock_guard lock(mutex_);
      threads.swap(threads_);
    }
    if (threads.empty()) return;
    for (std::thread& thread : threads) thread.join();
    threads.clear();
  }
}

}  // namespace evpose::server
