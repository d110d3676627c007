// SPDX-License-Identifier: Apache-2.0
#include "core/base/counted.h"

#include <gtest/gtest.h>

namespace evpose {
namespace {

TEST(CountedTest, OneIsSingularAndAllOthersArePlural) {
  EXPECT_EQ(Counted(0, "line"), "0 lines");
  EXPECT_EQ(Counted(1, "line"), "1 line");
  EXPECT_EQ(Counted(2, "line"), "2 lines");
  EXPECT_EQ(Counted(1, "symmetry", "symmetries"), "1 symmetry");
  EXPECT_EQ(Counted(24, "symmetry", "symmetries"), "24 symmetries");
}

}  // namespace
}  // namespace evpose
