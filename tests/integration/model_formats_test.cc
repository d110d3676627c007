// SPDX-License-Identifier: Apache-2.0

// Tests that commands accept models of all formats.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "tests/data/test_data.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class ModelFormatsTest : public CliTest {};

TEST_F(ModelFormatsTest, AnUploadConvertsOtherFormats) {
  const LocalServer server = StartLocalServer();
  const CliResult label =
      Run({"models", "upload", FindTestData("models/label_box.glb"), "--server", server.address, "--json"});
  ASSERT_EQ(label.status, 0) << label.err;
  EXPECT_NEAR(label.Json()["diameter_m"].get<double>(), 0.01 * std::sqrt(14.0), 1e-7);
  EXPECT_GE(label.Json()["lines"], 16) << "twelve edges of the box and four of the label";
  EXPECT_THAT(label.Json()["notices"][0].get<std::string>(), HasSubstr("painted lines"));
  const CliResult parsec = Run({"models", "upload", FindTestData("models/box_parsec.3mf"), "--server", server.address});
  EXPECT_EQ(parsec.status, 1);
  EXPECT_THAT(parsec.err, HasSubstr("box_parsec.3mf: its unit \"parsec\" is unknown"));
}

TEST_F(ModelFormatsTest, ARefusedUploadNamesTheFileAndNoFieldOfTheApi) {
  server::ServerOptions options;
  options.max_model_bytes = 1000;
  const LocalServer server = StartLocalServer(options);
  const auto error = [&](const std::string& path) {
    const CliResult upload = Run({"models", "upload", path, "--server", server.address});
    EXPECT_EQ(upload.status, 1) << upload.out;
    return upload.err;
  };
  const std::string large = Path("large.obj"), broken = Path("broken.obj");
  WriteText("large.obj", std::string(1001, '#'));
  EXPECT_THAT(error(large), HasSubstr(large + ": its size is 1001; a model has 1 to 1000 bytes"));
  WriteText("broken.obj", "v 0 0 0\nv 1 0 0\nf 1 2 3\n");
  EXPECT_THAT(error(broken), AllOf(HasSubstr(broken + ": line 3"), ::testing::Not(HasSubstr("chunk"))));
}

TEST_F(ModelFormatsTest, AnInspectionPredictsWhereTheObjectCanBeFound) {
  SimulateCube(0.001);
  const std::string model = Path("cube/model.obj");
  const CliResult json = Run({"models", "inspect", model, "--camera", Path("cube/camera.yaml"), "--json"});
  ASSERT_EQ(json.status, 0) << json.err;
  const nlohmann::json findability = json.Json()["findability"];
  EXPECT_EQ(findability["views"], 96);
  EXPECT_EQ(findability["findable_views"], 96);
  EXPECT_EQ(findability["ambiguous_views"], 0);
  EXPECT_EQ(findability["thin_views"], 0);
  EXPECT_EQ(findability["rivals"].size(), 0u) << "half turns are symmetries of a cube";
  ASSERT_EQ(findability["by_view"].size(), 96u);
  EXPECT_GT(findability["by_view"][0]["max_distance_m"], 0.0);
  const CliResult text = Run({"models", "inspect", model});
  EXPECT_THAT(text.out,
              HasSubstr("\nfindable     from 96 of 96 views, once the image has moved by 2 px; least diameter"));
  EXPECT_THAT(text.out, ::testing::Not(HasSubstr("confusable")));
  EXPECT_TRUE(json.Json()["near_symmetries"].empty());
  EXPECT_THAT(text.out, ::testing::Not(HasSubstr("\nnear ")));
}

