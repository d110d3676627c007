// SPDX-License-Identifier: Apache-2.0

// What evpose render says when there is no pose to draw.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class RenderCommandTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    SimulateCube(0.05);
  }
  CliResult Render(const std::string& poses, const std::string& out, const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {
        "render",   Path("cube/recording.raw"), "--poses", Path(poses), "--model", Path("cube/model.obj"),
        "--camera", Path("cube/camera.yaml"),   "--out",   Path(out)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  }
};

TEST_F(RenderCommandTest, PosesOfAnotherTimeAreReportedWithBothTimes) {
  WriteText("later.tum", "100 0 0 1 0 0 0 1\n100.1 0 0 1 0 0 0 1\n");
  WriteText("earlier.tum", "1 0 0 1 0 0 0 1\n1.1 0 0 1 0 0 0 1\n");
  const auto expected = [this](const std::string& poses, const std::string& span) {
    return AllOf(HasSubstr("evpose render: " + Path(poses) + ": its poses are " + span + ", but the events of " +
                           Path("cube/recording.raw") + " are from 16.0"),
                 HasSubstr(" s to 16.0"), HasSubstr("run evpose replay with --time-zero sensor"));
  };
  for (const auto& [poses, span] : {std::pair<std::string, std::string>("later.tum", "from 100.000000 s to 100.100000"),
                                    {"earlier.tum", "from 1.000000 s to 1.100000"}}) {
    const CliResult picture = Render(poses, "a.png");
    EXPECT_EQ(picture.status, 1);
    EXPECT_THAT(picture.err, expected(poses, span + " s"));
    const CliResult film = Render(poses, "a.avi");
    EXPECT_EQ(film.status, 1);
    EXPECT_THAT(film.err, expected(poses, span + " s"));
    EXPECT_THAT(FilesBeginning("a."), IsEmpty());
    const CliResult alone = Render(poses, "a.png", {"--at", "16.02"});
    EXPECT_EQ(alone.status, 0) << alone.err;
    EXPECT_THAT(alone.err, expected(poses, span + " s"));
    EXPECT_EQ(std::filesystem::remove(Path("a.png")), true) << "the events alone";
  }
}

TEST_F(RenderCommandTest, AFileThatCannotBeWrittenIsReportedWithItsCause) {
  for (const char* name : {"none/a.mp4", "none/a.avi", "none/a.png"}) {
    const CliResult result = RunShell(absl::StrCat(
        "evpose render cube/recording.raw --poses cube/truth.tum --model cube/model.obj --camera cube/camera.yaml -o ",
        name));
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, AllOf(HasSubstr(absl::StrCat("evpose render: ", name, ": ")),
                                  HasSubstr("No such file or directory\n")));
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  }
}

TEST_F(RenderCommandTest, AmbiguousPosesAreReported) {
  ASSERT_EQ(Run(ReplayArguments("poses.csv")).status, 0);
  WriteText("ambiguous.csv",
            absl::StrReplaceAll(ReadText("poses.csv"), {{",TRACKING,", ",AMBIGUOUS,"}, {",DEGRADED,", ",AMBIGUOUS,"}}));
  const auto all = AllOf(HasSubstr(Path("ambiguous.csv") + ": all its poses, from 16.0"), HasSubstr(", are AMBIGUOUS"),
                         HasSubstr("evpose view shows them"));
  const CliResult picture = Render("ambiguous.csv", "a.png");
  EXPECT_EQ(picture.status, 1);
  EXPECT_THAT(picture.err, AllOf(all, HasSubstr("; --at SECONDS draws the events of that time alone")));
  EXPECT_FALSE(std::filesystem::exists(Path("a.png")));
  const CliResult film = Render("ambiguous.csv", "a.avi");
  EXPECT_EQ(film.status, 0);
  EXPECT_THAT(film.err, AllOf(all, HasSubstr(": only the events are drawn\n")));
}

TEST_F(RenderCommandTest, ATimeBesideThePosesIsReportedWithItsKind) {
  SimulateCube(0.2);
  ASSERT_EQ(Run(ReplayArguments("poses.csv")).status, 0);
  const std::string all = ReadText("poses.csv");
  std::string ambiguous = all;
  const size_t half = all.find('\n', all.size() / 2);
  ambiguous.resize(half);
  absl::StrReplaceAll({{",TRACKING,", ",AMBIGUOUS,"}, {",DEGRADED,", ",AMBIGUOUS,"}}, &ambiguous);
  WriteText("half.csv", ambiguous + all.substr(half));
  EXPECT_THAT(Render("half.csv", "a.png", {"--at", "16.02"}).err,
              HasSubstr("half.csv: its poses near 16.020000 s are AMBIGUOUS, and none is drawn: only the events are"));
  WriteText("late.tum", "16.15 0 0 1 0 0 0 1\n16.16 0 0 1 0 0 0 1\n");
  EXPECT_THAT(Render("late.tum", "a.png", {"--at", "16.05"}).err,
              HasSubstr("late.tum: its first pose is at 16.150000 s: only the events are drawn\n"));
  WriteText("early.tum", "16.05 0 0 1 0 0 0 1\n16.06 0 0 1 0 0 0 1\n");
  EXPECT_THAT(Render("early.tum", "a.png", {"--at", "16.15"}).err,
              HasSubstr("early.tum: its last pose is at 16.060000 s: only the events are drawn\n"));
}

TEST_F(RenderCommandTest, AFileWithoutPosesAndAGapAreReported) {
  WriteText("none.tum", "");
  EXPECT_THAT(Render("none.tum", "a.avi").err, HasSubstr("none.tum has no pose: only the events are drawn\n"));
  WriteText("gap.tum", "15 0 0 1 0 0 0 1\n17 0 0 1 0 0 0 1\n");
  const CliResult lost = Render("gap.tum", "a.png", {"--at", "16.04"});
  EXPECT_EQ(lost.status, 0) << lost.err;
  EXPECT_THAT(lost.err,
              HasSubstr("gap.tum: has no pose at 16.040000 s: the poses before and after it are more than 500 "
                        "ms apart: only the events are drawn\n"));
  EXPECT_EQ(Render("cube/truth.tum", "a.png").err, "");
}

// evpose watch --max-rate-hz 10 writes such files.
TEST_F(RenderCommandTest, PosesOfALowRateAreInterpolatedExceptOverALoss) {
  const auto write = [this](const std::string& name, const std::string& loss) {
    std::string text = "t_us,tx_m,ty_m,tz_m,qx,qy,qz,qw,lost_at_us,loss_cause\n";
    for (int t_us = 15'800'000; t_us <= 16'200'000; t_us += 100'000) {
      absl::StrAppend(&text, t_us, ",0,0,1,0,0,0,1,", t_us > 16'000'000 ? loss : ",", "\n");
    }
    WriteText(name, text);
  };
  write("slow.csv", ",");
  const CliResult slow = Render("slow.csv", "slow.png", {"--at", "16.02"});
  EXPECT_EQ(slow.status, 0) << slow.err;
  EXPECT_EQ(slow.err, "");
  write("lost.csv", "16010000,CONTRADICTED");
  const CliResult lost = Render("lost.csv", "lost.png", {"--at", "16.02"});
  EXPECT_EQ(lost.status, 0) << lost.err;
  EXPECT_THAT(lost.err, HasSubstr("lost.csv: has no pose at 16.020000 s: the object was lost between the poses before "
                                  "and after it: only the events are drawn\n"));
  EXPECT_NE(ReadText("slow.png"), ReadText("lost.png")) << "one of them has the model";
}

}  // namespace
}  // namespace evpose
