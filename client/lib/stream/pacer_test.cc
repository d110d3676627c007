// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/pacer.h"

#include <gtest/gtest.h>

#include <thread>

#include "client/lib/fake_clock_testing.h"

namespace evpose::client {
namespace {

TEST(Pacer, KeepsTheSensorsPace) {
  FakeClock clock;
  Pacer pacer(clock, 1.0);
  const absl::Time begin = clock.Now();
  EXPECT_TRUE(pacer.Wait(5'000'000, {}));
  EXPECT_EQ(clock.Now() - begin, absl::ZeroDuration());
  EXPECT_TRUE(pacer.Wait(5'001'000, {}));
  EXPECT_EQ(clock.Now() - begin, absl::Milliseconds(1));
  // Late by 3 ms: the next two are already due, and the delay does not accumulate.
  clock.Advance(absl::Milliseconds(3));
  EXPECT_TRUE(pacer.Wait(5'002'000, {}));
  EXPECT_EQ(clock.Now() - begin, absl::Milliseconds(4));
  EXPECT_TRUE(pacer.Wait(5'007'000, {}));
  EXPECT_EQ(clock.Now() - begin, absl::Milliseconds(7));
}

TEST(Pacer, RateScalesTime) {
  FakeClock clock;
  Pacer pacer(clock, 0.1);
  const absl::Time begin = clock.Now();
  pacer.Wait(0, {});
  pacer.Wait(1000, {});
  EXPECT_EQ(clock.Now() - begin, absl::Milliseconds(10));
}

TEST(Pacer, StepBackAndUnknownTimeDoNotWait) {
  FakeClock clock;
  Pacer pacer(clock, 1.0);
  const absl::Time begin = clock.Now();
  EXPECT_TRUE(pacer.Wait(-1, {}));
  EXPECT_TRUE(pacer.Wait(10'000, {}));
  EXPECT_TRUE(pacer.Wait(4'000, {}));
  EXPECT_EQ(clock.Now() - begin, absl::ZeroDuration());
}

TEST(Pacer, AsFastAsPossible) {
  FakeClock clock;
  Pacer pacer(clock, 0.0);
  const absl::Time begin = clock.Now();
  pacer.Wait(0, {});
  pacer.Wait(1'000'000'000, {});
  EXPECT_EQ(clock.Now(), begin);
}

TEST(Pacer, StopEndsTheWait) {
  Pacer pacer(SystemClock(), 1.0);
  std::stop_source stop;
  ASSERT_TRUE(pacer.Wait(0, stop.get_token()));
  std::jthread stopper([&stop] { stop.request_stop(); });
  EXPECT_FALSE(pacer.Wait(int64_t{1} << 50, stop.get_token()));  // 35 years
}

TEST(SystemClock, SleepsAndMovesOn) {
  Clock& clock = SystemClock();
  const absl::Time before = clock.Now();
  EXPECT_TRUE(clock.SleepUntil(before + absl::Milliseconds(1), {}));
  EXPECT_GE(clock.Now() - before, absl::Milliseconds(1));
}

}  // namespace
}  // namespace evpose::client
