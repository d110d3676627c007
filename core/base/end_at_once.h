// SPDX-License-Identifier: Apache-2.0

// The end of a program that is told a second time to end.
#pragma once

#include <unistd.h>

#include <csignal>

namespace evpose {

// By the signal itself, as whoever waits for the process expects; may be called by its handler. Process 1 of a
// container is left alone by a signal's usual effect, and exits with what a shell makes of it.
inline void EndAtOnce(int signal) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, signal);
  std::signal(signal, SIG_DFL);
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  raise(signal);
  _exit(128 + signal);
}

}  // namespace evpose