TEST_F(ModelFormatsTest, AHalfTurnWithoutASimilarViewIsNotReported) {
  // A wedge: its half turns are no symmetries, and change many of its edges.
  WriteText("wedge.obj",
            "v 0 0 0\nv 0.2 0 0\nv 0.2 0.1 0\nv 0 0.1 0\nv 0 0 0.1\nv 0 0.1 0.1\nf 1 4 3 2\nf 1 2 5\nf 3 4 6\n"
            "f 1 5 6 4\nf 2 3 6 5\n");
  const nlohmann::json rivals = Run({"models", "inspect", Path("wedge.obj"), "--json"}).Json()["findability"]["rivals"];
  const std::string text = Run({"models", "inspect", Path("wedge.obj")}).out;
  size_t num_similar = 0;
  for (const nlohmann::json& rival : rivals) num_similar += rival["similar_views"] > 0 ? 1 : 0;
  EXPECT_LT(num_similar, rivals.size());
  EXPECT_EQ(text.find("confusable") != std::string::npos, num_similar > 0) << text;
  EXPECT_THAT(text, ::testing::Not(HasSubstr("in 0 of 96 views")));
}

TEST_F(ModelFormatsTest, AnInspectionCountsTheViewsInWhichAHalfTurnIsSimilar) {
  // A cuboid with one displaced vertex. In a view that does not show this vertex, it looks as after a half turn.
  WriteText("cuboid.obj",
            "v 0 0 0\nv 0.2 0 0\nv 0.2 0.12 0\nv 0 0.12 0\nv 0 0 0.08\nv 0.2 0 0.08\nv 0.19 0.113 0.073\n"
            "v 0 0.12 0.08\nf 1 4 3 2\nf 1 2 6 5\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5 8\nf 5 6 7\nf 5 7 8\n");
  const nlohmann::json findability = Run({"models", "inspect", Path("cuboid.obj"), "--json"}).Json()["findability"];
  int num_ambiguous = 0;
  for (const nlohmann::json& view : findability["by_view"]) {
    const std::vector<double> shares = view["differing_share"];
    const bool is_similar = std::any_of(shares.begin(), shares.end(), [](double share) { return share < 0.1; });
    num_ambiguous += !view["smallest_px"].is_null() && is_similar ? 1 : 0;
  }
  EXPECT_EQ(findability["ambiguous_views"], num_ambiguous);
  EXPECT_GT(num_ambiguous, 0);
  EXPECT_LT(num_ambiguous, 96);
  EXPECT_THAT(Run({"models", "inspect", Path("cuboid.obj")}).out,
              HasSubstr(absl::StrCat("in ", num_ambiguous, " of these views AMBIGUOUS is expected: less than 10 %")));
}

TEST_F(ModelFormatsTest, AModelWithoutFacesIsReported) {
  SimulateCube(0.001);
  std::string lines;
  for (const absl::string_view line : absl::StrSplit(ReadText("cube/model.obj"), '\n')) {
    if (!absl::StartsWith(line, "f ")) absl::StrAppend(&lines, line, "\n");
  }
  WriteText("lines.obj", lines);
  const std::string notice = "the model has no faces: edges that the object hides are expected to be visible";
  EXPECT_THAT(Run({"models", "inspect", Path("lines.obj")}).out, HasSubstr(notice));
  EXPECT_THAT(Run({"models", "inspect", Path("cube/model.obj")}).out, ::testing::Not(HasSubstr(notice)));
  const CliResult simulated = Run({"simulate", "--model", Path("lines.obj"), "--out", Path("lines")});
  EXPECT_EQ(simulated.status, 1);
  EXPECT_THAT(simulated.err, HasSubstr("lines.obj: the model has no face, only lines, and the simulator draws faces"));
}

TEST_F(ModelFormatsTest, TheSimulatorStatesTheSizesThatItTakes) {
  SimulateCube(0.001);
  for (const auto& [scale, size] : {std::pair("0.001", "0.3464 mm"), {"2e4", "6928 m"}}) {
    const CliResult result =
        Run({"simulate", "--model", Path("cube/model.obj"), "--scale", scale, "--out", Path("scaled")});
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, HasSubstr(absl::StrCat("cube/model.obj: the model is ", size,
                                                   " across, and the simulator has objects of 2.941 mm to 2941 m: "
                                                   "check --scale, the metres per unit of the file")));
  }
}

