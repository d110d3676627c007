// SPDX-License-Identifier: Apache-2.0

// Prometheus, as the server sees it.
#pragma once

#include <condition_variable>
#include <mutex>
#include <thread>
#include <vector>

namespace evpose::bench {

// Milliseconds from asking the server at `port` of this machine for /metrics to its whole answer; 0 for a bad one.
double ScrapeMs(int port);

// Scrapes ten times a second, in a thread of its own, until it is told to stop.
class Scraper {
 public:
  explicit Scraper(int port);
  ~Scraper() { Stop(); }
  // What each scrape took, in ms.
  std::vector<float> Stop();

 private:
  void Run();

  const int port_;
  std::mutex mutex_;
  std::condition_variable stopping_;
  bool is_stopping_ = false;  // guarded by mutex_
  std::vector<float> scrapes_ms_;
  std::thread thread_;
};

}  // namespace evpose::bench
