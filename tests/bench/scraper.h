// SPDX-License-Identifier: Apache-2.0

// Scrapes /metrics as Prometheus does.
#pragma once

#include <condition_variable>
#include <mutex>
#include <thread>
#include <vector>

namespace evpose::bench {

// The time to get /metrics of the server at `port` of this machine, milliseconds; 0 for an invalid response.
double ScrapeMs(int port);

// Scrapes ten times per second, in a thread, until Stop().
class Scraper {
 public:
  explicit Scraper(int port);
  ~Scraper() { Stop(); }
  // Stops the thread, and returns the duration of each scrape, milliseconds.
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
