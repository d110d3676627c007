// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/fair_scheduler.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <boost/asio/io_context.hpp>
#include <chrono>
#include <cstdint>
#include <functional>
#include <latch>
#include <memory>
#include <mutex>
#include <semaphore>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "core/base/yield_point.h"
#include "server/scheduling/endable_work.h"

namespace evpose::server {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using ::testing::ElementsAre;

CpuMeter::Time At(int ms) { return CpuMeter::Time(milliseconds(ms)); }

TEST(FairSchedulerTest, StepsOnTheCallersExecutorRunOneByOneInTheOrderOfReceipt) {
  boost::asio::io_context executor;
  FairScheduler scheduler(executor.get_executor(), {.cpu_now = [] { return milliseconds(0); }});
  const auto first = scheduler.AddSession("alice"), second = scheduler.AddSession("bob");
  std::vector<std::string> steps;
  second->Post([&] { steps.push_back("second"); }, At(2));
  first->Post(
      [&] {
        steps.push_back("first");
        first->Post([&] { steps.push_back("again"); }, At(3));
      },
      At(1));
  EXPECT_TRUE(steps.empty());
  executor.run_one();
  EXPECT_THAT(steps, ElementsAre("first"));
  executor.run();
  EXPECT_THAT(steps, ElementsAre("first", "second", "again"));
}

TEST(FairSchedulerTest, StepsThatHaveNotBegunAreDropped) {
  const auto alive = std::make_shared<int>(1);
  boost::asio::io_context executor;
  {
    FairScheduler scheduler(executor.get_executor(), {});
    scheduler.AddSession("")->Post([alive] { FAIL(); }, At(0));
    EXPECT_EQ(alive.use_count(), 2);
  }
  EXPECT_EQ(alive.use_count(), 1);
}

TEST(FairSchedulerTest, ShortStepsShareATurn) {
  // A step takes 0.1 ms.
  std::atomic<int64_t> cpu_us = 0;
  FairScheduler scheduler(1, {.cpu_now = [&] { return microseconds(cpu_us.load()); }});
  const auto many = scheduler.AddSession(""), one = scheduler.AddSession("");
  std::vector<std::string> steps;
  std::binary_semaphore go(0);
  std::function<void()> step = [&] {
    cpu_us += 100;
    steps.push_back("many");
    if (steps.size() < 20) many->Post(step, At(3));
  };
  scheduler.AddSession("")->Post([&] { go.acquire(); }, At(0));
  many->Post(step, At(1));
  one->Post([&] { steps.push_back("one"); }, At(2));
  go.release();
  scheduler.Join();
  ASSERT_EQ(steps.size(), 20u);
  EXPECT_EQ(std::find(steps.begin(), steps.end(), "one") - steps.begin(), 10);
}

TEST(FairSchedulerTest, ALongStepHandsItsPlaceOver) {
  FairScheduler scheduler(1, {});
  const auto expensive = scheduler.AddSession("mallory"), camera = scheduler.AddSession("alice");
  std::atomic<bool> has_run = false;
  bool is_same_thread = false;
  std::chrono::nanoseconds paused{0};
  std::binary_semaphore finished(0);
  expensive->Post(
      [&] {
        const std::thread::id thread = std::this_thread::get_id();
        camera->Post([&] { has_run = true; }, std::chrono::steady_clock::now());
        while (!has_run) YieldPoint();  // ends only if the other step runs meanwhile
        is_same_thread = thread == std::this_thread::get_id();
        paused = PausedTime();
        finished.release();
      },
      std::chrono::steady_clock::now());
  finished.acquire();
  scheduler.Join();
  EXPECT_TRUE(has_run);
  EXPECT_TRUE(is_same_thread);
  EXPECT_GT(paused.count(), 0);
}

TEST(FairSchedulerTest, AStepAloneIsNotPaused) {
  FairScheduler scheduler(1, {});
  std::chrono::nanoseconds paused{1};
  std::binary_semaphore finished(0);
  scheduler.AddSession("")->Post(
      [&] {
        const auto begin = FairScheduler::ThreadCpuTime();
        while (FairScheduler::ThreadCpuTime() - begin < 3 * FairScheduler::kTurn) YieldPoint();
        paused = PausedTime();
        finished.release();
      },
      At(0));
  finished.acquire();
  scheduler.Join();
  EXPECT_EQ(paused.count(), 0);
}

TEST(FairSchedulerTest, ThereIsAtMostOneFurtherThreadForEachPausedStep) {
  constexpr int kWorkers = 2, kSessions = 6;
  std::mutex mutex;
  std::set<std::thread::id> threads;
  std::atomic<int> num_begun = 0;
  std::latch finished(kSessions);
  std::vector<std::shared_ptr<SessionTurns>> sessions;
  FairScheduler scheduler(kWorkers, {});
  for (int i = 0; i < kSessions; ++i) sessions.push_back(scheduler.AddSession(std::to_string(i % 3)));
  for (const auto& session : sessions) {
    session->Post(
        [&] {
          ++num_begun;
          {
            const std::lock_guard lock(mutex);
            threads.insert(std::this_thread::get_id());
          }
          while (num_begun < kSessions) YieldPoint();
          finished.count_down();
        },
        At(0));
  }
  finished.wait();
  scheduler.Join();
  EXPECT_EQ(num_begun, kSessions);
  EXPECT_LE(threads.size(), size_t{kWorkers + kSessions});
}

TEST(FairSchedulerTest, TheEndWaitsForNoEndableWork) {
  // One step runs, and the others are paused or have not begun.
  FairScheduler scheduler(1, {});
  std::latch begun(2);
  std::vector<std::shared_ptr<SessionTurns>> sessions;
  std::vector<std::weak_ptr<int>> held;
  std::atomic<int> num_finished = 0;
  for (int i = 0; i < 4; ++i) {
    auto object = std::make_shared<int>(i);
    held.push_back(object);
    sessions.push_back(scheduler.AddSession(""));
    const auto step = [&begun, &num_finished, object] {
      const ScopedEndableWork scope;
      const auto begin = FairScheduler::ThreadCpuTime();
      if (*object < 2) begun.count_down();
      while (FairScheduler::ThreadCpuTime() - begin < 200 * FairScheduler::kTurn) YieldPoint();
      ++num_finished;
    };
    sessions.back()->Post(step, At(i));
  }
  begun.wait();
  scheduler.Join();
  EXPECT_EQ(num_finished, 0);
  for (const std::weak_ptr<int>& object : held) EXPECT_TRUE(object.expired());
}

TEST(FairSchedulerTest, TheEndWaitsForOtherWork) {
  FairScheduler scheduler(1, {});
  std::binary_semaphore begun(0);
  bool has_finished = false;
  const auto session = scheduler.AddSession("");
  session->Post(
      [&] {
        { const ScopedEndableWork scope; }
        const auto begin = FairScheduler::ThreadCpuTime();
        begun.release();
        while (FairScheduler::ThreadCpuTime() - begin < 20 * FairScheduler::kTurn) YieldPoint();
        has_finished = true;
      },
      At(0));
  begun.acquire();
  scheduler.Join();
  EXPECT_TRUE(has_finished);
}

TEST(FairSchedulerTest, ALimitedSessionContinuesWhenItMay) {
  // A step takes 50 ms of processor time at a limit of 10 s per s: after the first steps each one waits.
  std::atomic<int64_t> cpu_ms = 0;
  FairScheduler scheduler(
      1, {.limits = {.session = 10.0, .tenant = 20.0}, .cpu_now = [&] { return milliseconds(cpu_ms.load()); }});
  const auto session = scheduler.AddSession("");
  std::binary_semaphore done(0);
  int steps = 0;
  const auto begin = std::chrono::steady_clock::now();
  std::function<void()> step = [&] {
    cpu_ms += 50;
    if (++steps == 40) return done.release();
    session->Post(step, At(0));
  };
  session->Post(step, At(0));
  done.acquire();
  EXPECT_GE(std::chrono::steady_clock::now() - begin, milliseconds(90));
  EXPECT_EQ(session->use().limit, 10.0);
  EXPECT_EQ(session->use().tenant_limit, 20.0);
  const auto other = scheduler.AddSession("");
  EXPECT_EQ(other->use().cpu_per_s, 0.0);
  EXPECT_GT(other->use().tenant_cpu_per_s, 0.0) << "of all sessions of the tenant";
}

}  // namespace
}  // namespace evpose::server
