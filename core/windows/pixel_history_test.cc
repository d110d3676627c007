// SPDX-License-Identifier: Apache-2.0
#include "core/windows/pixel_history.h"

#include <gtest/gtest.h>

#include <vector>

#include "core/base/state_io.h"
#include "core/base/yields_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

TEST(PixelHistory, ReturnsThePreviousPolarity) {
  PixelHistory history({4, 3});
  EXPECT_EQ(history.Next({10, 3, 2, 1}).previous, PreviousPolarity::kUnknown);
  EXPECT_EQ(history.Next({20, 3, 2, 1}).previous, PreviousPolarity::kSame);
  EXPECT_EQ(history.Next({30, 2, 2, 0}).previous, PreviousPolarity::kUnknown) << "another pixel";
  const WindowEvent event = history.Next({40, 3, 2, 0});
  EXPECT_EQ(event.previous, PreviousPolarity::kOther);
  EXPECT_EQ(static_cast<const Event&>(event), (Event{40, 3, 2, 0}));
  EXPECT_EQ(history.Next({50, 3, 2, 0}).previous, PreviousPolarity::kSame);
}

TEST(PixelHistory, IsUnknownOutsideTheSensor) {
  PixelHistory history({4, 3});
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(history.Next({10, 4, 0, 1}).previous, PreviousPolarity::kUnknown);
    EXPECT_EQ(history.Next({10, 0, 3, 1}).previous, PreviousPolarity::kUnknown);
  }
  EXPECT_EQ(history.Next({20, 0, 0, 1}).previous, PreviousPolarity::kUnknown) << "not the pixel of another row";
}

TEST(PixelHistory, PixelsThatShareAByteAreIndependent) {
  constexpr uint16_t kWidth = 7, kHeight = 5;  // the last byte has fewer than four pixels
  PixelHistory history({kWidth, kHeight});
  std::vector<int> last(size_t{kWidth} * kHeight, -1);
  Random random(5);
  for (int i = 0; i < 10'000; ++i) {
    const auto x = static_cast<uint16_t>(random.Uniform(0.0, kWidth));
    const auto y = static_cast<uint16_t>(random.Uniform(0.0, kHeight));
    const auto polarity = static_cast<uint8_t>(random.Uniform(0.0, 2.0));
    int& expected = last[y * kWidth + x];
    const PreviousPolarity previous = expected == -1         ? PreviousPolarity::kUnknown
                                      : expected == polarity ? PreviousPolarity::kSame
                                                             : PreviousPolarity::kOther;
    ASSERT_EQ(history.Next({i, x, y, polarity}).previous, previous) << i;
    expected = polarity;
  }
}

TEST(PixelHistory, SavingALargeOneHasYieldPoints) {
  const PixelHistory history({2048, 1024});  // without events it is saved as one run of few bytes
  StateWriter writer;
  EXPECT_GT(CountYields([&] { history.SaveState(writer); }), 100u);
  EXPECT_LT(writer.size(), 16u);
}

}  // namespace
}  // namespace evpose
