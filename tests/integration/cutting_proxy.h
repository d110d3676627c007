// SPDX-License-Identifier: Apache-2.0

// A TCP proxy that cuts or delays connections after a given number of bytes, to simulate network failures.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <limits>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace evpose {

class CuttingProxy {
 public:
  CuttingProxy();  // listens on a free port of 127.0.0.1; without a target every connection is closed at once
  ~CuttingProxy();

  std::string address() const { return "127.0.0.1:" + std::to_string(port_); }
  void SetTarget(int port) { target_port_ = port; }
  // Cuts the next connections, each after the given number of bytes from the client; later connections are not cut.
  void CutAfter(const std::vector<uint64_t>& client_bytes);
  // Holds back what the clients send on each connection after this number of bytes, until Release().
  void HoldAfter(uint64_t client_bytes) { hold_after_ = client_bytes; }
  void Release() { HoldAfter(std::numeric_limits<uint64_t>::max()); }
  int num_cut() const { return num_cut_; }
  int num_refused() const { return num_refused_; }  // connections that were closed because there was no target

 private:
  void Accept();
  void Serve(int client);
  uint64_t TakeLimit();

  int listener_ = -1;
  int port_ = 0;
  std::atomic<int> target_port_ = 0;
  std::atomic<uint64_t> hold_after_ = std::numeric_limits<uint64_t>::max();
  std::atomic<int> num_cut_ = 0;
  std::atomic<int> num_refused_ = 0;
  std::atomic<bool> is_stopped_ = false;
  std::mutex mutex_;
  std::deque<uint64_t> limits_;            // guarded by mutex_
  std::vector<std::jthread> connections_;  // used by the accepting thread only
  std::jthread acceptor_;
};

}  // namespace evpose
