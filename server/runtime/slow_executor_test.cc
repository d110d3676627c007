// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/slow_executor.h"

#include <algorithm>
#include <array>
#include <boost/asio/io_context.hpp>
#include <functional>

#include "absl/status/statusor.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/runtime/errors.h"
#include "server/runtime/failing_allocations_testing.h"
#include "server/scheduling/fair_scheduler.h"

namespace evpose::server {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

// Runs on the thread of the test, one step at a time.
class SlowExecutorTest : public testing::Test {
 protected:
  // Appends `name` to ran_, or to rejected_ with the code of the error.
  SlowExecutor::Work Note(const std::string& name) {
    return [this, name](const absl::Status& admitted) {
      if (admitted.ok()) return ran_.push_back(name);
      rejected_.push_back(
          absl::StrCat(name, " ", absl::StatusCodeToString(admitted.code()), " ", GetErrorDetails(admitted).reason));
    };
  }
  void Post(const std::string& tenant, const std::string& name) { slow_.Post(tenant, Note(name)); }
  // Posts the item "second" behind what waits, runs all, and returns what ran.
  std::vector<std::string> RunWithSecond() {
    Post(kLongTenant, "second");
    threads_.restart();
    threads_.run();
    return std::exchange(ran_, {});
  }

  static constexpr char kLongTenant[] = "a name that does not fit into the string itself";

