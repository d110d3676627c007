// SPDX-License-Identifier: Apache-2.0

// The runs of each instruction set have the events of the scalar rules, and end where these require it.
#include "core/events/word_runs.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>

#include "core/events/events_testing.h"

namespace evpose {
namespace {

constexpr uint32_t kWidthPx = 640;
constexpr uint32_t kHeightPx = 480;

// The scalar rules of one word: false if it is not plain; else updates `run` and `events` and returns true.
bool Step(uint16_t word, Evt3Run& run, std::vector<Event>& events) {
  const uint32_t content = word & 0xfff;
  switch (word >> 12) {
    case 0x0:
      if (content >= run.height_px) return false;
      run.row = content;
      return true;
    case 0x2: {
      const auto x = static_cast<uint16_t>(content & 0x7ff);
      if (x >= run.width_px) return false;
      events.push_back(
          {run.base_us + run.low_us, x, static_cast<uint16_t>(run.row), static_cast<uint8_t>(content >> 11)});
      return true;
    }
    case 0x6:
      if (content < run.low_us || run.base_us + content >= run.mark_due_us) return false;
      run.low_us = content;
      return true;
    case 0x8:
      return content == ((run.base_us >> 12) & 0xfff);
    default:
      return false;
  }
}

// The scalar rules at the start of `words`: returns the number of plain words that were decoded together, 0 for a word
// that is not plain.
size_t Steps(absl::Span<const uint16_t> words, Evt3Run& run, std::vector<Event>& events) {
  if (Step(words[0], run, events)) return 1;
  constexpr int kTypes[] = {3, 4, 4, 5};
  if (words.size() < 4) return 0;
  for (size_t i = 0; i < 4; ++i) {
    if (words[i] >> 12 != kTypes[i]) return 0;
  }
  const uint32_t x = words[0] & 0x7ff;
  const auto polarity = static_cast<uint8_t>(words[0] >> 11 & 1);
  if (x + 32 > run.width_px) return 0;
  for (uint32_t i = 0; i < 32; ++i) {
    if ((words[1 + i / 12] >> i % 12 & 1) == 0) continue;
    events.push_back(
        {run.base_us + run.low_us, static_cast<uint16_t>(x + i), static_cast<uint16_t>(run.row), polarity});
  }
  run.base = {true, x + 32, polarity};
  return 4;
}

bool StepEvt2(uint32_t word, uint32_t mask, Evt2Run& run, std::vector<Event>& events) {
  const uint32_t type = word >> 28;
  if (type == 8) return (word & 0xfffffff) == ((run.base_us >> 6) & 0xfffffff) && run.base_us + 63 < run.mark_due_us;
  const int64_t low_us = word >> 22 & 0x3f;
  if (type > 1 || low_us < run.low_us || std::popcount(mask) != 1) return false;
  const uint32_t x = (word >> 11 & 0x7ff) + static_cast<uint32_t>(std::countr_zero(mask));
  const uint32_t y = word & 0x7ff;
  if (x >= run.width_px || y >= run.height_px) return false;
  run.low_us = low_us;
  events.push_back(
      {run.base_us + low_us, static_cast<uint16_t>(x), static_cast<uint16_t>(y), static_cast<uint8_t>(type)});
  return true;
}
bool Step(uint32_t word, Evt2Run& run, std::vector<Event>& events) { return StepEvt2(word, 1, run, events); }
bool Step(uint64_t word, Evt2Run& run, std::vector<Event>& events) {
  return StepEvt2(static_cast<uint32_t>(word >> 32), static_cast<uint32_t>(word), run, events);
}
template <typename Word>
size_t Steps(absl::Span<const Word> words, Evt2Run& run, std::vector<Event>& events) {
  return Step(words[0], run, events) ? 1 : 0;
}

// Random words; on average one in `rarity` is not plain, for a randomly chosen reason.
class RandomWords {
 public:
  RandomWords(Random& random, uint64_t rarity) : random_(random), rarity_(rarity) {}

