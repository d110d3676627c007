// SPDX-License-Identifier: Apache-2.0
#include "core/windows/pixel_history.h"

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace evpose