  boost::asio::io_context threads_;
  SlowExecutor slow_{threads_.get_executor(), {.running = 2}};
  std::vector<std::string> ran_, rejected_;
};

TEST_F(SlowExecutorTest, TenantsTakeTurns) {
  for (int i = 1; i <= 4; ++i) Post("mallory", absl::StrCat("m", i));
  Post("alice", "a1");
  Post("bob", "b1");
  Post("alice", "a2");
  threads_.run();
  EXPECT_THAT(ran_, ElementsAre("m1", "a1", "b1", "m2", "a2", "m3", "m4"));
}

TEST_F(SlowExecutorTest, ATenantHasOneRunningItemAndTheNextThreadIsForOthers) {
  std::vector<std::string> during;
  slow_.Post("mallory", [&](const absl::Status&) {
    Post("mallory", "m2");
    Post("alice", "a1");
    threads_.run_one();  // as another thread would
    during = ran_;
  });
  threads_.run();
  EXPECT_THAT(during, ElementsAre("a1"));
  EXPECT_THAT(ran_, ElementsAre("a1", "m2"));
}

TEST_F(SlowExecutorTest, CancelledWorkIsNotRun) {
  const auto cancellation = std::make_shared<Cancellation>();
  Post("alice", "a1");
  slow_.Post("alice", Note("a2"), cancellation);
  Post("alice", "a3");
  cancellation->Cancel();
  threads_.run();
  EXPECT_THAT(ran_, ElementsAre("a1", "a3"));
  EXPECT_THAT(rejected_, ElementsAre("a2 CANCELLED "));
}

TEST_F(SlowExecutorTest, StopCancelsWhatRunsAndRejectsTheRest) {
  const auto cancellation = std::make_shared<Cancellation>();
  bool was_cancelled = false;
  slow_.Post(
      "alice",
      [&](const absl::Status& admitted) {
        EXPECT_TRUE(admitted.ok());
        slow_.Stop();
        was_cancelled = cancellation->is_cancelled();
      },
      cancellation);
  Post("alice", "a2");
  slow_.PostOwn([this] { ran_.emplace_back("own"); });
  threads_.run_one();
  EXPECT_TRUE(was_cancelled);
  Post("bob", "b1");
  slow_.PostOwn([this] { ran_.emplace_back("own later"); });
  threads_.run();
  EXPECT_THAT(ran_, IsEmpty());
  EXPECT_THAT(rejected_, ElementsAre("a2 UNAVAILABLE DRAINING", "b1 UNAVAILABLE DRAINING"));
}

TEST_F(SlowExecutorTest, StopRejectsWorkThatAThreadHasNotBegun) {
  Post("alice", "a1");  // a thread is about to run it
  slow_.Stop();
  threads_.run();
  EXPECT_THAT(ran_, IsEmpty());
  EXPECT_THAT(rejected_, ElementsAre("a1 UNAVAILABLE DRAINING"));
}

// Work that ends at a yield point only if it is told to.
absl::Status Endless() {
  while (true) YieldPoint();
}

TEST_F(SlowExecutorTest, CancelledWorkEndsAtItsNextYieldPoint) {
  const auto cancellation = std::make_shared<Cancellation>();
  absl::Status status;
  const auto released = std::make_shared<int>(0);
  slow_.Post(
      "alice",
      [&](const absl::Status&) {
        status = SlowExecutor::OrCancelled([&, held = released] {
          cancellation->Cancel();
          return Endless();
        });
        YieldPoint();  // has no effect outside
        ran_.emplace_back("a1");
      },
      cancellation);
  threads_.run();
  EXPECT_TRUE(absl::IsCancelled(status)) << status;
  EXPECT_EQ(released.use_count(), 1);
  EXPECT_THAT(ran_, ElementsAre("a1"));
}

TEST_F(SlowExecutorTest, StopEndsWorkAtItsNextYieldPoint) {
  absl::StatusOr<int> result = 0;
  slow_.Post("alice", [&](const absl::Status&) {
    result = SlowExecutor::OrCancelled([&]() -> absl::StatusOr<int> {
      slow_.Stop();
      return Endless();
    });
  });
  threads_.run();
  EXPECT_TRUE(absl::IsUnavailable(result.status()));
  EXPECT_EQ(GetErrorDetails(result.status()).reason, "DRAINING");
}

TEST_F(SlowExecutorTest, ElsewhereWorkIsNotCancelled) {
  EXPECT_TRUE(SlowExecutor::Running().status().ok());
  const auto cancellation = std::make_shared<Cancellation>();
  slow_.Post(
      "alice", [&](const absl::Status&) { cancellation->Cancel(); }, cancellation);
  threads_.run();
  EXPECT_TRUE(SlowExecutor::Running().status().ok());
  EXPECT_EQ(*SlowExecutor::OrCancelled([]() -> absl::StatusOr<int> {
    YieldPoint();
    return 3;
  }),
            3);
}

TEST_F(SlowExecutorTest, AnItemThatTakesLongLetsAnotherTenantsItemBegin) {
  SlowExecutor slow(threads_.get_executor(), {.running = 1, .long_items = 1});
  slow.Post("mallory", [&](const absl::Status&) {
    const absl::Status status = SlowExecutor::OrCancelled([&] {
      while (threads_.poll_one() == 0) YieldPoint();  // as another thread would
      return absl::OkStatus();
    });
    EXPECT_TRUE(status.ok());
    ran_.emplace_back("mallory");
  });
  slow.Post("mallory", Note("mallory again"));
  slow.Post("alice", Note("alice"));
  threads_.run();
  EXPECT_THAT(ran_, ElementsAre("alice", "mallory", "mallory again"));
}

TEST_F(SlowExecutorTest, AnItemThatWaitsLetsAnotherTenantsItemBegin) {
  SlowExecutor::LeavePlaceToWait();  // has no effect outside an item
  SlowExecutor slow(threads_.get_executor(), {.running = 1, .long_items = 1});
  const auto ran_while_waiting = [&] {
    SlowExecutor::LeavePlaceToWait();
    while (threads_.poll_one() > 0) {  // as other threads would
    }
    return ran_;
  };
  slow.Post("mallory", [&](const absl::Status&) {
    EXPECT_THAT(ran_while_waiting(), ElementsAre("alice", "bob"));
    EXPECT_THAT(ran_while_waiting(), ElementsAre("alice", "bob")) << "it has left its place once";
  });
  slow.Post("mallory", Note("mallory again"));
  slow.Post("alice", [&](const absl::Status&) {
    EXPECT_THAT(ran_while_waiting(), IsEmpty()) << "the place for a long item is taken";
    ran_.emplace_back("alice");
  });
  slow.Post("bob", Note("bob"));
  threads_.run();
  EXPECT_THAT(ran_, ElementsAre("alice", "bob", "mallory again"));
}

TEST_F(SlowExecutorTest, NoMoreItemsTakeLongThanArePermitted) {
  SlowExecutor slow(threads_.get_executor(), {.running = 1, .long_items = 1});
  std::vector<std::string> during;
  const auto begin = std::chrono::steady_clock::now();
  slow.Post("mallory", [&](const absl::Status&) {
    const absl::Status status = SlowExecutor::OrCancelled([&] {
      while (threads_.poll_one() == 0) YieldPoint();
      return absl::OkStatus();
    });
    EXPECT_TRUE(status.ok());
    during = ran_;
  });
  slow.Post("eve", [&](const absl::Status&) {
    // The place for a long item is taken, so that `alice` waits although this one takes long, too.
    const absl::Status status = SlowExecutor::OrCancelled([&] {
      while (std::chrono::steady_clock::now() < begin + 4 * SlowExecutor::kLongItem) {
        EXPECT_EQ(threads_.poll_one(), 0u);
        YieldPoint();
      }
      return absl::OkStatus();
    });
    EXPECT_TRUE(status.ok());
    ran_.emplace_back("eve");
  });
  slow.Post("alice", Note("alice"));
  threads_.run();
  EXPECT_THAT(during, ElementsAre("eve"));
  EXPECT_THAT(ran_, ElementsAre("eve", "alice"));
}

// Posts items that overlap others of their tenant, from an item of mallory that has its thread.
class OverlappingItemsTest : public SlowExecutorTest {
 protected:
  void PostOverlapping(const std::string& tenant, const std::string& name) {
    slow_.Post(tenant, Note(name), std::make_shared<Cancellation>(), Overlap::kAny);
  }
  // Runs `post` in an item of mallory, then what begins beside that item. Returns what has run then.
  std::vector<std::string> RunsBeside(const std::function<void()>& post) {
    std::vector<std::string> during;
    slow_.Post("mallory", [&](const absl::Status&) {
      post();
      while (threads_.poll_one() > 0) {  // as other threads would
      }
      during = ran_;
    });
    threads_.run();
    return during;
  }
  // Does the same while items of mallory and alice have the two threads for all items.
  std::vector<std::string> RunsBesideBoth(const std::function<void()>& post) {
    std::vector<std::string> during;
    RunsBeside([&] {
      slow_.Post("alice", [&](const absl::Status&) {
        post();
        while (threads_.poll_one() > 0) {
        }
        during = ran_;
      });
    });
    return during;
  }