  uint16_t Next(const Evt3Run& run, uint16_t) {
    if (!due_.empty()) {
      const uint16_t word = due_.front();
      due_.erase(due_.begin());
      return IsOdd() ? static_cast<uint16_t>(Any()) : word;
    }
    const uint64_t kind = random_.UniformInt(20);
    if (random_.UniformInt(12) == 0) {
      due_ = {Evt3(0x4, Any() & 0xfff), Evt3(0x4, Any() & Any() & Any() & 0xfff), Evt3(0x5, Any() & Any() & 0xfff)};
      const uint32_t end = IsOdd() ? run.width_px - 31 : run.width_px - 32;
      return Evt3(0x3, (Any() & 0x800) | (IsOdd() ? end : static_cast<uint32_t>(random_.UniformInt(end + 1))));
    }
    if (IsOdd()) return static_cast<uint16_t>(Any());
    if (kind < 9) return Evt3(0x0, Coordinate(run.height_px));
    if (kind < 18) return Evt3(0x2, (Any() & 0x800) | Coordinate(run.width_px));
    if (kind < 19) return Evt3(0x6, NextLow(run.low_us, 0xfff));
    return Evt3(0x8, static_cast<uint32_t>(run.base_us >> 12) & 0xfff);
  }

  uint32_t Next(const Evt2Run& run, uint32_t) {
    if (IsOdd()) return Any();
    if (random_.UniformInt(20) == 0) return Evt2(0x8, static_cast<uint32_t>(run.base_us >> 6) & 0xfffffff);
    return Evt2Cd(Any() & 1, NextLow(run.low_us, 63), Coordinate(run.width_px), Coordinate(run.height_px));
  }

  uint64_t Next(const Evt2Run& run, uint64_t) {
    const uint32_t upper = Next(run, uint32_t{});
    const uint32_t to_the_edge = run.width_px - std::min(upper >> 11 & 0x7ff, run.width_px - 1);
    const uint32_t num_pixels = std::min(IsOdd() ? to_the_edge + 1 : to_the_edge, 32u);
    uint32_t mask = 1u << random_.UniformInt(num_pixels);
    if (IsOdd()) mask = random_.UniformInt(2) == 0 ? 0 : Any();
    return static_cast<uint64_t>(upper) << 32 | mask;
  }

 private:
  uint32_t Any() { return static_cast<uint32_t>(random_.NextU64()); }
  bool IsOdd() { return random_.UniformInt(rarity_) == 0; }

  // An address of 11 bits: random below `size`, the last one below it, or the first one beyond.
  uint32_t Coordinate(uint32_t size) {
    if (IsOdd()) return (size - static_cast<uint32_t>(random_.UniformInt(2))) & 0x7ff;
    return static_cast<uint32_t>(random_.UniformInt(size));
  }

  uint32_t NextLow(int64_t first_us, uint32_t max) {
    if (IsOdd()) return static_cast<uint32_t>(random_.UniformInt(max + 1));
    low_us_ = std::min(std::max(low_us_, static_cast<uint32_t>(first_us)) + Any() % 2, max);
    return low_us_;
  }

