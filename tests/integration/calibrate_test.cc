// SPDX-License-Identifier: Apache-2.0

// evpose target and evpose calibrate.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

TEST_F(CliTest, TargetWritesADrawingAndItsModel) {
  const CliResult result = Run({"target", "--page", "600x400mm", "-o", Path("sheet.pdf"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.Json()["model"], Path("sheet.obj"));
  EXPECT_EQ(result.Json()["width_mm"], 600.0);
  EXPECT_EQ(ReadText("sheet.pdf").substr(0, 5), "%PDF-");
  EXPECT_THAT(ReadText("sheet.obj"), HasSubstr("\nl "));
}

TEST_F(CliTest, TargetOfAScreenIsAnImageOfItsSize) {
  const CliResult result = Run({"target", "--screen", "640x400", "--screen-mm", "320", "-o", Path("screen.png")});
  ASSERT_EQ(result.status, 0) << result.err;
  const cv::Mat image = cv::imread(Path("screen.png"), cv::IMREAD_GRAYSCALE);
  ASSERT_EQ(image.cols, 640);
  ASSERT_EQ(image.rows, 400);
  EXPECT_EQ(image.at<uint8_t>(2, 2), 255);
  // The middle of the first polygon, at (0.17, 0.8) of the pattern.
  EXPECT_EQ(image.at<uint8_t>(77, 122), 0);
  EXPECT_THAT(ReadText("screen.obj"), HasSubstr("320 x 200 mm"));
}

TEST_F(CliTest, TargetRefusesWrongArguments) {
  const auto expect = [&](const std::vector<std::string>& more, const std::string& message) {
    std::vector<std::string> arguments = {"target"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << message;
    EXPECT_THAT(result.err, HasSubstr(message));
    EXPECT_TRUE(FilesBeginning("out").empty());
  };
  expect({"-o", Path("out.png")}, "must end in .pdf");
  expect({"--screen", "640x400", "--screen-mm", "320", "-o", Path("out.pdf")}, "must end in .png");
  const CliResult lens = Run({"calibrate", "a.raw", "--model", "m.obj", "--camera-out", "c.yaml", "--lens", "foo"});
  EXPECT_EQ(lens.status, 2);
  EXPECT_THAT(lens.err, HasSubstr("--lens: \"foo\" is none of brown, rational, fisheye; "));
  expect({"--page", "B17", "-o", Path("out.pdf")}, "A4, A3, letter");
  expect({"--page", "10x10", "-o", Path("out.pdf")}, "80 to 5000 mm");
  expect({"--screen", "640", "--screen-mm", "320", "-o", Path("out.png")}, "WIDTHxHEIGHT");
  expect({"--screen", "640x400", "--screen-mm", "3", "-o", Path("out.png")}, "--screen-mm");
  expect({"--screen", "640x400", "-o", Path("out.png")}, "--screen-mm");
}

// Three short recordings of the moving target before a VGA camera with fx = fy = 515 px, (321.5, 237.5) px; no camera
// file, no truth.
TEST_F(CliTest, CalibrateFindsTheCameraFromTheTargetAlone) {
  ASSERT_EQ(Run({"target", "-o", Path("target.pdf")}).status, 0);
  for (const char* seed : {"1", "2", "3"}) {
    const CliResult simulated =
        Run({"simulate", "--model", Path("target.obj"), "--front", "--camera", "vga", "--duration", "3", "--noise",
             "0.05", "--seed", seed, "-o", Path(std::string("r") + seed)});
    ASSERT_EQ(simulated.status, 0) << simulated.err;
  }
  const CliResult result = Run({"calibrate", Path("r1/recording.raw"), Path("r2/recording.raw"),
                                Path("r3/recording.raw"), "--model", Path("target.obj"), "-o", Path("profile.yaml"),
                                "--camera-out", Path("camera.yaml"), "--coverage", Path("coverage.png"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  const nlohmann::json& camera = json["camera"];
  const auto expect = [&](const char* name, double truth, double tolerance) {
    const nlohmann::json& parameter = camera["parameters"][name];
    const double error = parameter["standard_error"];
    EXPECT_LT(error, tolerance) << name;
    EXPECT_NEAR(parameter["value"], truth, 4.0 * error) << name;
  };
  expect("fx_px", 515.0, 1.5);
  expect("fy_fx", 1.0, 0.002);
  expect("cx_px", 321.5, 2.0);
  expect("cy_px", 237.5, 2.0);
  EXPECT_LT(camera["rms_px"], 0.5);
  EXPECT_EQ(camera["projection"].size(), 9u);
  EXPECT_EQ(camera["coverage"].size(), 9u);
  EXPECT_FALSE(cv::imread(Path("coverage.png")).empty());
  // The latency cannot be estimated from tracked poses: it keeps its default, without a standard error.
  EXPECT_TRUE(json["latency_us"]["standard_error"].is_null());
  EXPECT_NEAR(json["blur_px"]["value"], 0.47, 0.2);
  const CliResult replayed = Run({"replay", Path("r1/recording.raw"), "--model", Path("target.obj"), "--camera",
                                  Path("camera.yaml"), "--sensor", Path("profile.yaml"), "--json"});
  EXPECT_EQ(replayed.status, 0) << replayed.err;
  // A first guess of 75.7 degrees is that of a focal length of 412 px, which is 20 % too short.
  const CliResult guessed =
      Run({"calibrate", Path("r1/recording.raw"), Path("r2/recording.raw"), Path("r3/recording.raw"), "--model",
           Path("target.obj"), "--fov", "75.7", "--camera-out", Path("guessed.yaml"), "--json"});
  ASSERT_EQ(guessed.status, 0) << guessed.err;
  const nlohmann::json from_guess = guessed.Json()["camera"]["parameters"]["fx_px"];
  EXPECT_LT(from_guess["standard_error"], 1.5);
  EXPECT_NEAR(from_guess["value"], 515.0, 4.0 * from_guess["standard_error"].get<double>());
}

TEST_F(CliTest, CalibrateFitsTheProfileToTrackedPoses) {
  const CliResult simulated = Run(
      {"simulate", "--object", "cube", "--camera", "vga", "--duration", "2", "--motion", "bursts", "-o", Path("cube")});
  ASSERT_EQ(simulated.status, 0) << simulated.err;
  const CliResult result = Run({"calibrate", Path("cube/recording.raw"), "--model", Path("cube/model.obj"), "--camera",
                                Path("cube/camera.yaml"), "-o", Path("profile.yaml"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.err, HasSubstr("latency_us stays at"));
  EXPECT_TRUE(result.Json()["latency_us"]["standard_error"].is_null());
  EXPECT_NEAR(result.Json()["blur_px"]["value"], 0.47, 0.2);
  EXPECT_THAT(ReadText("profile.yaml"), HasSubstr("blur_px"));
  // The same events in a format of other programs.
  ASSERT_EQ(Run({"convert", Path("cube/recording.raw"), Path("cube/recording.csv")}).status, 0);
  const CliResult foreign = Run({"calibrate", Path("cube/recording.csv"), "--model", Path("cube/model.obj"), "--camera",
                                 Path("cube/camera.yaml"), "-o", Path("foreign.yaml")});
  ASSERT_EQ(foreign.status, 0) << foreign.err;
  EXPECT_EQ(ReadText("foreign.yaml"), ReadText("profile.yaml"));
}

// The target is 85 px wide on a small sensor: its lines are long enough for the camera, and too few pass alone for a
// profile.
TEST_F(CliTest, CalibrateKeepsTheCameraIfTheProfileIsNotDetermined) {
  WriteText("small.yaml",
            "image_width: 240\nimage_height: 180\ncamera_name: small\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
            "  data: [200, 0, 119.5, 0, 200, 89.5, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n"
            "  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\n");
  ASSERT_EQ(Run({"target", "-o", Path("target.pdf")}).status, 0);
  const CliResult simulated =
      Run({"simulate", "--model", Path("target.obj"), "--front", "--camera", Path("small.yaml"), "--distance", "0.8",
           "--speed", "3", "--duration", "2", "--noise", "0.02", "-o", Path("small")});
  ASSERT_EQ(simulated.status, 0) << simulated.err;
  const CliResult result = Run({"calibrate", Path("small/recording.raw"), "--model", Path("target.obj"), "--fov", "62",
                                "--camera-out", Path("camera.yaml"), "-o", Path("profile.yaml")});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("too little data to fit a sensor profile"));
  EXPECT_THAT(result.err, HasSubstr("; the camera is estimated and written to " + Path("camera.yaml")));
  EXPECT_THAT(ReadText("camera.yaml"), HasSubstr("camera_matrix"));
  EXPECT_TRUE(FilesBeginning("profile").empty());
}

// --model and --camera take one file or one for each recording, so that the recordings may stand behind them.
TEST_F(CliTest, CalibrateTakesRecordingsBeforeOrAfterTheOptions) {
  SimulateCube(0.02);
  const std::string recording = Path("cube/recording.raw"), model = Path("cube/model.obj");
  const std::string camera = Path("cube/camera.yaml"), out = Path("out.yaml");
  const auto error = [&](std::vector<std::string> arguments, int status) {
    arguments.insert(arguments.begin(), "calibrate");
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, status) << result.err;
    return result.err;
  };
  const std::string too_short = "too little data to fit a sensor profile";
  EXPECT_THAT(error({"--camera", camera, "--model", model, recording, "-o", out}, 1), HasSubstr(too_short));
  EXPECT_THAT(error({"--model", model, "-o", out, "--camera", camera, recording}, 1), HasSubstr(too_short));
  EXPECT_THAT(error({"--model", model, recording, recording, "--camera", camera, "-o", out}, 1), HasSubstr(too_short));
  EXPECT_THAT(error({"--model", model, recording, "--camera-out", out}, 1), HasSubstr("record longer"));
  EXPECT_THAT(error({"--camera", camera, "--model", model, "-o", out}, 2), HasSubstr("give RECORDINGS"));
  EXPECT_THAT(error({"--hand-eye", Path("cube/truth.tum"), "-o", out}, 2), HasSubstr("give RECORDINGS"));
}

TEST_F(CliTest, CalibrateRefusesOptionsThatDoNotBelongTogether) {
  SimulateCube(0.02);
  const auto expect = [&](const std::vector<std::string>& more, int status, const std::string& message) {
    std::vector<std::string> arguments = {"calibrate", Path("cube/recording.raw"), "--model", Path("cube/model.obj")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, status) << result.err;
    EXPECT_THAT(result.err, HasSubstr(message));
    EXPECT_TRUE(FilesBeginning("out").empty());
  };
  const std::string camera = Path("cube/camera.yaml"), out = Path("out.yaml");
  expect({"-o", out}, 2, "give --camera-out");
  expect({"--camera", camera}, 2, "-o is required");
  expect({"--camera", camera, "-o", out, "--camera-out", Path("out2.yaml")}, 2, "--camera-out is for a calibration of");
  expect({"--camera", camera, "-o", out, "--fov", "60"}, 2, "--fov is for a calibration of");
  expect({"--truth", Path("cube/truth.tum"), "-o", out}, 2, "--camera");
  expect({"--camera-out", out, "--focal-mm", "5", "--fov", "60"}, 2, "--fov");
  expect({"--camera-out", out, "--picture", Path("out.png")}, 2, "needs -o");
  expect({"--camera-out", out, "--model", Path("cube/model.obj")}, 2,
         "--model has 2 files for 1 recording: give one for all");
  expect({"--camera", camera, "--truth", Path("truth.mcap"), "-o", out}, 1, "poses are not read from .mcap files, but");
  // 20 ms are enough to find a pose, and too short for the rest.
  expect({"--camera-out", out}, 1, "record longer");
  expect({"--camera", camera, "-o", out}, 1, "too little data to fit a sensor profile");
}

// The camera and the tracked poses are estimated in several passes over the file.
TEST_F(CliTest, CalibrateReadsTheFormatsOfOtherPrograms) {
  SimulateCube(0.02);
  const std::string recording = Path("cube/recording.csv"), out = Path("out.yaml");
  const CliResult converted = Run({"convert", Path("cube/recording.raw"), recording});
  ASSERT_EQ(converted.status, 0) << converted.err;
  const auto error = [&](const std::string& path, const std::vector<std::string>& more, int status) {
    std::vector<std::string> arguments = {"calibrate", path, "--model", Path("cube/model.obj")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, status) << result.err;
    return result.err;
  };
  const std::vector<std::string> profile = {"--camera", Path("cube/camera.yaml"), "-o", out};
  EXPECT_THAT(error(recording, {"--camera-out", out}, 1), HasSubstr("record longer"));
  EXPECT_THAT(error(recording, profile, 1), HasSubstr("too little data to fit a sensor profile"));
  WriteText("unknown.csv", "1,2,0,5\n1,2,0,6\n");
  EXPECT_THAT(error(Path("unknown.csv"), {"--camera-out", out}, 1),
              HasSubstr("a calibration needs; convert it with `evpose convert --size WIDTHxHEIGHT`"));
  EXPECT_THAT(error("-", {"--camera-out", out}, 2), HasSubstr("instead of standard input"));
  EXPECT_THAT(error("-", profile, 2), HasSubstr("instead of standard input"));
}

TEST_F(CliTest, CalibrateRefusesRecordingsOfDifferentSensors) {
  SimulateCube(0.02);
  const CliResult simulated = Run({"simulate", "--camera", "evk4", "--duration", "0.01", "-o", Path("large")});
  ASSERT_EQ(simulated.status, 0) << simulated.err;
  const CliResult result = Run({"calibrate", Path("cube/recording.raw"), Path("large/recording.raw"), "--model",
                                Path("cube/model.obj"), "--camera-out", Path("out.yaml")});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("640 x 480"));
  EXPECT_THAT(result.err, HasSubstr("1280 x 720"));
  EXPECT_TRUE(FilesBeginning("out").empty());
}

}  // namespace
}  // namespace evpose
