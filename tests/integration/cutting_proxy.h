// SPDX-License-Identifier: Apache-2.0

// A TCP proxy that cuts connections after so many bytes: a network that is not perfect, at places of the test's choice.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
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
  // The next connections are cut after so many bytes from the client, one after the other; those after them are not.
  void CutAfter(const std::vector<uint64_t>& client_bytes);
  int num_cut() const { return num_cut_; }
  int num_refused() const { return num_refused_; }  // for want of a target

 private:
  void Accept();
  void Serve(int client);
  uint64_t TakeLimit();

  int listener_ = -1;
  int port_ = 0;
  std::atomic<int> target_port_ = 0;
  std::atomic<int> num_cut_ = 0;
  std::atomic<int> num_refused_ = 0;
  std::atomic<bool> is_stopped_ = false;
  std::mutex mutex_;
  std::deque<uint64_t> limits_;            // guarded by mutex_
  std::vector<std::jthread> connections_;  // of the accepting thread
  std::jthread acceptor_;
};

}  // namespace evpose
