// SPDX-License-Identifier: Apache-2.0

// Times of measurements. Processor time does not include other programs on the machine.
#pragma once

#include <chrono>
#include <ctime>

namespace evpose {

inline double SecondsOfClock(clockid_t clock) {
  timespec now = {};
  clock_gettime(clock, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// Milliseconds of wall clock.
inline double MillisecondsSince(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
}

// Returns the processor seconds that this thread takes for `work`.
template <typename Work>
double ProcessorSecondsOf(const Work& work) {
  const double begin_s = SecondsOfClock(CLOCK_THREAD_CPUTIME_ID);
  work();
  return SecondsOfClock(CLOCK_THREAD_CPUTIME_ID) - begin_s;
}

}  // namespace evpose
