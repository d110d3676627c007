// SPDX-License-Identifier: Apache-2.0

// Tests evpose doctor.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "core/base/closed_port_testing.h"
#include "tests/data/test_data.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/cutting_proxy.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

using DoctorTest = CliTest;

nlohmann::json CheckOf(const nlohmann::json& report, const std::string& check) {
  for (const nlohmann::json& each : report["checks"]) {
    if (each["check"] == check) return each;
  }
  return {{"result", "absent"}};
}

std::string ResultOf(const nlohmann::json& report, const std::string& check) {
  return CheckOf(report, check)["result"];
}

TEST_F(DoctorTest, CleanRecordingHasNoProblem) {
  SimulateCube(0.5);
  const std::string recording = Path("cube/recording.raw");
  const CliResult result =
      Run({"doctor", recording, "--model", Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  for (const nlohmann::json& check : result.Json()["checks"]) {
    // The cube moves in a part of the image only.
    EXPECT_EQ(check["result"], check["check"] == "dead-pixels" ? "not checked" : "ok") << check;
  }
  const CliResult text = Run({"doctor", recording});
  EXPECT_EQ(text.status, 0) << text.err;
  EXPECT_THAT(text.out, HasSubstr("0 problems, 0 pieces of advice, 3 checks not made"));
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
  // The pipe ends before this time, also on a busy machine.
  const CliResult result = RunShell("cat cube/recording.raw | evpose doctor - --duration 600 --json");
  EXPECT_THAT(result.Json()["subjects"][0].get<std::string>(), HasSubstr("in 0.500"));
  EXPECT_EQ(ResultOf(result.Json(), "decoding"), "ok");
  // Whether the pipe is as fast as a camera depends on the machine.
  EXPECT_NE(ResultOf(result.Json(), "packet-period"), "absent");
}

TEST_F(DoctorTest, PartOfARecording) {
  SimulateCube(0.5);
  const CliResult result = Run({"doctor", Path("cube/recording.raw"), "--start", "0.1", "--duration", "0.3", "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.Json()["subjects"][0].get<std::string>(),
              ::testing::MatchesRegex(".*, [0-9]+ events of the [0-9]+ that were decoded, in 0.300 s"));
}

TEST_F(DoctorTest, AStartBehindTheEndIsAnError) {
  SimulateCube(0.02);
  const CliResult result = Run({"doctor", Path("cube/recording.raw"), "--start", "5"});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err,
              HasSubstr("recording.raw: has no events later than --start, 5 s after its first event: give an "));
}

TEST_F(DoctorTest, Errors) {
  const CliResult nothing = Run({"doctor"});
  EXPECT_EQ(nothing.status, 2);
  EXPECT_THAT(nothing.err, HasSubstr("give a RECORDING, --server HOST:PORT, or --replay FILE"));
  EXPECT_EQ(Run({"doctor", "-", "--start", "1"}).status, 2);
  EXPECT_EQ(Run({"doctor", "r.raw", "--model", "m.obj"}).status, 2);
  const CliResult missing = Run({"doctor", Path("none.raw")});
  EXPECT_EQ(missing.status, 1);
  EXPECT_THAT(missing.err, HasSubstr("none.raw"));
  const CliResult silent =
      RunShell("mkfifo pipe; sleep 30 > pipe & evpose doctor - --duration 0.1 < pipe || echo failed; kill $!");
  EXPECT_THAT(silent.err, HasSubstr("sent no header within 0.1 s"));
}

// Reading a recording may take minutes.
TEST_F(DoctorTest, ReadsModelAndCameraBeforeTheRecording) {
  SimulateCube(0.01);
  WriteText("bad.obj", "f 1 2 3\n");
  const CliResult model =
      Run({"doctor", Path("none.raw"), "--model", Path("bad.obj"), "--camera", Path("cube/camera.yaml")});
  EXPECT_EQ(model.status, 1);
  EXPECT_THAT(model.err, AllOf(HasSubstr("bad.obj"), Not(HasSubstr("none.raw"))));
}

TEST_F(DoctorTest, LinesThatAreNoEventsAreAProblem) {
  SimulateCube(0.3);
  ASSERT_EQ(Run({"convert", Path("cube/recording.raw"), Path("events.csv")}).status, 0);
  const std::string events = ReadText("events.csv");
  EXPECT_EQ(ResultOf(Run({"doctor", Path("events.csv"), "--json"}).Json(), "decoding"), "ok");
  std::string garbage;
  for (int i = 0; i < 2000; ++i) garbage += "1,2,x,y\n";
  WriteText("damaged.csv", events + garbage);
  const CliResult damaged = Run({"doctor", Path("damaged.csv")});
  EXPECT_EQ(damaged.status, 1);
  EXPECT_THAT(damaged.out, HasSubstr("left out: 2000 lines that are not events"));
  EXPECT_THAT(damaged.err, HasSubstr("problems were found: decoding"));
}

TEST_F(DoctorTest, CountsStepsBackAsInfo) {
  SimulateCube(0.3);
  ASSERT_EQ(Run({"convert", Path("cube/recording.raw"), Path("events.csv")}).status, 0);
  // Two events, one after the other, are 1 ms late: the time steps back once, not twice.
  std::string events = ReadText("events.csv");
  const size_t second = events.find('\n', events.size() / 2) + 1;
  const std::string line = events.substr(second, events.find('\n', second) + 1 - second);
  const int64_t t_us = std::stoll(line.substr(line.rfind(',') + 1));
  const std::string late = "1,2,1," + std::to_string(t_us - 1000) + "\n";
  events.insert(second, late + late);
  WriteText("late.csv", events);
  EXPECT_EQ(Run({"info", Path("late.csv"), "--json"}).Json()["time_backsteps"], 1);
  EXPECT_THAT(Run({"doctor", Path("late.csv")}).out,
              HasSubstr("time stamps step back 1 time; the largest step between events is 1"));
}

using DoctorServerTest = CliTest;

TEST_F(DoctorServerTest, AllChecksOfAServer) {
  SimulateCube(0.3);
  const LocalServer server = StartLocalServer();
  const CliResult result = Run({"doctor", Path("cube/recording.raw"), "--model", Path("cube/model.obj"), "--camera",
                                Path("cube/camera.yaml"), "--server", server.address, "--json"});
  const nlohmann::json report = result.Json();
  for (const char* check : {"connection", "health", "version", "sessions", "model-bytes", "server-clock", "clock"}) {
    EXPECT_EQ(ResultOf(report, check), "ok") << check << CheckOf(report, check);
  }
  // These depend on the machine.
  EXPECT_GT(CheckOf(report, "round-trip")["value"], 0.0);
  EXPECT_GT(CheckOf(report, "link")["value"], 0.0);
  EXPECT_THAT(CheckOf(report, "link")["text"].get<std::string>(), HasSubstr("the recording has"));
  EXPECT_EQ(CheckOf(report, "sessions")["value"], 0.0);
  EXPECT_EQ(Run({"models", "list", "--server", server.address, "--json"}).Json(), nlohmann::json::array());

  const nlohmann::json alone = Run({"doctor", "--server", server.address, "--json"}).Json();
  EXPECT_EQ(alone["subjects"], nlohmann::json::array({"server " + server.address}));
  EXPECT_EQ(CheckOf(alone, "link")["unit"], "Mbit/s");
  EXPECT_EQ(ResultOf(alone, "model-bytes"), "not checked");
  EXPECT_EQ(ResultOf(alone, "decoding"), "absent");
  // Each check is printed below its subject.
  const std::string text = Run({"doctor", Path("cube/recording.raw"), "--server", server.address}).out;
  const size_t server_line = text.find("\nserver " + server.address + "\n");
  ASSERT_NE(server_line, std::string::npos) << text;
  EXPECT_LT(text.find(" decoding "), server_line);
  EXPECT_GT(text.find(" connection "), server_line);
}

TEST_F(DoctorServerTest, LimitsOfAServer) {
  SimulateCube(0.01);
  server::ServerOptions options;
  options.max_model_bytes = 100;
  const LocalServer server = StartLocalServer(options);
  const CliResult result = Run({"doctor", "--server", server.address, "--model", Path("cube/model.obj")});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.out, AllOf(HasSubstr("the server accepts 100"), HasSubstr("-> simplify the mesh")));
  EXPECT_THAT(result.out, HasSubstr("too few for a measurement"));
  EXPECT_THAT(result.err, HasSubstr("problems were found: model-bytes"));
}

// The models leave less room than the first probe needs.
TEST_F(DoctorServerTest, UploadsThatTheServerRefusesAreNoMeasurement) {
  SimulateCube(0.01);
  server::ServerOptions options;
  options.max_model_bytes = options.max_model_store_bytes = 66'000;
  const LocalServer server = StartLocalServer(options);
  ASSERT_EQ(Run({"models", "upload", Path("cube/model.obj"), "--server", server.address}).status, 0);
  const CliResult result = Run({"doctor", "--server", server.address, "--json"});
  EXPECT_EQ(ResultOf(result.Json(), "link"), "not checked") << result.out;
}

TEST_F(DoctorServerTest, ServerThatShutsDown) {
  const LocalServer server = StartLocalServer();
  ASSERT_EQ(Run({"sessions", "drain", "--server", server.address}).status, 0);
  const CliResult result = Run({"doctor", "--server", server.address});
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.out, HasSubstr("NOT_SERVING"));
  EXPECT_THAT(result.err, HasSubstr("problems were found: health, sessions"));
}

