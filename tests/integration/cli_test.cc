// The program itself: its help is true, its pictures show something.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <regex>
#include <set>
#include <sstream>
#include <string>

#include "server/rpc/server.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

constexpr char kDefaultAddress[] = "127.0.0.1:50051";

// The commands below "Example:", with lines that go on joined.
std::vector<std::string> Examples(const std::string& help) {
  const size_t begin = help.find("Example:\n");
  EXPECT_NE(begin, std::string::npos) << help;
  std::string text = help.substr(begin + 9);
  text = std::regex_replace(text, std::regex("\\\\\n *"), "");
  std::vector<std::string> commands;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.find_first_not_of(' ') != std::string::npos) commands.push_back(line.substr(line.find_first_not_of(' ')));
  }
  EXPECT_FALSE(commands.empty());
  return commands;
}

TEST_F(CliTest, ExamplesOfEveryHelpWorkAsPrinted) {
  auto server = server::Server::Start({});
  ASSERT_TRUE(server.ok()) << server.status();
  const std::string address = "127.0.0.1:" + std::to_string((*server)->port());
  std::set<std::string> done;  // most begin with the same simulation
  for (const char* command : {"simulate", "replay", "info", "evaluate", "render", "models", "sessions",
                              "bench initialization", "bench synthetic", "bench tracking", "calibrate"}) {
    const CliResult help = RunShell(std::string("evpose ") + command + " --help");
    ASSERT_EQ(help.status, 0) << help.err;
    for (std::string example : Examples(help.out)) {
      if (!done.insert(example).second) continue;
      // The server of this test listens on a port of its own.
      if (const size_t at = example.find(kDefaultAddress); at != std::string::npos) {
        example.replace(at, sizeof(kDefaultAddress) - 1, address);
      }
      const CliResult result = RunShell(example);
      EXPECT_EQ(result.status, 0) << example << "\n" << result.err;
    }
  }
  EXPECT_TRUE(std::filesystem::exists(Path("cube/poses.tum")));
  EXPECT_TRUE(std::filesystem::exists(Path("cube/picture.png")));
  EXPECT_TRUE(std::filesystem::exists(Path("sensor.yaml")));
  EXPECT_TRUE(std::filesystem::exists(Path("residuals.png")));
}

TEST_F(CliTest, StandardOutputHoldsTheAnswerAlone) {
  SimulateCube(0.02);
  const CliResult result = RunShell(
      "evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml "
      "--json --init-pose '" +
      FirstPose() + "'");
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_GT(result.Json()["poses"], 0);
  EXPECT_EQ(result.err, "");
}

TEST_F(CliTest, ProgramFailsWithOneLine) {
  const CliResult result = RunShell("evpose info missing.raw");
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("evpose info: "));
  EXPECT_THAT(result.err, HasSubstr("missing.raw"));
}

TEST_F(CliTest, InterruptEndsAFollowedRecordingCleanly) {
  SimulateCube(0.02);
  // It may come before the first event was sent or after the last: it must be obeyed whenever it comes.
  const CliResult result = RunShell(
      "evpose replay cube/recording.raw --follow --model cube/model.obj --camera cube/camera.yaml --out poses.tum "
      "--json --init-pose '" +
      FirstPose() +
      "' & pid=$!\n"
      "while [ -z \"$(ls | grep poses.tum.partial)\" ]; do :; done\n"
      "kill -TERM $pid\n"
      "wait $pid");
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.Json()["interrupted"], true);
  EXPECT_TRUE(std::filesystem::exists(Path("poses.tum")));
}

// Pixels of a colour near (b, g, r).
int CountColour(const cv::Mat& image, int b, int g, int r) {
  int count = 0;
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const cv::Vec3b& pixel = image.at<cv::Vec3b>(y, x);
      if (std::abs(pixel[0] - b) + std::abs(pixel[1] - g) + std::abs(pixel[2] - r) < 90) ++count;
    }
  }
  return count;
}

TEST_F(CliTest, PictureShowsEventsAndModel) {
  SimulateCube(0.05);
  const CliResult result = Run({"render", Path("cube/recording.raw"), "--poses", Path("cube/truth.tum"), "--model",
                                Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "-o", Path("a.png")});
  ASSERT_EQ(result.status, 0) << result.err;
  const cv::Mat image = cv::imread(Path("a.png"));
  ASSERT_EQ(image.cols, 640);
  ASSERT_EQ(image.rows, 480);
  EXPECT_GT(CountColour(image, 255, 190, 90), 300);   // ON
  EXPECT_GT(CountColour(image, 80, 90, 235), 300);    // OFF
  EXPECT_GT(CountColour(image, 110, 240, 110), 300);  // the model
}

TEST_F(CliTest, FilmLastsAsLongAsTheRecording) {
  SimulateCube(0.1);
  for (const char* name : {"film.mp4", "film.avi"}) {
    const CliResult result = Run({"render", Path("cube/recording.raw"), "--poses", Path("cube/truth.tum"), "--model",
                                  Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "-o", Path(name)});
    ASSERT_EQ(result.status, 0) << result.err;
    cv::VideoCapture film(Path(name));
    int frames = 0;
    for (cv::Mat frame; film.read(frame); ++frames) EXPECT_EQ(frame.cols, 640);
    EXPECT_EQ(frames, 3);  // 100 ms at 30 frames/s
  }
}

TEST_F(CliTest, EvaluateTableHasARowForEachEstimate) {
  SimulateCube(0.02);
  WriteText("none.tum", "");
  const CliResult result = Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate",
                                "itself=" + Path("cube/truth.tum"), "--estimate", "lost at once=" + Path("none.tum")});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("\nitself "));
  EXPECT_THAT(result.out, HasSubstr("\nlost at once "));
  const nlohmann::json rows = Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", Path("cube/truth.tum"),
                                   "--estimate", Path("none.tum"), "--json"})
                                  .Json()["estimates"];
  EXPECT_EQ(rows[0]["position_rmse_m"], 0.0);
  EXPECT_EQ(rows[0]["coverage_ratio"], 1.0);
  EXPECT_EQ(rows[1]["poses"], 0);
  EXPECT_TRUE(rows[1]["position_rmse_m"].is_null());
}

}  // namespace
}  // namespace evpose
