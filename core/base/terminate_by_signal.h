// SPDX-License-Identifier: Apache-2.0

// Immediate termination of a program that receives a second signal while it ends cleanly.
#pragma once

#include <unistd.h>

#include <csignal>

namespace evpose {

// Terminates the process by the signal's default action, so that the parent process sees the signal as the cause. May
// be called by the handler of the signal. Process 1 of a container has no default actions; it exits with 128 + signal,
// the exit code that a shell reports for a process which a signal has terminated.
inline void TerminateBySignal(int signal) {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, signal);
  std::signal(signal, SIG_DFL);
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  raise(signal);
  _exit(128 + signal);
}

}  // namespace evpose