TEST_F(DoctorServerTest, UnreachableServers) {
  const ClosedPort closed;
  const std::string port = std::to_string(closed.port());
  const CliResult refused = Run({"doctor", "--server", closed.address(), "--connect-timeout", "0.2"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.out, HasSubstr("nothing listens on port " + port + " of 127.0.0.1"));
  EXPECT_THAT(refused.out, HasSubstr("-> start evpose-server there"));
  EXPECT_THAT(refused.out, HasSubstr("1 problem, 0 pieces of advice, 7 checks not made"));
  EXPECT_THAT(refused.err, HasSubstr("problems were found: connection"));
  // Another program listens there.
  const CuttingProxy other;
  const CliResult wrong = Run({"doctor", "--server", other.address(), "--connect-timeout", "0.2"});
  EXPECT_EQ(wrong.status, 1);
  EXPECT_THAT(wrong.out, HasSubstr("-> a program listens there"));
  // One of two servers is enough for a session, but each is checked.
  const LocalServer server = StartLocalServer();
  const CliResult both =
      Run({"doctor", "--server", absl::StrCat(other.address(), ",", server.address), "--connect-timeout", "0.2"});
  EXPECT_EQ(both.status, 1);
  EXPECT_THAT(both.out, HasSubstr(absl::StrCat(server.address, ": the server is reachable")));
}

TEST_F(DoctorServerTest, ErrorsOfTheFilesOfTheConnection) {
  const CliResult token = Run({"doctor", "--server", "127.0.0.1:1", "--token-file", Path("none")});
  EXPECT_EQ(token.status, 1);
  EXPECT_THAT(token.err, HasSubstr("none"));
  EXPECT_EQ(token.out, "");
  EXPECT_EQ(Run({"doctor", "--server", "127.0.0.1:1", "--tls-cert", Path("none")}).status, 2);
  EXPECT_EQ(Run({"doctor", "r.raw", "--tls"}).status, 2);
}

class DoctorBundleTest : public CliTest {
 protected:
  // Writes bundle.tar of the simulated cube.
  CliResult Pack(const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {"doctor",   Path("cube/recording.raw"), "--model",  Path("cube/model.obj"),
                                          "--camera", Path("cube/camera.yaml"),   "--bundle", Path("bundle.tar")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  }
  // Unpacks bundle.tar, runs `script` in its folder and packs changed.tar with sums that fit.
  void Change(const std::string& script) const {
    const CliResult result =
        RunShell("rm -rf x; mkdir x; tar -xf bundle.tar -C x; cd x/evpose-bundle; " + script +
                 "; sha256sum $(ls | grep -v SHA256SUMS) > SHA256SUMS; cd ..; tar -cf ../changed.tar evpose-bundle");
    ASSERT_EQ(result.status, 0) << result.err;
  }
  CliResult ReplayChanged() const { return Run({"doctor", "--replay", Path("changed.tar")}); }
};

TEST_F(DoctorBundleTest, ReplaysToTheBitElsewhere) {
  SimulateCube(0.4);
  const CliResult packed = Pack();
  ASSERT_EQ(packed.status, 0) << packed.out << packed.err;
  EXPECT_THAT(packed.out, HasSubstr("bundle.tar: bundle of 16.0"));
  EXPECT_THAT(packed.out, Not(HasSubstr("is left out")));
  // The poses are those of a replay of the whole recording.
  ASSERT_EQ(Run(SearchArguments("poses.jsonl")).status, 0);
  const std::string poses = ReadText("poses.jsonl");
  const CliResult elsewhere = RunShell(
      "mkdir elsewhere; mv bundle.tar elsewhere; rm -r cube; cd elsewhere; tar -xf bundle.tar; "
      "cd evpose-bundle; sha256sum -c SHA256SUMS >&2; cat poses.jsonl >../poses.jsonl; cd ..; "
      "evpose doctor --replay bundle.tar --json");
  ASSERT_EQ(elsewhere.status, 0) << elsewhere.err;
  EXPECT_EQ(ReadText("elsewhere/poses.jsonl"), poses);
  EXPECT_EQ(elsewhere.Json()["identical"], true);
  EXPECT_GT(elsewhere.Json()["poses"], 100);
  EXPECT_EQ(elsewhere.Json()["poses"], elsewhere.Json()["expected_poses"]);
  const CliResult text = Run({"doctor", "--replay", Path("elsewhere/bundle.tar")});
  EXPECT_THAT(text.out, HasSubstr(": identical to the bit\n"));
}

TEST_F(DoctorBundleTest, PartWithOptions) {
  SimulateCube(0.4);
  WriteText("sensor.yaml", "blur_px: 0.6\n");
  const CliResult packed = Pack({"--duration", "0.2", "--sensor", Path("sensor.yaml"), "--init-pose", FirstPose(),
                                 "--crease-angle", "20", "--json"});
  ASSERT_EQ(packed.status, 0) << packed.out << packed.err;
  EXPECT_THAT(packed.Json()["subjects"].back().get<std::string>(),
              ::testing::AnyOf(HasSubstr("to 16.19"), HasSubstr("to 16.20")));
  const CliResult replayed = Run({"doctor", "--replay", Path("bundle.tar"), "--json"});
  ASSERT_EQ(replayed.status, 0) << replayed.err;
  EXPECT_EQ(replayed.Json()["identical"], true);
  EXPECT_GT(replayed.Json()["poses"], 10);
  // Without the sensor's profile the poses are others.
  Change("sed -i 's/blur_px: .*/blur_px: 0.47/' sensor.yaml");
  EXPECT_EQ(ReplayChanged().status, 1);
  const CliResult later = Pack({"--start", "0.1", "--json"});
  ASSERT_EQ(later.status, 0) << later.out << later.err;
  EXPECT_THAT(later.Json()["subjects"].back().get<std::string>(), HasSubstr("bundle of 16.10"));
  EXPECT_EQ(Run({"doctor", "--replay", Path("bundle.tar"), "--json"}).Json()["identical"], true);
}

TEST_F(DoctorBundleTest, SaysWhereThePosesDiffer) {
  SimulateCube(0.3);
  ASSERT_EQ(Pack({"--init-pose", FirstPose()}).status, 0);
  Change("sed -i '5s/\"num_events\":/\"num_events\":9/' poses.jsonl");
  const CliResult one = ReplayChanged();
  EXPECT_EQ(one.status, 1);
  EXPECT_THAT(one.out, AllOf(HasSubstr("of which 1 differ, by at most 0 m and 0 rad"),
                             HasSubstr("first difference: pose 5, at 16.0"), HasSubstr(" instead of 9")));
  EXPECT_THAT(one.err, HasSubstr("the poses differ from those of evpose"));
  Change(
      "sed -i '7s/\"quaternion_xyzw\":[^]]*/\"quaternion_xyzw\":[0,0,0,1/;7s/\"translation_m\":[^]]*/"
      "\"translation_m\":[0,0,9/' poses.jsonl");
  EXPECT_THAT(ReplayChanged().out, AllOf(HasSubstr("pose 7, at 16.0"), HasSubstr("translation_m by at most "),
                                         HasSubstr("quaternion_xyzw by at most")));
  Change("sed -i '$d' poses.jsonl");
  EXPECT_THAT(ReplayChanged().out, HasSubstr("is not in the bundle"));
  Change("tail -n 1 poses.jsonl >last; cat last >>poses.jsonl; rm last");
  EXPECT_THAT(ReplayChanged().out, HasSubstr("is in the bundle alone"));
  Change("echo '{}' >>poses.jsonl");
  EXPECT_THAT(ReplayChanged().err, HasSubstr("changed.tar: poses.jsonl"));
  Change("printf '\\r\\n' >>poses.jsonl");
  EXPECT_THAT(ReplayChanged().err, HasSubstr("has lines without a pose"));
}

TEST_F(DoctorBundleTest, DamagedBundles) {
  SimulateCube(0.1);
  ASSERT_NE(Pack({"--init-pose", FirstPose()}).out, "");
  const std::string bundle = ReadText("bundle.tar");
  WriteText("changed.tar", bundle.substr(0, bundle.size() / 2));
  EXPECT_THAT(ReplayChanged().err, HasSubstr("the archive ends within evpose-bundle/"));
  std::string changed = bundle;
  changed[bundle.size() / 2] ^= 1;
  WriteText("changed.tar", changed);
  EXPECT_THAT(ReplayChanged().err, HasSubstr("differs from its SHA-256"));
  EXPECT_THAT(Run({"doctor", "--replay", Path("none.tar")}).err, HasSubstr("none.tar"));
  // Parts that are wrong, with sums that fit.
  Change("echo 'no header' >recording.raw");
  EXPECT_THAT(ReplayChanged().err, HasSubstr("changed.tar: "));
  EXPECT_EQ(ReplayChanged().status, 1);
  Change("echo 'f 1 2 3' >model.obj");
  EXPECT_THAT(ReplayChanged().err, HasSubstr("the model of "));
  Change("sed -i 's/640/320/' camera.yaml");
  EXPECT_THAT(ReplayChanged().err, HasSubstr("camera"));
  Change("sed -i 's/\"initial_pose\": \"/&x/' bundle.json");
  EXPECT_EQ(ReplayChanged().status, 1);
}

TEST_F(DoctorBundleTest, Errors) {
  SimulateCube(0.1);
  const CliResult folder = Run({"doctor", Path("cube/recording.raw"), "--model", Path("cube/model.obj"), "--camera",
                                Path("cube/camera.yaml"), "--bundle", Path("none/bundle.tar")});
  EXPECT_EQ(folder.status, 1);
  EXPECT_THAT(folder.err, HasSubstr("none/bundle.tar"));
  const CliResult late = Pack({"--start", "5"});
  EXPECT_EQ(late.status, 1);
  EXPECT_THAT(late.err, HasSubstr("has no events later than --start, 5 s after its first event"));
  EXPECT_TRUE(FilesBeginning("bundle.tar").empty());
  EXPECT_EQ(Pack({"--init-pose", "1 2 3"}).status, 2);
  EXPECT_EQ(Pack({"--server", "127.0.0.1:1"}).status, 2);
  EXPECT_EQ(Pack({"--replay", "other.tar"}).status, 2);
  EXPECT_EQ(Run({"doctor", Path("cube/recording.raw"), "--bundle", Path("bundle.tar")}).status, 2);
  EXPECT_EQ(Run({"doctor", Path("cube/recording.raw"), "--init-pose", FirstPose()}).status, 2);
  const CliResult pipe = Run({"doctor", "-", "--model", Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"),
                              "--bundle", Path("bundle.tar")});
  EXPECT_EQ(pipe.status, 2);
  EXPECT_THAT(pipe.err, HasSubstr("standard input cannot be read twice"));
  EXPECT_TRUE(FilesBeginning("bundle.tar").empty());
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
