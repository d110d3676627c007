// SPDX-License-Identifier: Apache-2.0

// Places in long computations where a thread may be paused in favour of other work. A pause changes no result: the
// computation continues on the same thread with the same state. No lock that other work may need is held at such a
// place, unless the yielder of the thread only goes on or ends the work by an exception, and never pauses the thread.
#pragma once

#include <chrono>
#include <cstddef>
#include <exception>

namespace evpose {

// Decides at each yield point of a thread whether the thread is paused there.
class Yielder {
 public:
  virtual ~Yielder() = default;
  virtual void Yield() = 0;  // returns when the thread may continue
};

namespace internal {
inline thread_local constinit Yielder* yielder = nullptr;
inline thread_local constinit std::chrono::nanoseconds paused_time{0};
}  // namespace internal

// Installs `yielder` for the present thread until the end of the scope.
class ScopedYielder {
 public:
  explicit ScopedYielder(Yielder& yielder) { internal::yielder = &yielder; }
  ~ScopedYielder() { internal::yielder = nullptr; }
  ScopedYielder(const ScopedYielder&) = delete;
  ScopedYielder& operator=(const ScopedYielder&) = delete;
};

// Removes the yielder of the present thread until the end of the scope: for calls of code that may hold locks.
class ScopedWithoutYielder {
 public:
  ScopedWithoutYielder() { internal::yielder = nullptr; }
  ~ScopedWithoutYielder() { internal::yielder = yielder_; }
  ScopedWithoutYielder(const ScopedWithoutYielder&) = delete;
  ScopedWithoutYielder& operator=(const ScopedWithoutYielder&) = delete;

 private:
  Yielder* const yielder_ = internal::yielder;
};

// To be called in loops whose body takes less than about 0.5 ms. Without a yielder it costs one load and one branch.
inline void YieldPoint() {
  if (internal::yielder != nullptr) internal::yielder->Yield();
}
// For loops with a body of less than about 5 us: yields at every 64th index.
inline void YieldPoint(size_t index) {
  if (index % 64 == 0) YieldPoint();
}

// For destructors that release many megabytes. An exception of the yielder, which may need memory to pause the thread,
// is not propagated: the thread goes on.
inline void YieldPointOfDestructor() noexcept {
  try {
    YieldPoint();
  } catch (const std::exception&) {
    return;
  }
}

// The time for which the present thread has been paused so far. A measured duration of processing excludes it.
inline std::chrono::nanoseconds PausedTime() { return internal::paused_time; }
inline void AddPausedTime(std::chrono::nanoseconds duration) { internal::paused_time += duration; }

}  // namespace evpose