  Random& random_;
  const uint64_t rarity_;
  uint32_t low_us_ = 0;
  std::vector<uint16_t> due_;  // the rest of a vector of EVT3
};

Evt3Run RandomRun(Random& random, Evt3Run) {
  Evt3Run run = {kWidthPx, kHeightPx, static_cast<int64_t>(random.UniformInt(1 << 20)) << 12};
  if (random.UniformInt(4) == 0) run.width_px = run.height_px = 1 << 11;
  run.low_us = static_cast<int64_t>(random.UniformInt(0x1000));
  run.mark_due_us = run.base_us + run.low_us + 1 + static_cast<int64_t>(random.UniformInt(1000));
  run.row = static_cast<uint32_t>(random.UniformInt(run.height_px));
  return run;
}

Evt2Run RandomRun(Random& random, Evt2Run) {
  Evt2Run run = {kWidthPx, kHeightPx, static_cast<int64_t>(random.UniformInt(uint64_t{1} << 40)) << 6};
  if (random.UniformInt(4) == 0) run.width_px = run.height_px = 1 << 11;
  run.low_us = static_cast<int64_t>(random.UniformInt(64));
  run.mark_due_us = run.base_us + static_cast<int64_t>(random.UniformInt(1000));
  return run;
}

bool SameState(const Evt3Run& a, const Evt3Run& b) {
  return a.low_us == b.low_us && a.row == b.row && a.base == b.base;
}
bool SameState(const Evt2Run& a, const Evt2Run& b) { return a.low_us == b.low_us; }

// Whether one of the first words ends the run or is no event: only such a block may be left to the scalar loop.
template <typename Word, typename Run>
bool MayStopBefore(absl::Span<const Word> words, Run run, bool only_events) {
  std::vector<Event> events;
  size_t num_words = 1;
  for (size_t i = 0; i < std::min(words.size(), kMaxRunBlock); i += num_words) {
    const size_t num_before = events.size();
    num_words = Steps(words.subspan(i), run, events);
    if (num_words == 0 || (only_events && events.size() == num_before)) return true;
  }
  return words.size() < kMaxRunBlock;
}

// Returns the number of words of the run.
template <typename Word, typename Run>
size_t CheckRun(DecodeRunOf<Run> decode, const std::vector<Word>& words, const Run& before, size_t max_events) {
  const Event unwritten = {-1, 1, 2, 3};
  std::vector<Event> out(max_events + 2 * kMaxRunBlock, unwritten);
  Run run = before;
  Event* cursor = out.data();
  const size_t num_words =
      decode(reinterpret_cast<const uint8_t*>(words.data()), words.size(), run, cursor, out.data() + max_events);
  EXPECT_LE(num_words, words.size());
  Run expected_run = before;
  std::vector<Event> expected;
  const absl::Span<const Word> decoded = absl::MakeConstSpan(words).first(num_words);
  for (size_t i = 0, step = 0; i < num_words; i += step) {
    step = Steps(decoded.subspan(i), expected_run, expected);
    if (step == 0) {
      ADD_FAILURE() << "word " << i;
      break;
    }
  }
  EXPECT_TRUE(SameState(run, expected_run));
  const auto num_events = static_cast<size_t>(cursor - out.data());
  EXPECT_EQ(std::vector<Event>(out.data(), out.data() + num_events), expected);
  if (num_events < max_events) {
    EXPECT_TRUE(MayStopBefore(absl::MakeConstSpan(words).subspan(num_words), run, sizeof(Word) > 2));
  }
  // At most the events of a block are written beyond the cursor.
  for (size_t i = num_events + kMaxRunBlock; i < out.size(); ++i) EXPECT_EQ(out[i], unwritten);
  return num_words;
}

template <typename Word, typename Run>
void CheckRuns(DecodeRunOf<Run> decode) {
  Random random(17);
  size_t longest = 0;
  for (int round = 0; round < 3000; ++round) {
    const Run run = RandomRun(random, Run());
    const uint64_t rarity = uint64_t{1} << (1 + random.UniformInt(12));
    std::vector<Word> words(random.UniformInt(200));
    RandomWords random_words(random, rarity);
    for (Word& word : words) word = random_words.Next(run, Word{});
    longest = std::max(longest, CheckRun(decode, words, run, 1 + random.UniformInt(200)));
    ASSERT_FALSE(testing::Test::HasFailure()) << "round " << round;
  }
  EXPECT_GT(longest, 4 * kMaxRunBlock);
}

class WordRunsTest : public testing::TestWithParam<const WordRuns* (*)()> {
 protected:
  void SetUp() override {
    if (GetParam()() == nullptr) GTEST_SKIP() << "the processor does not have the instructions";
  }
  const WordRuns& runs() const { return *GetParam()(); }
};

TEST_P(WordRunsTest, Evt3) { CheckRuns<uint16_t>(runs().evt3); }
TEST_P(WordRunsTest, Evt2) { CheckRuns<uint32_t>(runs().evt2); }
TEST_P(WordRunsTest, Evt21) { CheckRuns<uint64_t>(runs().evt21); }

INSTANTIATE_TEST_SUITE_P(Instructions, WordRunsTest, testing::Values(&Avx2WordRuns, &Avx512WordRuns),
                         [](const auto& test) { return test.param == &Avx2WordRuns ? "Avx2" : "Avx512"; });

TEST(RunPauseTest, GrowsAfterShortRunsAndShrinksAfterLongOnes) {
  RunPause pause;
  EXPECT_EQ(pause.WordsAfter(1000), 1u);
  size_t last = 1;
  for (int i = 0; i < 30; ++i) {
    const size_t words = pause.WordsAfter(3);
    EXPECT_TRUE(words > last || words == 257) << words;
    last = words;
  }
  EXPECT_EQ(last, 257u);
  EXPECT_LT(pause.WordsAfter(100), 200u);
  EXPECT_EQ(pause.WordsAfter(1000), 1u);
}

}  // namespace
}  // namespace evpose
