// SPDX-License-Identifier: Apache-2.0
#include "client/cli/console/progress.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "client/lib/fake_clock_testing.h"

namespace evpose::client {
namespace {

using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::Not;

class ProgressTest : public ::testing::Test {
 protected:
  std::ostringstream out_, err_;
  CliContext context_{out_, err_};
};

TEST_F(ProgressTest, RewritesALineOfATerminal) {
  context_.is_err_terminal = true;
  ProgressLine line(context_);
  line.Show(0.5, "10 poses");
  EXPECT_EQ(err_.str(), "\r\x1b[K[############............] 10 poses");
  line.Clear();
  EXPECT_THAT(err_.str(), EndsWith("10 poses\r\x1b[K"));
  EXPECT_EQ(out_.str(), "");
}

TEST_F(ProgressTest, IsNotLongerThanTheTerminal) {
  context_.is_err_terminal = true;
  context_.err_columns = 40;
  { ProgressLine(context_).Show(0.5, "a text that is longer"); }
  EXPECT_THAT(err_.str(), HasSubstr("\r\x1b[Ka text that is longer\r")) << "without the bar";
  err_.str("");
  { ProgressLine(context_).Show(0.5, std::string(100, 'x')); }
  EXPECT_EQ(err_.str(), "\r\x1b[K" + std::string(39, 'x') + "\r\x1b[K");
}

TEST_F(ProgressTest, TheTimeLeftIsNeverCut) {
  context_.is_err_terminal = true;
  context_.err_columns = 80;
  const std::string slow = " 20 %  541 poses  TRACKING  0.6 x real time: too slow  207 poses/s  0.08 Mev/s";
  for (const auto& [columns, shown] : std::vector<std::pair<size_t, std::string>>{
           {100, slow + "  40 s left"},
           {80, " 20 %  541 poses  TRACKING  0.6 x real time: too slow  207 poses/s  40 s left"},
           {70, " 20 %  541 poses  TRACKING  0.6 x real time: too slow  40 s left"},
           {20, " 20 %  40 s left"},
           {10, "  40 s le"}}) {
    context_.err_columns = columns;
    FakeClock clock;
    ProgressLine line(context_, clock);
    line.Show(0.0, "  0 %  0 poses");
    clock.Advance(absl::Seconds(10));
    err_.str("");
    line.Show(0.2, slow);
    EXPECT_EQ(err_.str(), "\r\x1b[K" + shown) << columns;
    EXPECT_LT(shown.size(), columns);
  }
}

TEST_F(ProgressTest, APipeGetsNoControlCharacters) {
  ProgressLine line(context_);
  for (int i = 0; i < 1000; ++i) line.Show(i / 1000.0, "text");
  line.Clear();
  EXPECT_THAT(err_.str(), Not(HasSubstr("\r")));
  EXPECT_THAT(err_.str(), Not(HasSubstr("\x1b")));
}

TEST_F(ProgressTest, DescribesTheTimeLeft) {
  EXPECT_EQ(DescribeTimeLeft(absl::Milliseconds(200)), "0 s left");
  EXPECT_EQ(DescribeTimeLeft(absl::Seconds(99.4)), "99 s left");
  EXPECT_EQ(DescribeTimeLeft(absl::Minutes(4)), "4 min left");
  EXPECT_EQ(DescribeTimeLeft(absl::Minutes(150)), "2.5 h left");
}

}  // namespace
}  // namespace evpose::client
