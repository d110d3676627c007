// SPDX-License-Identifier: Apache-2.0
#include "core/windows/event_window.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "core/numerics/random.h"
#include "core/windows/windows_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

struct SeenWindow {
  int64_t t_begin_us;
  int64_t t_end_us;
  std::vector<Event> events;
  uint64_t num_events;
  bool has_few_events;
  ByPolarity events_per_sample = {1.0, 1.0};

  friend bool operator==(const SeenWindow&, const SeenWindow&) = default;
};

class Recorder {
 public:
  explicit Recorder(const WindowOptions& options) : windower_(options, {1280, 720}) {}

  void Add(absl::Span<const Event> events) { windower_.Add(events, on_window_); }
  void AdvanceTime(int64_t t_us) { windower_.AdvanceTime(t_us, on_window_); }
  void Finish() { windower_.Finish(on_window_); }
  void SetImageSpeed(double speed_px_per_s) { windower_.SetImageSpeed(speed_px_per_s); }
  const std::vector<SeenWindow>& windows() const { return windows_; }

 private:
  EventWindower windower_;
  std::vector<SeenWindow> windows_;
  std::function<void(const EventWindow&)> on_window_ = [this](const EventWindow& window) {
    windows_.push_back({window.t_begin_us,
                        window.t_end_us,
                        {window.events.begin(), window.events.end()},
                        window.num_events,
                        window.has_few_events,
                        window.events_per_sample});
  };
};

// `count` events, one every `period_us`; x is the event's index.
std::vector<Event> Regular(int64_t t_us, int64_t period_us, int count) {
  std::vector<Event> events;
  for (int i = 0; i < count; ++i) {
    events.push_back({t_us + i * period_us, static_cast<uint16_t>(i), 7, static_cast<uint8_t>(i & 1)});
  }
  return events;
}

TEST(EventWindower, ClosesAtTheIntervalWhenThereAreEnoughEvents) {
  Recorder recorder(SmallOptions());
  recorder.Add(Regular(1000, 10, 25));  // 10 events in each interval
  ASSERT_EQ(recorder.windows().size(), 2u);
  EXPECT_EQ(recorder.windows()[0].t_begin_us, 1000);
  EXPECT_EQ(recorder.windows()[0].t_end_us, 1100);
  EXPECT_EQ(recorder.windows()[0].num_events, 10u);
  EXPECT_FALSE(recorder.windows()[0].has_few_events);
  EXPECT_EQ(recorder.windows()[1].t_begin_us, 1100);
  EXPECT_EQ(recorder.windows()[1].events.front().t_us, 1100);  // an event at the boundary belongs to the next window
}

TEST(EventWindower, MergesIntervalsWithTooFewEvents) {
  Recorder recorder(SmallOptions());
  recorder.Add(Regular(0, 40, 20));  // 2 or 3 events in each interval
  ASSERT_GE(recorder.windows().size(), 2u);
  EXPECT_EQ(recorder.windows()[0].t_end_us, 200);
  EXPECT_EQ(recorder.windows()[0].num_events, 5u);
  EXPECT_FALSE(recorder.windows()[0].has_few_events);
}