// A cuboid with a line of 0.06 m that is drawn on one of its sides.
TEST_F(ModelFormatsTest, EveryOptionOfASimulationAppliesToAModelFile) {
  struct Option {
    std::vector<std::string> words;
    std::string line;  // of simulation.txt, which no simulation without the option has
  };
  const Option options[] = {
      {{"--occluder"}, "scene.occluder.is_present 1\n"},
      {{"--occluder-on-object"}, "scene.occluder.follows_object 1\n"},
      {{"--moving-edge"}, "scene.background.has_moving_edge 1\n"},
      {{"--textured-background"}, "scene.background.is_textured 1\n"},
      {{"--textured-background", "--background-rectangles", "20"}, "scene.background.texture_rectangles 20\n"},
      {{"--textured-background", "--background-speed", "100"}, "scene.background.texture_speed_px_per_s 100\n"},
      {{"--flicker", "0.25"}, "scene.light.flicker_depth 0.25\n"},
      {{"--light-change", "2"}, "scene.light.change_ratio 2\n"},
      {{"--lens-blur", "1.5"}, "scene.lens_blur_px 1.5\n"},
      {{"--speed", "2"}, "scene.motion.angular_speed_rad_per_s 1.6"},
      {{"--view-angle", "10"}, "scene.motion.view_angle_rad 0.1745"},
      {{"--motion", "bursts"}, "scene.motion.profile 2\n"},
      {{"--noise", "0.25"}, "sensor.noise_ratio 0.25\n"},
      {{"--background-activity", "5"}, "sensor.shot_noise_hz 5\n"},
      {{"--hot-pixels", "7"}, "sensor.hot_pixel_ratio 2.278"},
      {{"--flood", "5"}, "sensor.flood_hz 5000000\n"},
      {{"--threshold", "0.5"}, "sensor.threshold_on 0.5\n"},
      {{"--threshold-off", "0.5"}, "sensor.threshold_off 0.5\n"},
      {{"--bandwidth", "500"}, "sensor.bandwidth_hz 500\n"},
      {{"--refractory", "300"}, "sensor.refractory_us 300\n"},
  };
  SimulateCube(0.001);
  const auto simulate = [this](const std::vector<std::string>& words) {
    std::vector<std::string> all = {
        "simulate", "--model", Path("cube/model.obj"), "--camera", "vga", "--duration", "0.001", "--out", Path("part")};
    all.insert(all.end(), words.begin(), words.end());
    const CliResult result = Run(all);
    EXPECT_EQ(result.status, 0) << result.err;
    return ReadText("part/simulation.txt");
  };
  const std::string usual = simulate({});
  for (const auto& [words, line] : options) {
    EXPECT_THAT(usual, Not(HasSubstr("\n" + line))) << words.back();
    EXPECT_THAT(simulate(words), HasSubstr("\n" + line)) << words.back();
  }
}

TEST_F(ModelFormatsTest, AnInspectionWarnsOfNearSymmetries) {
  WriteText(
      "bar.obj",
      "v 0 0 0\nv .3 0 0\nv 0 .2 0\nv .3 .2 0\nv 0 0 .1\nv .3 0 .1\nv 0 .2 .1\nv .3 .2 .1\nv .16 .04 .1\nv .16 .1 .1\n"
      "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n"
      "l 1 2\nl 3 4\nl 5 6\nl 7 8\nl 1 3\nl 2 4\nl 5 7\nl 6 8\nl 1 5\nl 2 6\nl 3 7\nl 4 8\nl 9 10\n");
  const CliResult json = Run({"models", "inspect", Path("bar.obj"), "--json"});
  ASSERT_EQ(json.status, 0) << json.err;
  const nlohmann::json near = json.Json()["near_symmetries"];
  ASSERT_EQ(near.size(), 3u);
  EXPECT_NEAR(near[0]["angle_deg"].get<double>(), 180.0, 1.0);
  EXPECT_NEAR(near[0]["differing_share"].get<double>(), 0.06 / 2.46, 0.005);
  const CliResult text = Run({"models", "inspect", Path("bar.obj")});
  EXPECT_THAT(text.out, HasSubstr("\nsymmetry     none\nnear         turned by 180 deg about ("));
  EXPECT_THAT(text.out, HasSubstr("\nwarning: the object is nearly symmetric: turned by 180 deg about ("));
  EXPECT_THAT(text.out, HasSubstr("--init-pose"));
}