  SlowExecutor slow_{threads_.get_executor(), {.running = 2, .overlapping = 2}};
};

TEST_F(OverlappingItemsTest, RunBesideAndBeforeTheOtherItemsOfTheirTenant) {
  const auto post = [this] {
    slow_.Post("mallory", Note("m1"));
    for (const char* const name : {"m2", "m3", "m4"}) PostOverlapping("mallory", name);
    slow_.Post("mallory", Note("m5"));
  };
  EXPECT_THAT(RunsBeside(post), ElementsAre("m2", "m3", "m4"));
  EXPECT_THAT(ran_, ElementsAre("m2", "m3", "m4", "m1", "m5"));
}

TEST_F(OverlappingItemsTest, RunAtTheSameTimeUpToTheirNumber) {
  int num_running = 0, most_running = 0;
  const auto nested = [&](const absl::Status&) {
    most_running = std::max(most_running, ++num_running);
    while (threads_.poll_one() > 0) {
    }
    --num_running;
  };
  for (int i = 0; i < 6; ++i) slow_.Post("alice", nested, std::make_shared<Cancellation>(), Overlap::kAny);
  threads_.run();
  EXPECT_EQ(most_running, 3) << "one with the thread of the tenant, and two beside it";
}

TEST_F(OverlappingItemsTest, DoNotBeginWhileAnotherTenantWaits) {
  const auto post = [this] {
    slow_.Post("bob", Note("b1"));
    PostOverlapping("mallory", "m1");
    PostOverlapping("alice", "a1");
  };
  EXPECT_THAT(RunsBesideBoth(post), IsEmpty());
  EXPECT_THAT(ran_, ElementsAre("b1", "a1", "m1"));
}

TEST_F(OverlappingItemsTest, BeginBesideTheItemsOfOtherTenantsWhoseTenantHasNone) {
  EXPECT_THAT(RunsBesideBoth([this] { PostOverlapping("bob", "b1"); }), ElementsAre("b1"));
}

TEST_F(OverlappingItemsTest, EachTenantHasOneBeforeAnotherOneHasTwo) {
  const auto post = [this] {
    for (const char* const name : {"m1", "m2"}) PostOverlapping("mallory", name);  // they have the further threads
    PostOverlapping("alice", "a1");
    PostOverlapping("bob", "b1");
  };
  EXPECT_THAT(RunsBesideBoth(post), ElementsAre("m1", "m2", "b1", "a1"));
}

TEST_F(OverlappingItemsTest, LeaveTheThreadsToTheOtherTenants) {
  std::vector<std::string> during;
  const auto last = [&](const absl::Status&) {
    slow_.Post("alice", Note("a1"));
    PostOverlapping("mallory", "m1");
    while (threads_.poll_one() > 0) {
    }
    during = ran_;
  };
  const auto beside = [&](const absl::Status&) {
    slow_.Post("mallory", last, std::make_shared<Cancellation>(), Overlap::kAny);
    threads_.poll_one();
  };
  RunsBeside([&] { slow_.Post("mallory", beside, std::make_shared<Cancellation>(), Overlap::kAny); });
  EXPECT_THAT(during, ElementsAre("a1")) << "three items of mallory run";
}

TEST_F(OverlappingItemsTest, APostDoesNotVisitTheWaitingItems) {
  const auto time_of_posts = [this](int count) {
    const auto begin = FairScheduler::ThreadCpuTime();
    for (int i = 0; i < count; ++i) Post("alice", "a");
    return FairScheduler::ThreadCpuTime() - begin;
  };
  time_of_posts(1000);
  const auto few_wait = time_of_posts(1000);
  time_of_posts(30'000);
  EXPECT_LT(time_of_posts(1000), 10 * few_wait) << "about 30 times as long if each waiting item is visited";
}

TEST_F(OverlappingItemsTest, StopEndsAllOfThem) {
  const auto running = std::make_shared<Cancellation>();
  RunsBeside([&] {
    slow_.Post(
        "mallory",
        [&](const absl::Status&) {
          slow_.Stop();
          EXPECT_TRUE(running->is_cancelled());
        },
        running, Overlap::kAny);
    PostOverlapping("mallory", "m1");  // a thread is about to run it
    PostOverlapping("mallory", "m2");
  });
  EXPECT_THAT(ran_, IsEmpty());
  EXPECT_THAT(rejected_, UnorderedElementsAre("m1 UNAVAILABLE DRAINING", "m2 UNAVAILABLE DRAINING"));
}

// Whichever allocation fails, an item is refused or run, and the one after it is run.
TEST_F(SlowExecutorTest, WithoutMemoryAnItemIsRefusedOrRunAndTheNextOneIsRun) {
  const std::string tenant = kLongTenant;
  int num_refused = 0;
  bool has_failed = true;
  for (int number = 0; has_failed; ++number) {
    const auto cancellation = std::make_shared<Cancellation>();
    SlowExecutor::Work work = Note("first");
    bool is_refused = false;
    has_failed = FailsAllocation(number, [&] {
      try {
        slow_.Post(tenant, std::move(work), cancellation);
      } catch (const std::bad_alloc&) {
        is_refused = true;
      }
    });
    num_refused += is_refused;
    EXPECT_EQ(RunWithSecond(),
              is_refused ? std::vector<std::string>({"second"}) : std::vector<std::string>({"first", "second"}))
        << number;
  }
  EXPECT_GT(num_refused, 0);
}

TEST_F(SlowExecutorTest, WithoutMemoryTryPostReturnsAnError) {
  const std::string tenant = kLongTenant;
  int num_refused = 0;
  bool has_failed = true;
  for (int number = 0; has_failed; ++number) {
    // Too large for the inside of Work, so that the conversion allocates, too.
    const auto work = [this, large = std::array<char, 256>()](const absl::Status& admitted) {
      ran_.push_back(absl::StatusCodeToString(admitted.code()) + large.data());
    };
    absl::Status posted;
    has_failed = FailsAllocation(number, [&] { posted = slow_.TryPost(tenant, work); });
    num_refused += !posted.ok();
    EXPECT_EQ(GetErrorDetails(posted).reason, posted.ok() ? "" : "OUT_OF_MEMORY");
    EXPECT_EQ(RunWithSecond(),
              posted.ok() ? std::vector<std::string>({"OK", "second"}) : std::vector<std::string>({"second"}))
        << number;
  }
  EXPECT_GT(num_refused, 2);
}

}  // namespace
}  // namespace evpose::server
