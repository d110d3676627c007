// SPDX-License-Identifier: Apache-2.0

// The surroundings of a command: its streams, its clock and the interrupt.
#pragma once

#include <cstddef>
#include <functional>
#include <ostream>

#include "absl/time/time.h"
#include "evpose/clock.h"

namespace evpose::client {

// The longest time that a command waits before it checks for an interrupt.
inline constexpr absl::Duration kInterruptPeriod = absl::Milliseconds(50);

struct CliContext {
  std::ostream& out;
  std::ostream& err;
  bool is_err_terminal = false;  // true: progress is a line that is rewritten; false: progress is printed line by line
  size_t err_columns = 80;       // width of that terminal
  Clock* clock = nullptr;        // paces a replay; nullptr: the machine's clock
  // Returns true when the command must finish the work in progress and stop. It is called often, from several threads.
  std::function<bool()> is_interrupted;
  bool IsInterrupted() const { return is_interrupted && is_interrupted(); }
};

}  // namespace evpose::client
