// SPDX-License-Identifier: Apache-2.0

// `evpose`: the command line as a function, so that tests run it without a process.
#pragma once

#include <functional>
#include <ostream>
#include <string>
#include <vector>

#include "absl/time/time.h"
#include "client/lib/clock.h"

namespace evpose::client {

// How long what waits goes without looking for an interrupt.
inline constexpr absl::Duration kInterruptPeriod = absl::Milliseconds(50);

struct CliContext {
  std::ostream& out;
  std::ostream& err;
  bool is_err_terminal = false;          // a progress bar instead of lines
  Clock* clock = nullptr;                // what paces a replay; nullptr: the machine's
  std::function<bool()> is_interrupted;  // true: finish what was begun and stop; asked often, in several threads
  bool IsInterrupted() const { return is_interrupted && is_interrupted(); }
};

// `arguments` without the program's name. Returns the exit status: 0 done, 1 failed (one line on `err` says what and
// what to do), 2 wrong usage.
int RunCli(const std::vector<std::string>& arguments, CliContext& context);

}  // namespace evpose::client
