// SPDX-License-Identifier: Apache-2.0

// Time that a processor spent on something: other programs on the machine do not count.
#pragma once

#include <ctime>

namespace evpose {

inline double SecondsOfClock(clockid_t clock) {
  timespec now = {};
  clock_gettime(clock, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// That this thread takes for `work`.
template <typename Work>
double ProcessorSecondsOf(const Work& work) {
  const double begin_s = SecondsOfClock(CLOCK_THREAD_CPUTIME_ID);
  work();
  return SecondsOfClock(CLOCK_THREAD_CPUTIME_ID) - begin_s;
}

}  // namespace evpose
