// SPDX-License-Identifier: Apache-2.0
#include "core/events/image_size.h"

#include <gtest/gtest.h>

namespace evpose {
namespace {

TEST(ParseImageSizeTest, TakesTwoPositiveNumbers) {
  EXPECT_EQ(ParseImageSize("1280x720"), (SensorGeometry{1280, 720}));
  for (const char* text : {"", "x", "1280", "1280x", "1280x0", "-1x720", "1280x720x3", "1280 720", "99999999999x1"}) {
    EXPECT_EQ(ParseImageSize(text), std::nullopt) << text;
  }
}

}  // namespace
}  // namespace evpose