TEST_F(ModelFormatsTest, AReplayAndAnEvaluationReadTheSameModelInProcess) {
  SimulateCube(0.02);
  const std::string model = FindTestData("models/box_inch.3mf");
  const CliResult replay =
      Run({"replay", Path("cube/recording.raw"), "--model", model, "--camera", Path("cube/camera.yaml"), "--json"});
  ASSERT_EQ(replay.status, 1) << "the box is not in the recording";
  EXPECT_NEAR(replay.Json()["model_diameter_m"].get<double>(), 0.01 * std::sqrt(14.0), 1e-7);
  const CliResult evaluation =
      Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", Path("cube/truth.tum"), "--model", model,
           "--camera", Path("cube/camera.yaml"), "--symmetric", "--scale", "2", "--surface", "as-is"});
  EXPECT_EQ(evaluation.status, 0) << evaluation.err;
}

// Without contours between the facets, the rims alone give 87 % coverage and an error of 0.38 % of the depth.
TEST_F(ModelFormatsTest, AnObjectWithFacetsIsTrackedAsItIs) {
  SimulateCylinder("can", 32, "as-is", 0.3);
  const CliResult replay =
      Run({"replay", Path("can/recording.raw"), "--model", Path("can.obj"), "--surface", "as-is", "--camera",
           Path("can/camera.yaml"), "--init-pose", FirstPose("can"), "--out", Path("poses.csv")});
  EXPECT_EQ(replay.status, 0) << replay.err;
  // The cylinder counts as symmetric about its axis: its facets hardly change its image.
  const CliResult evaluation =
      Run({"evaluate", "--truth", Path("can/truth.tum"), "--estimate", Path("poses.csv"), "--model", Path("can.obj"),
           "--camera", Path("can/camera.yaml"), "--symmetric", "--json"});
  EXPECT_EQ(evaluation.status, 0) << evaluation.err;
  const nlohmann::json as_is = evaluation.Json()["estimates"][0];
  EXPECT_EQ(as_is["losses"], 0) << as_is;
  EXPECT_GT(as_is["coverage_ratio"].get<double>(), 0.9) << as_is;
  EXPECT_LT(as_is["position_rmse_of_depth"].get<double>(), 0.002) << as_is;
  EXPECT_LT(as_is["rotation_median_deg"].get<double>(), 0.9) << as_is;
  EXPECT_LT(as_is["surface_distance_mean_m"].get<double>(), 0.0005) << as_is;
}

TEST_F(ModelFormatsTest, APoseBehindTheCameraIsRefused) {
  SimulateCube(0.002);
  for (const char* z : {"-0.6", "-100"}) {
    const CliResult replay = Run(SearchArguments("poses.tum", {"--init-pose", std::string("0 0 ") + z + " 0 0 0 1"}));
    EXPECT_EQ(replay.status, 1);
    EXPECT_THAT(replay.err, HasSubstr("evpose replay: --init-pose: the object is behind the camera"));
  }
}

TEST_F(ModelFormatsTest, AModelOfMicrometresIsPrintedInThem) {
  WriteText("tiny.obj",
            "v 0 0 0\nv 0.000002 0 0\nv 0 0.000002 0\nv 0 0 0.000002\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
  const CliResult text = Run({"models", "inspect", Path("tiny.obj")});
  EXPECT_EQ(text.status, 0) << text.err;
  EXPECT_THAT(text.out, HasSubstr("tiny.obj: 2 x 2 x 2 micrometres, diameter 2.828 micrometres\n"));
  EXPECT_THAT(text.out, ::testing::Not(HasSubstr("inf")));
  EXPECT_THAT(text.out, HasSubstr("no view has an edge that can be tracked; the object is 2.828 micrometres across: if "
                                  "the file has another unit, give --scale, the metres per unit"));
  const CliResult scaled = Run({"models", "inspect", Path("tiny.obj"), "--scale", "1000"});
  EXPECT_THAT(scaled.out, HasSubstr("2 x 2 x 2 mm, diameter 2.828 mm\n"));
}

}  // namespace
}  // namespace evpose
