// SPDX-License-Identifier: Apache-2.0

// A timer for periodic work that must go on after memory was exhausted.
#pragma once

#include <array>
#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstddef>
#include <functional>
#include <memory>
#include <new>
#include <utility>

#include "absl/time/time.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {

// Arm() needs no memory beyond that of the constructor, so that the work can arm the timer again even if an allocation
// has failed. Only if the executor has more timers than ever before, its list of timers grows. Not thread-safe.
class ReusableTimer {
 public:
  // `work` runs on `executor`. If memory is exhausted, it ends early.
  ReusableTimer(const boost::asio::any_io_executor& executor, std::function<void()> work)
      : timer_(executor), state_(std::make_shared<State>()) {
    state_->work = std::move(work);
  }

  // Runs the work once after `delay`. If an earlier delay has not yet ended, it is cancelled, and the work does not run
  // at its end.
  void Arm(absl::Duration delay) {
    timer_.expires_after(absl::ToChronoNanoseconds(delay));
    timer_.async_wait(Handler{state_});
  }
  // Work that is about to run may still run; the destructor does the same.
  void Cancel() { timer_.cancel(); }

 private:
  struct State {
    std::function<void()> work;
    // The memory of one wait. Boost.Asio releases it before it calls the handler.
    alignas(std::max_align_t) std::array<std::byte, 512> memory;
    bool is_used = false;
  };

  // Owns the state, because a cancelled wait may outlive the timer.
  template <typename T>
  struct Allocator {
    using value_type = T;

    explicit Allocator(std::shared_ptr<State> of) : state(std::move(of)) {}
    template <typename Other>
    explicit Allocator(const Allocator<Other>& other) : state(other.state) {}

    T* allocate(size_t count) {
      const size_t bytes = count * sizeof(T);
      if (state->is_used || bytes > state->memory.size()) return static_cast<T*>(::operator new(bytes));
      state->is_used = true;
      return reinterpret_cast<T*>(state->memory.data());
    }
    void deallocate(T* block, size_t) {
      if (reinterpret_cast<std::byte*>(block) != state->memory.data()) return ::operator delete(block);
      state->is_used = false;
    }
    friend bool operator==(const Allocator& a, const Allocator& b) { return a.state == b.state; }

    std::shared_ptr<State> state;
  };

  struct Handler {
    using allocator_type = Allocator<void>;
    allocator_type get_allocator() const noexcept { return allocator_type(state); }
    void operator()(const boost::system::error_code& error) const {
      if (!error) RunUnlessOutOfMemory(state->work);
    }

    std::shared_ptr<State> state;
  };

  boost::asio::steady_timer timer_;
  const std::shared_ptr<State> state_;
};

}  // namespace evpose::server
