// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/scraper.h"

#include <chrono>

#include "server/http/http_client_testing.h"

namespace evpose::bench {

double ScrapeMs(int port) {
  const auto begin = std::chrono::steady_clock::now();
  const server::HttpResponse answer = server::Ask(port, "/metrics");
  const std::chrono::duration<double, std::milli> time = std::chrono::steady_clock::now() - begin;
  return answer.status == 200 ? time.count() : 0.0;
}

Scraper::Scraper(int port) : port_(port), thread_([this] { Run(); }) {}

void Scraper::Run() {
  constexpr auto kPeriod = std::chrono::milliseconds(100);
  std::unique_lock lock(mutex_);
  while (!is_stopping_) {
    lock.unlock();
    scrapes_ms_.push_back(static_cast<float>(ScrapeMs(port_)));
    lock.lock();
    stopping_.wait_for(lock, kPeriod, [this] { return is_stopping_; });
  }
}

std::vector<float> Scraper::Stop() {
  {
    const std::lock_guard lock(mutex_);
    is_stopping_ = true;
  }
  stopping_.notify_all();
  if (thread_.joinable()) thread_.join();
  return scrapes_ms_;
}

}  // namespace evpose::bench