TEST(EventWindower, IntervalLengthFollowsTheImageSpeed) {
  Recorder recorder(SmallOptions());
  auto next_duration_us = [&, t_us = int64_t{0}](double speed_px_per_s) mutable {
    recorder.SetImageSpeed(speed_px_per_s);
    const size_t count = recorder.windows().size();
    for (; recorder.windows().size() < count + 2; t_us += 5) recorder.Add(Regular(t_us, 1, 1));
    const SeenWindow& window = recorder.windows().back();
    return window.t_end_us - window.t_begin_us;
  };
  EXPECT_EQ(next_duration_us(0.0), 100);
  EXPECT_EQ(next_duration_us(10'000.0), 100);
  EXPECT_EQ(next_duration_us(2.0 / 70e-6), 70);
  EXPECT_EQ(next_duration_us(1e9), 40) << "the lower bound";
  EXPECT_EQ(next_duration_us(10'000.0), 100) << "the length follows a decrease of the speed immediately";
}

TEST(EventWindower, AFastImageDoesNotMakeWindowsOfTooFewEvents) {
  Recorder recorder(SmallOptions());
  recorder.SetImageSpeed(1e9);
  recorder.Add(Regular(0, 30, 20));  // one or two events in each interval of 40 us
  ASSERT_GE(recorder.windows().size(), 2u);
  for (const SeenWindow& window : recorder.windows()) EXPECT_GE(window.num_events, 5u);
}

TEST(EventWindower, AbovePointThreeMillionEventsPerSecondThereIsAWindowEveryMillisecond) {
  Random random(4);
  Recorder recorder(WindowOptions{});
  std::vector<Event> events;
  for (int64_t t_us = 0; t_us < 200'000; t_us += 10) {
    // Events come in groups of four, as an edge that passes a pixel produces them.
    for (uint32_t k = 4 * random.Poisson(0.3 * 10 / 4); k > 0; --k) events.push_back({t_us, 5, 7, 1});
  }
  recorder.Add(events);
  EXPECT_GE(recorder.windows().size(), 198u);
}

TEST(WindowOptions, APoseRateDeterminesTheIntervals) {
  EXPECT_EQ(WindowOptions::WithPoseRate(1000.0).interval_us, WindowOptions().interval_us);
  EXPECT_EQ(WindowOptions::WithPoseRate(1000.0).min_interval_us, WindowOptions().min_interval_us);
  EXPECT_EQ(WindowOptions().intervals_per_usual(), 1);
  const WindowOptions options = WindowOptions::WithPoseRate(10'000.0);
  EXPECT_TRUE(options.Validate().ok()) << options.Validate();
  EXPECT_EQ(options.intervals_per_usual(), 10);
  Recorder recorder(options);
  std::vector<Event> events;
  for (int64_t t_us = 0; t_us < 100'000; ++t_us) events.push_back({t_us, 5, 7, 1});
  recorder.Add(events);  // 150 in two intervals
  EXPECT_EQ(recorder.windows().size(), 499u);
  for (const SeenWindow& window : recorder.windows()) EXPECT_EQ(window.t_end_us - window.t_begin_us, 200);
}

TEST(EventWindower, ClosesAfterTheMaximumDurationWithoutMotionAndReportsIt) {
  Recorder recorder(SmallOptions());
  recorder.Add(Regular(0, 1, 1));
  recorder.AdvanceTime(999);
  EXPECT_TRUE(recorder.windows().empty());
  recorder.AdvanceTime(3000);
  ASSERT_EQ(recorder.windows().size(), 3u);
  EXPECT_EQ(recorder.windows()[0].t_end_us, 1000);
  EXPECT_EQ(recorder.windows()[0].num_events, 1u);
  EXPECT_EQ(recorder.windows()[2].num_events, 0u);
  for (const SeenWindow& window : recorder.windows()) EXPECT_TRUE(window.has_few_events);
}

TEST(EventWindower, WindowsFollowEachOtherWithoutGapOrOverlap) {
  Recorder recorder(SmallOptions());
  recorder.Add(Regular(0, 33, 100));
  recorder.AdvanceTime(9000);
  recorder.Add(Regular(9000, 3, 500));
  recorder.Finish();
  uint64_t events = 0;
  for (size_t k = 0; k < recorder.windows().size(); ++k) {
    const SeenWindow& window = recorder.windows()[k];
    if (k > 0) {
      EXPECT_EQ(window.t_begin_us, recorder.windows()[k - 1].t_end_us);
    }
    EXPECT_LT(window.t_begin_us, window.t_end_us);
    EXPECT_LE(window.t_end_us - window.t_begin_us, 6000);
    events += window.num_events;
  }
  EXPECT_EQ(events, 600u);
}

TEST(EventWindower, FloodIsSampledEvenlyAndKeepsItsDuration) {
  WindowOptions options = SmallOptions();
  options.max_events = 400;
  Recorder recorder(options);
  std::vector<Event> flood;
  for (int i = 0; i < 100'000; ++i) {  // pairs of neighbours, as the readout of a row across an edge produces them
    flood.push_back({i / 1000, static_cast<uint16_t>(i % 2), 0, 1});
  }
  recorder.Add(flood);
  recorder.AdvanceTime(100);
  ASSERT_EQ(recorder.windows().size(), 1u);
  const SeenWindow& window = recorder.windows()[0];
  EXPECT_EQ(window.t_end_us - window.t_begin_us, options.interval_us);
  EXPECT_EQ(window.num_events, 100'000u);
  EXPECT_LE(window.events.size(), 400u);
  EXPECT_GE(window.events.size(), 150u);
  const auto count_if = [&](auto predicate) {
    return static_cast<double>(std::count_if(window.events.begin(), window.events.end(), predicate)) /
           static_cast<double>(window.events.size());
  };
  EXPECT_NEAR(count_if([](const Event& e) { return e.x == 0; }), 0.5, 0.15);
  EXPECT_NEAR(count_if([](const Event& e) { return e.t_us < 50; }), 0.5, 0.15);
}

TEST(EventWindower, AFlickerBurstOfOnePolarityKeepsTheOther) {
  WindowOptions options = SmallOptions();
  options.max_events = 400;
  Recorder recorder(options);
  std::vector<Event> flood;
  for (int i = 0; i < 20'000; ++i) flood.push_back({i / 200, static_cast<uint16_t>(i % 500), 0, i % 100 == 0});
  recorder.Add(flood);
  recorder.AdvanceTime(100);
  ASSERT_EQ(recorder.windows().size(), 1u);
  const SeenWindow& window = recorder.windows()[0];
  const auto num_on =
      std::count_if(window.events.begin(), window.events.end(), [](const Event& e) { return e.polarity; });
  EXPECT_EQ(num_on, 200);  // all ON events
  EXPECT_EQ(window.events_per_sample[1], 1.0);
  const double num_off = static_cast<double>(window.events.size()) - 200.0;
  EXPECT_GE(num_off, 80.0);
  EXPECT_LE(num_off, 200.0);
  EXPECT_NEAR(num_off * window.events_per_sample[0], 19'800.0, 4.0 * std::sqrt(num_off) * window.events_per_sample[0]);
}

TEST(EventWindower, LateEventsJoinTheOpenWindow) {
  Recorder recorder(SmallOptions());
  recorder.Add(Regular(0, 10, 11));
  ASSERT_EQ(recorder.windows().size(), 1u);
  const std::vector<Event> late = {{30, 500, 7, 1}, {-1'000'000'000, 501, 7, 1}};
  recorder.Add(late);
  recorder.AdvanceTime(1100);
  ASSERT_EQ(recorder.windows().size(), 2u);
  const SeenWindow& window = recorder.windows()[1];
  EXPECT_EQ(window.num_events, 3u);
  for (const Event& event : window.events) EXPECT_EQ(event.t_us, 100);
}

TEST(EventWindower, ALongTimeWithoutEventsIsOneWindow) {
  Recorder recorder(SmallOptions());
  recorder.Add(Regular(0, 10, 3));
  const int64_t far_us = int64_t{1} << 50;
  recorder.AdvanceTime(far_us);
  ASSERT_EQ(recorder.windows().size(), 2u);
  EXPECT_EQ(recorder.windows()[0].num_events, 3u);
  EXPECT_EQ(recorder.windows()[1].num_events, 0u);
  EXPECT_EQ(recorder.windows()[1].t_end_us, far_us);
  recorder.Add(Regular(far_us, 10, 11));
  EXPECT_EQ(recorder.windows().size(), 3u);
}

TEST(EventWindower, TheDivisionIntoCallsDoesNotMatter) {
  std::vector<Event> events = Regular(0, 3, 2000);
  for (size_t i = 50; i < events.size(); i += 97) events[i].t_us -= 40;
  for (size_t i = 1500; i < events.size(); ++i) events[i].t_us = 4500 + static_cast<int64_t>(i - 1500) / 50;
  Recorder whole(SmallOptions());
  whole.Add(events);
  whole.Finish();
  for (const size_t step : {1u, 7u, 64u, 1000u}) {
    Recorder pieces(SmallOptions());
    for (size_t i = 0; i < events.size(); i += step) {
      pieces.Add(absl::MakeConstSpan(events).subspan(i, step));
    }
    pieces.Finish();
    EXPECT_EQ(pieces.windows(), whole.windows()) << step;
  }
}

TEST(EventWindower, FinishClosesTheOpenWindowOnce) {
  Recorder recorder(SmallOptions());
  recorder.Finish();
  EXPECT_TRUE(recorder.windows().empty());
  recorder.Add(Regular(0, 10, 3));
  recorder.Finish();
  recorder.Finish();
  ASSERT_EQ(recorder.windows().size(), 1u);
  EXPECT_EQ(recorder.windows()[0].t_end_us, 21);
}

TEST(WindowOptions, ValidateNamesTheField) {
  EXPECT_TRUE(WindowOptions().Validate().ok());
  const auto message = [](auto change) {
    WindowOptions options;
    change(options);
    return std::string(options.Validate().message());
  };
  EXPECT_THAT(message([](WindowOptions& o) { o.interval_us = 0; }), HasSubstr("interval_us"));
  EXPECT_THAT(message([](WindowOptions& o) { o.min_interval_us = o.interval_us + 1; }), HasSubstr("min_interval_us"));
  EXPECT_THAT(message([](WindowOptions& o) { o.max_motion_px = 0.0; }), HasSubstr("max_motion_px"));
  EXPECT_THAT(message([](WindowOptions& o) { o.max_duration_us = o.interval_us - 1; }), HasSubstr("max_duration_us"));
  EXPECT_THAT(message([](WindowOptions& o) { o.min_events = 0; }), HasSubstr("min_events"));
  EXPECT_THAT(message([](WindowOptions& o) { o.max_events = o.min_events - 1; }), HasSubstr("max_events"));
  EXPECT_THAT(message([](WindowOptions& o) { o.max_gap_us = 1; }), HasSubstr("max_gap_us"));
}

TEST(EventWindower, SkippedEventsAreInNoWindowButInThePixelHistory) {
  EventWindower windower(SmallOptions(), {1280, 720});
  std::vector<SeenWindow> windows;
  std::vector<PreviousPolarity> previous;
  const auto on_window = [&](const EventWindow& window) {
    windows.push_back({window.t_begin_us, window.t_end_us, {}, window.num_events, window.has_few_events});
    for (const WindowEvent& event : window.events) previous.push_back(event.previous);
  };
  windower.Add(Regular(1000, 10, 12), on_window);  // one window of 10, and 2 events in the next
  ASSERT_EQ(windows.size(), 1u);
  const EventGap gap = windower.Skip({{1200, 500, 7, 1}, {1250, 501, 7, 0}}, 1270);
  EXPECT_EQ(gap.t_begin_us, 1100) << "the events of the open window are discarded";
  EXPECT_EQ(gap.t_end_us, 1270);
  EXPECT_EQ(gap.num_events, 4u);
  EXPECT_EQ(windower.now_us(), 1270);
  const EventGap more = windower.Skip({{1300, 502, 7, 1}}, 1290);
  EXPECT_EQ(more.t_begin_us, 1270);
  EXPECT_EQ(more.t_end_us, 1300);
  EXPECT_EQ(more.num_events, 1u);

  previous.clear();
  windower.Add({{1310, 500, 7, 1}, {1311, 501, 7, 1}, {1312, 502, 7, 0}, {1313, 503, 7, 0}, {1314, 500, 7, 0}},
               on_window);
  windower.Finish(on_window);
  ASSERT_EQ(windows.size(), 2u);
  EXPECT_EQ(windows[1].t_begin_us, 1300);
  EXPECT_EQ(windows[1].num_events, 5u);
  using enum PreviousPolarity;
  EXPECT_THAT(previous, ::testing::ElementsAre(kSame, kOther, kOther, kUnknown, kOther));
}

TEST(EventWindower, SkippingBeforeTheFirstWindow) {
  EventWindower windower(SmallOptions(), {1280, 720});
  const EventGap gap = windower.Skip(Regular(700, 10, 3), 900);
  EXPECT_EQ(gap.t_begin_us, 700);
  EXPECT_EQ(gap.t_end_us, 900);
  EXPECT_EQ(gap.num_events, 3u);
  EXPECT_TRUE(windower.has_started());
}

}  // namespace
}  // namespace evpose
