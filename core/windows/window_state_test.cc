// SPDX-License-Identifier: Apache-2.0

// A windower, a pixel history and a window memory continue identically after they are saved and loaded.
#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "core/numerics/random.h"
#include "core/windows/event_window.h"
#include "core/windows/pixel_history.h"
#include "core/windows/window_memory.h"
#include "core/windows/windows_testing.h"

namespace evpose {
namespace {

constexpr SensorGeometry kSensor = {61, 37};

template <typename T>
std::string Save(const T& saved) {
  StateWriter writer;
  saved.SaveState(writer);
  return writer.Take();
}

template <typename T>
absl::Status Load(const std::string& state, T& loaded) {
  StateReader reader(state);
  loaded.LoadState(reader);
  return reader.Finish();
}

std::string Damaged(const std::string& state, Random& random) {
  std::string damaged = state;
  damaged[random.UniformInt(damaged.size())] ^= static_cast<char>(1 << random.UniformInt(8));
  return damaged;
}

Event RandomEvent(int64_t t_us, Random& random) {
  // Some events lie outside the sensor.
  return {t_us, static_cast<uint16_t>(random.UniformInt(kSensor.width_px + 1)),
          static_cast<uint16_t>(random.UniformInt(kSensor.height_px + 1)), static_cast<uint8_t>(random.UniformInt(2))};
}

// Alternates low and high event rates, with steps back in time and long times without events.
std::vector<Event> Stream(size_t count, uint64_t seed) {
  Random random(seed);
  std::vector<Event> events;
  int64_t t_us = 1'000'000;
  int64_t step_us = 30;
  while (events.size() < count) {
    if (random.UniformInt(300) == 0) step_us = random.UniformInt(2) == 0 ? 30 : 1;
    if (random.UniformInt(1000) == 0) t_us += static_cast<int64_t>(random.UniformInt(8000));
    t_us += static_cast<int64_t>(random.UniformInt(static_cast<uint64_t>(step_us) + 1)) - (step_us > 1 ? 2 : 0);
    events.push_back(RandomEvent(t_us, random));
  }
  return events;
}

struct Seen {
  int64_t t_begin_us;
  int64_t t_end_us;
  uint64_t num_events;
  bool has_few_events;
  std::vector<Event> events;
  std::vector<PreviousPolarity> previous;
  friend bool operator==(const Seen&, const Seen&) = default;
};

std::vector<Seen> Windows(const std::vector<Event>& events, bool is_moved) {
  std::vector<Seen> seen;
  auto windower = std::make_unique<EventWindower>(SmallOptions(), kSensor);
  const auto on_window = [&](const EventWindow& window) {
    Seen now{window.t_begin_us, window.t_end_us, window.num_events, window.has_few_events, {}, {}};
    for (const WindowEvent& event : window.events) {
      now.events.push_back(event);
      now.previous.push_back(event.previous);
    }
    seen.push_back(now);
    windower->SetImageSpeed(static_cast<double>(seen.size() % 7) * 10'000.0);
  };
  for (size_t i = 0; i < events.size(); i += 13) {
    windower->Add(absl::MakeConstSpan(events).subspan(i, 13), on_window);
    if (!is_moved) continue;
    const std::string state = Save(*windower);
    windower = std::make_unique<EventWindower>(SmallOptions(), kSensor);
    EXPECT_EQ(Load(state, *windower), absl::OkStatus());
    EXPECT_EQ(Save(*windower), state);
  }
  windower->Finish(on_window);
  return seen;
}

TEST(WindowStateTest, ALoadedWindowerContinuesIdentically) {
  const std::vector<Event> events = Stream(20'000, 1);
  const std::vector<Seen> expected = Windows(events, false);
  EXPECT_TRUE(Windows(events, true) == expected);
  EXPECT_TRUE(std::any_of(expected.begin(), expected.end(),
                          [](const Seen& window) { return window.events.size() < window.num_events; }));
  EXPECT_TRUE(std::any_of(expected.begin(), expected.end(), [](const Seen& window) { return window.has_few_events; }));
}

TEST(WindowStateTest, DamagedWindowersAreRejectedOrUsable) {
  const std::vector<Event> events = Stream(3000, 2);
  Random random(3);
  for (const size_t count : {0u, 100u, 1500u, 2900u}) {
    EventWindower windower(SmallOptions(), kSensor);
    const auto ignore = [](const EventWindow&) {};
    windower.Add(absl::MakeConstSpan(events).subspan(0, count), ignore);
    const std::string state = Save(windower);
    for (size_t size = 0; size < state.size(); size += 7) {
      EventWindower loaded(SmallOptions(), kSensor);
      EXPECT_EQ(Load(state.substr(0, size), loaded).code(), absl::StatusCode::kDataLoss);
    }
    for (int i = 0; i < 2000; ++i) {
      EventWindower loaded(SmallOptions(), kSensor);
      if (!Load(Damaged(state, random), loaded).ok()) continue;
      loaded.Add(absl::MakeConstSpan(events).subspan(count), [](const EventWindow& window) {
        ASSERT_LE(window.events.size(), 64u);
        ASSERT_LT(window.t_begin_us, window.t_end_us);
      });
    }
  }
}

TEST(WindowStateTest, PixelsTakeAtMostAFifthOfAByte) {
  PixelHistory history({1280, 720});
  EXPECT_LT(Save(history).size(), 20u) << "nothing was sent yet";
  Random random(4);
  for (int i = 0; i < 100'000; ++i) {
    history.Next({i, static_cast<uint16_t>(random.UniformInt(1280)), static_cast<uint16_t>(random.UniformInt(720)), 1});
  }
  EXPECT_LE(Save(history).size(), 1280u * 720 / 5 + 20);
}

TEST(WindowStateTest, DamagedPixelsAreRejectedOrValid) {
  Random random(5);
  PixelHistory history(kSensor);
  for (int i = 0; i < 200; ++i) history.Next(RandomEvent(i, random));
  const std::string state = Save(history);
  for (size_t size = 0; size < state.size(); ++size) {
    PixelHistory loaded(kSensor);
    EXPECT_EQ(Load(state.substr(0, size), loaded).code(), absl::StatusCode::kDataLoss);
  }
  PixelHistory smaller({kSensor.width_px, kSensor.height_px - 1});
  EXPECT_EQ(Load(state, smaller).code(), absl::StatusCode::kDataLoss);
  for (int i = 0; i < 5000; ++i) {
    PixelHistory loaded(kSensor);
    if (Load(Damaged(state, random), loaded).ok()) loaded.Next(RandomEvent(i, random));
  }
}

TEST(WindowStateTest, ALoadedMemoryHoldsTheSameWindows) {
  Random random(6);
  WindowMemory memory(5000, 50, 300);
  for (int64_t t_us = 0; t_us < 30'000; t_us += 700) {
    PixelHistory history(kSensor);
    std::vector<WindowEvent> events;
    for (uint64_t k = random.UniformInt(90); k > 0; --k) events.push_back(history.Next(RandomEvent(t_us + 5, random)));
    const EventWindow window{t_us, t_us + 700, events, 2 * events.size(), false, {2.0, 2.5}};
    const std::string state = Save(memory);
    WindowMemory loaded(5000, 50, 300);
    ASSERT_EQ(Load(state, loaded), absl::OkStatus());
    EXPECT_EQ(Save(loaded), state);
    loaded.Add(window);
    memory.Add(window);
    EXPECT_EQ(Save(loaded), Save(memory));
    EXPECT_EQ(loaded.num_events(), memory.num_events());
  }
  const std::string state = Save(memory);
  for (int i = 0; i < 5000; ++i) {
    WindowMemory loaded(5000, 50, 300);
    if (!Load(Damaged(state, random), loaded).ok()) continue;
    EXPECT_LE(loaded.num_events(), 300u);
    loaded.Add({40'000, 40'700, {}, 0, true});
  }
}

}  // namespace
}  // namespace evpose
