// SPDX-License-Identifier: Apache-2.0

// Tests evpose doctor.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/data/test_data.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

using DoctorTest = CliTest;

std::string ResultOf(const nlohmann::json& report, const std::string& check) {
  for (const nlohmann::json& each : report["checks"]) {
    if (each["check"] == check) return each["result"];
  }
  return "absent";
}

TEST_F(DoctorTest, CleanRecordingHasNoProblem) {
  SimulateCube(0.5);
  const std::string recording = Path("cube/recording.raw");
  const CliResult result =
      Run({"doctor", recording, "--model", Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  for (const nlohmann::json& check : result.Json()["checks"]) EXPECT_EQ(check["result"], "ok") << check;
  const CliResult text = Run({"doctor", recording});
  EXPECT_EQ(text.status, 0) << text.err;
  EXPECT_THAT(text.out, HasSubstr("0 problems, 0 pieces of advice, 2 checks not made"));
}

TEST_F(DoctorTest, FlickerIsAProblemWithItsRemedy) {
  ASSERT_EQ(Run({"simulate", "--camera", "vga", "--duration", "0.6", "--flicker", "0.3", "--out", Path("cube")}).status,
            0);
  const CliResult result = Run({"doctor", Path("cube/recording.raw")});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.out, ::testing::AnyOf(HasSubstr("flickers at 99.9 Hz"), HasSubstr("flickers at 100.0 Hz")));
  EXPECT_THAT(result.out, HasSubstr("-> use another lamp"));
  EXPECT_THAT(result.err, HasSubstr("problems were found: flicker"));
}

TEST_F(DoctorTest, WrongCameraAndScaleAreProblems) {
  SimulateCube(0.3);
  ASSERT_EQ(Run({"simulate", "--camera", "evk4", "--duration", "0.01", "--out", Path("other")}).status, 0);
  const CliResult camera = Run({"doctor", Path("cube/recording.raw"), "--camera", Path("other/camera.yaml"), "--json"});
  EXPECT_EQ(camera.status, 1);
  EXPECT_EQ(ResultOf(camera.Json(), "camera"), "problem");
  const CliResult scale = Run({"doctor", Path("cube/recording.raw"), "--camera", Path("cube/camera.yaml"), "--model",
                               Path("cube/model.obj"), "--scale", "1000"});
  EXPECT_EQ(scale.status, 1);
  EXPECT_THAT(scale.out, HasSubstr("millimetres: --scale 1\n"));
}

TEST_F(DoctorTest, ReadsAPipe) {
  SimulateCube(0.5);
  const CliResult result = RunShell("cat cube/recording.raw | evpose doctor - --duration 0.3 --json");
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.Json()["subjects"][0].get<std::string>(), HasSubstr("in 0.3"));
  // A file is no live camera.
  EXPECT_EQ(ResultOf(result.Json(), "packet-period"), "not checked");
}

TEST_F(DoctorTest, PartOfARecording) {
  SimulateCube(0.5);
  const CliResult result = Run({"doctor", Path("cube/recording.raw"), "--start", "0.1", "--duration", "0.3", "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.Json()["subjects"][0].get<std::string>(), HasSubstr("in 0.300 s"));
}

TEST_F(DoctorTest, Errors) {
  EXPECT_EQ(Run({"doctor"}).status, 2);
  EXPECT_EQ(Run({"doctor", "-", "--start", "1"}).status, 2);
  EXPECT_EQ(Run({"doctor", "r.raw", "--model", "m.obj"}).status, 2);
  const CliResult missing = Run({"doctor", Path("none.raw")});
  EXPECT_EQ(missing.status, 1);
  EXPECT_THAT(missing.err, HasSubstr("none.raw"));
  const CliResult silent =
      RunShell("mkfifo pipe; sleep 30 > pipe & evpose doctor - --duration 0.1 < pipe || echo failed; kill $!");
  EXPECT_THAT(silent.err, HasSubstr("sent no header within 0.1 s"));
}

// The recordings of real sensors have no defect that prevents tracking.
class DoctorOnRealTest : public CliTest, public ::testing::WithParamInterface<const char*> {};

TEST_P(DoctorOnRealTest, HasNoProblem) {
  const std::string folder = FindTestData("real");
  if (folder.empty()) GTEST_SKIP() << "real is not in the test data";
  const CliResult result = Run({"doctor", folder + "/" + GetParam()});
  EXPECT_EQ(result.status, 0) << result.out << result.err;
}

INSTANTIATE_TEST_SUITE_P(TestData, DoctorOnRealTest,
                         ::testing::Values("shapes_rotation/recording.raw", "shapes_rotation_fast/recording.raw",
                                           "phone_shake/recording.raw", "cube_turntable/recording.raw",
                                           "checkerboard_flash/09.raw", "checkerboard_flash/20.raw",
                                           "negatives/screwdriver.raw"),
                         [](const auto& test) { return "Recording" + std::to_string(test.index); });

}  // namespace
}  // namespace evpose
