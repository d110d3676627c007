// SPDX-License-Identifier: Apache-2.0

// Tests replays through client and server with options that must not change the poses.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <sstream>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "client/lib/fake_clock_testing.h"
#include "client/lib/messages/core_types.h"
#include "core/base/byte_order.h"
#include "core/base/poll_testing.h"
#include "core/base/status_macros.h"
#include "core/geometry/camera.h"
#include "core/models/object_model.h"
#include "evpose/client.h"
#include "evpose/recording.h"
#include "tests/data/test_data.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

class ReplayTest : public CliTest {
 protected:
  void StartServer() { server_ = StartLocalServer(); }

  LocalServer server_;
};

TEST_F(ReplayTest, SameBytesAtAnyRateOnAnyChunkingInProcessAndOverASocket) {
  SimulateCube(0.25);
  StartServer();
  const CliResult first = Run(ReplayArguments("first.csv"));
  ASSERT_EQ(first.status, 0) << first.err;
  ASSERT_GT(first.Json()["poses"], 100);
  const std::string expected = ReadText("first.csv");
  const std::vector<std::vector<std::string>> ways = {
      {},
      {"--chunk-bytes", "4096"},
      {"--chunk-bytes", "1048576"},
      {"--rate", "1"},
      {"--server", server_.address},
      {"--server", server_.address, "--rate", "1"},
      {"--server", server_.address, "--chunk-bytes", "4096", "--rate", "2.5"},
      {"--server", server_.address, "--chunk-bytes", "1048576"},
  };
  for (const std::vector<std::string>& way : ways) {
    client::FakeClock clock;
    const absl::Time begin = clock.Now();
    const CliResult result = Run(ReplayArguments("other.csv", way), &clock);
    SCOPED_TRACE(::testing::PrintToString(way));
    ASSERT_EQ(result.status, 0) << result.err;
    EXPECT_TRUE(ReadText("other.csv") == expected);
    const bool is_paced = std::find(way.begin(), way.end(), "1") != way.end();
    if (is_paced) {
      EXPECT_GE(clock.Now() - begin, absl::Milliseconds(245));
    }
  }
  // Each replay has deleted its session.
  EXPECT_EQ(Run({"sessions", "list", "--server", server_.address}).out, "");
}

TEST_F(ReplayTest, PosesFollowTheTruth) {
  SimulateCube(0.25);
  const CliResult replay = Run(ReplayArguments("poses.tum"));
  ASSERT_EQ(replay.status, 0) << replay.err;
  const nlohmann::json report = replay.Json();
  EXPECT_EQ(report["losses"], 0);
  EXPECT_EQ(report["state"], "TRACKING");
  EXPECT_EQ(report["truncated_bytes"], 0);
  EXPECT_GT(report["latency_p99_ms"], 0.0);
  const nlohmann::json info = Run({"info", Path("cube/recording.raw"), "--json"}).Json();
  EXPECT_EQ(report["events"], info["cd_events"]);
  const CliResult evaluation =
      Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", "evpose=" + Path("poses.tum"), "--model",
           Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "--json"});
  ASSERT_EQ(evaluation.status, 0) << evaluation.err;
  const nlohmann::json row = evaluation.Json()["estimates"][0];
  EXPECT_EQ(row["name"], "evpose");
  EXPECT_EQ(row["poses"], report["poses"]);
  EXPECT_GT(row["coverage_ratio"], 0.9);
  EXPECT_LT(row["position_rmse_of_depth"], 0.02);
  EXPECT_LT(row["reprojection_mean_px"], 3.0);
}

// No initial pose is given.
TEST_F(ReplayTest, FindsTheFirstPose) {
  SimulateCube(0.25);
  StartServer();
  const CliResult replay = Run(SearchArguments("poses.tum"));
  ASSERT_EQ(replay.status, 0) << replay.err;
  const nlohmann::json report = replay.Json();
  EXPECT_EQ(report["state"], "TRACKING");
  EXPECT_EQ(report["losses"], 0);
  EXPECT_EQ(report["initialization"], "NOT_NEEDED");
  EXPECT_EQ(report["detail"], "");
  EXPECT_EQ(report["symmetries"], 24);
  EXPECT_NEAR(report["model_diameter_m"], 0.2 * std::sqrt(3.0), 1e-6);
  const CliResult evaluation =
      Run({"evaluate", "--truth", Path("cube/truth.tum"), "--estimate", "evpose=" + Path("poses.tum"), "--model",
           Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"), "--symmetric", "--json"});
  ASSERT_EQ(evaluation.status, 0) << evaluation.err;
  const nlohmann::json row = evaluation.Json()["estimates"][0];
  EXPECT_GT(row["coverage_ratio"], 0.7);
  EXPECT_LT(row["position_rmse_of_depth"], 0.02);
  EXPECT_LT(row["reprojection_mean_px"], 3.0);

  const std::string expected = ReadText("poses.tum");
  for (const std::vector<std::string>& way : {std::vector<std::string>{"--server", server_.address},
                                              {"--chunk-bytes", "4096"},
                                              {"--server", server_.address, "--chunk-bytes", "1048576"}}) {
    const CliResult other = Run(SearchArguments("other.tum", way));
    ASSERT_EQ(other.status, 0) << other.err;
    EXPECT_TRUE(ReadText("other.tum") == expected) << ::testing::PrintToString(way);
  }
}

TEST_F(ReplayTest, SeveralObjectsHavePosesOfTheirOwn) {
  SimulateCube(0.25);
  const auto arguments = [&](const std::string& out, const std::vector<std::string>& more = {}) {
    std::vector<std::string> all = {"replay",      Path("cube/recording.raw"),
                                    "--object",    "near=" + Path("cube/model.obj"),
                                    "--object",    "missing=" + Path("cube/model.obj"),
                                    "--camera",    Path("cube/camera.yaml"),
                                    "--init-pose", "near=" + FirstPose(),
                                    "--out",       Path(out),
                                    "--json"};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  };
  const CliResult replay = Run(arguments("{object}.tum"));
  ASSERT_EQ(replay.status, 1) << replay.err;
  EXPECT_THAT(replay.err, HasSubstr("no pose of missing was found"));
  const nlohmann::json report = replay.Json();
  ASSERT_EQ(report["objects"].size(), 2u);
  EXPECT_EQ(report["objects"][0]["object_id"], "near");
  EXPECT_EQ(report["objects"][0]["state"], "TRACKING");
  EXPECT_EQ(report["objects"][1]["object_id"], "missing");
  EXPECT_EQ(report["objects"][1]["state"], "INITIALIZING") << "the only cube in view is tracked as the other object";
  EXPECT_EQ(report["losses"], 0);
  const std::string near = ReadText("near.tum");
  EXPECT_EQ(std::count(near.begin(), near.end(), '\n'), report["poses"]);
  EXPECT_EQ(ReadText("missing.tum"), "");

  ASSERT_EQ(Run(arguments("all.csv")).status, 1) << "the other object has no pose";
  EXPECT_THAT(ReadText("all.csv"), HasSubstr(",near,"));

  const CliResult one_file = Run(arguments("all.tum"));
  EXPECT_EQ(one_file.status, 2);
  EXPECT_THAT(one_file.err, HasSubstr("{object}"));
  EXPECT_EQ(Run(arguments("a.csv", {"--object", "near=" + Path("cube/model.obj")})).status, 2);
  EXPECT_EQ(Run(arguments("a.csv", {"--object", Path("cube/model.obj")})).status, 2);
  EXPECT_EQ(Run(arguments("a.csv", {"--init-pose", "far=0 0 1 0 0 0 1"})).status, 2);
  EXPECT_EQ(Run(arguments("a.csv", {"--model", Path("cube/model.obj")})).status, 2);
}

// Returns the first pose that a new session finds in the cube's recording, with this reference rotation.
absl::StatusOr<RigidTransform> FirstPoseFound(client::Client& client, const std::string& recording,
                                              client::SessionConfig config,
                                              const std::optional<Eigen::Matrix3d>& reference) {
  config.objects[0].reference_rotation = reference;
  EVPOSE_ASSIGN_OR_RETURN(const auto session, client.CreateSession(config));
  EVPOSE_ASSIGN_OR_RETURN(const auto opened, client::Recording::Open(recording));
  std::optional<RigidTransform> first;
  client::TrackCallbacks callbacks;
  callbacks.on_pose = [&](const client::Pose& pose) {
    if (!first) first = client::ToCore(pose.camera_from_object);
  };
  EVPOSE_RETURN_IF_ERROR(client.Track(session, [&] { return opened->Next(); }, callbacks, {}).status());
  if (!first) return absl::NotFoundError("no pose");
  return *first;
}

TEST_F(ReplayTest, OfEquivalentPosesTheOneNearestToTheReferenceIsFound) {
  SimulateCube(0.06);
  StartServer();
  const auto client = client::Client::Connect(server_.address);
  ASSERT_TRUE(client.ok()) << client.status();
  const std::string file = ReadText("cube/model.obj");
  const auto uploaded = (*client)->UploadModel(AsBytes(file), {});
  ASSERT_TRUE(uploaded.ok()) << uploaded.status();
  const auto camera = client::LoadCamera(Path("cube/camera.yaml"));
  const auto model = LoadObjectModel(Path("cube/model.obj"));
  ASSERT_TRUE(camera.ok() && model.ok());
  client::SessionConfig config;
  config.camera = *camera;
  config.objects.push_back({.model = uploaded->name});
  const auto find = [&](const std::optional<Eigen::Matrix3d>& reference) {
    return FirstPoseFound(**client, Path("cube/recording.raw"), config, reference);
  };
  const auto plain = find(std::nullopt);
  ASSERT_TRUE(plain.ok()) << plain.status();
  ASSERT_EQ(model->symmetries.size(), 24u);
  for (const RigidTransform& symmetry : model->symmetries) {
    EXPECT_GE(RotationAngle((*plain * symmetry).rotation, Eigen::Matrix3d::Identity()),
              RotationAngle(plain->rotation, Eigen::Matrix3d::Identity()) - 1e-9);
  }
  // Each orientation can be selected; three of them suffice here.
  for (const size_t wanted : {1, 7, 23}) {
    const RigidTransform expected = *plain * model->symmetries[wanted];
    const auto found = find(expected.rotation);
    ASSERT_TRUE(found.ok()) << found.status();
    EXPECT_LT(RotationAngle(found->rotation, expected.rotation), 0.01);
    EXPECT_LT((found->translation_m - expected.translation_m).norm(), 0.005);
  }
}

TEST_F(ReplayTest, ReportsWhyNoPoseWasFound) {
  SimulateCube(0.001);  // some hundred events
  StartServer();
  const CliResult replay = Run(SearchArguments("poses.tum", {"--server", server_.address, "--keep-session"}));
  ASSERT_EQ(replay.status, 1);
  EXPECT_THAT(replay.err, HasSubstr("recording.raw: no pose was found; the report has the reason\n"));
  EXPECT_EQ(replay.Json()["poses"], 0);
  EXPECT_EQ(replay.Json()["state"], "INITIALIZING");
  EXPECT_EQ(replay.Json()["initialization"], "WAITING_FOR_EVENTS");
  EXPECT_THAT(std::string(replay.Json()["detail"]), HasSubstr("too few events"));
  std::vector<std::string> arguments = SearchArguments("poses.tum");
  std::erase(arguments, "--json");
  EXPECT_THAT(Run(arguments).out,
              HasSubstr("\nno pose found: too few events: no object is in view, or it does not move"));

  const std::string session = replay.Json()["session"];
  const CliResult list = Run({"sessions", "list", "--server", server_.address});
  EXPECT_THAT(list.out, HasSubstr("object INITIALIZING (WAITING_FOR_EVENTS), 0 losses"));
  const CliResult get = Run({"sessions", "get", session, "--server", server_.address});
  EXPECT_THAT(get.out, HasSubstr("\nobject: too few events"));
  const CliResult watch = Run({"watch", session, "--server", server_.address});
  EXPECT_EQ(watch.status, 1);
  EXPECT_EQ(watch.out, "");
  EXPECT_THAT(watch.err, HasSubstr("object: INITIALIZING (WAITING_FOR_EVENTS): too few events"));
  EXPECT_THAT(watch.err, HasSubstr(session + ": the session has ended without a pose; object: INITIALIZING"));
  const nlohmann::json object =
      Run({"sessions", "get", session, "--server", server_.address, "--json"}).Json()["objects"][0];
  EXPECT_EQ(object["initialization"], "WAITING_FOR_EVENTS");
  EXPECT_THAT(std::string(object["detail"]), HasSubstr("too few events"));
}

TEST_F(ReplayTest, ReportEndsWithItsNumbers) {
  SimulateCube(0.05);
  std::vector<std::string> arguments = ReplayArguments("poses.tum");
  arguments.erase(std::find(arguments.begin(), arguments.end(), "--json"));
  const CliResult result = Run(arguments);
  ASSERT_EQ(result.status, 0) << result.err;
  const std::string body = result.out.substr(0, result.out.size() - 1);
  EXPECT_THAT(
      body.substr(body.rfind('\n') + 1),
      ::testing::MatchesRegex("events [0-9]+  poses [0-9]+  losses [0-9]+  [0-9.]+ Mev/s  latency p50 [0-9.]+ ms "
                              " p99 [0-9.]+ ms"));
}

TEST_F(ReplayTest, TruncatedRecordingIsUsedUpToItsEnd) {
  SimulateCube(0.1);
  const auto size = std::filesystem::file_size(Path("cube/recording.raw"));
  std::filesystem::resize_file(Path("cube/recording.raw"), size / 4 * 2 + 1);
  const CliResult result = Run(ReplayArguments("poses.tum"));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.Json()["truncated_bytes"], 1);
  EXPECT_GT(result.Json()["poses"], 20);
  std::vector<std::string> arguments = ReplayArguments("poses.tum");
  arguments.erase(std::find(arguments.begin(), arguments.end(), "--json"));
  EXPECT_THAT(Run(arguments).out, HasSubstr("truncated: the last byte is no whole word"));
}

TEST_F(ReplayTest, StandardInput) {
  SimulateCube(0.05);
  ASSERT_EQ(Run(ReplayArguments("file.tum")).status, 0);
  const CliResult result = RunShell("evpose replay - --model cube/model.obj --camera cube/camera.yaml --init-pose '" +
                                    FirstPose() + "' --out stdin.tum < cube/recording.raw");
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_FALSE(ReadText("stdin.tum").empty());
  EXPECT_EQ(ReadText("stdin.tum"), ReadText("file.tum"));
}

TEST_F(ReplayTest, AnotherObjectsRecordingEndsLostWithoutAPose) {
  const std::string recording = FindTestData("evt3_driving_gen41/evt3_sample.raw");
  if (recording.empty()) GTEST_SKIP() << "the recording is not in the test data";
  ASSERT_EQ(Run({"simulate", "--object", "cube", "--duration", "0.001", "--out", Path("cube")}).status, 0);
  std::vector<std::string> arguments = ReplayArguments("poses.tum");
  arguments[1] = recording;
  arguments.back() = "0 0 1 0 0 0 1";
  const CliResult result = Run(arguments);
  ASSERT_EQ(result.status, 1);
  EXPECT_EQ(result.Json()["state"], "LOST");
  EXPECT_NE(result.Json()["loss_cause"], nullptr);
  EXPECT_EQ(result.Json()["losses"], 1);
  EXPECT_EQ(result.Json()["poses"], 0);
  EXPECT_TRUE(std::filesystem::exists(Path("poses.tum")));
  EXPECT_EQ(ReadText("poses.tum"), "");
  arguments.erase(std::find(arguments.begin(), arguments.end(), "--json"));
  const CliResult text = Run(arguments);
  EXPECT_THAT(text.out, ::testing::ContainsRegex("LOST: lost at [0-9.]+ s because "));
  EXPECT_THAT(text.out, HasSubstr("poses.tum: 0 poses"));
}

// The first wait of a paced replay truncates the recording.
class TruncatingClock final : public client::Clock {
 public:
  explicit TruncatingClock(std::string path) : path_(std::move(path)) {}
  absl::Time Now() override { return clock_.Now(); }
  bool SleepUntil(absl::Time time, std::stop_token stop) override {
    if (!path_.empty()) std::filesystem::resize_file(path_, std::filesystem::file_size(path_) * 3 / 4);
    path_.clear();
    return clock_.SleepUntil(time, stop);
  }

 private:
  std::string path_;
  client::FakeClock clock_;
};

TEST_F(ReplayTest, RecordingThatChangesLeavesAnErrorAndThePosesSoFar) {
  SimulateCube(0.2);
  TruncatingClock clock(Path("cube/recording.raw"));
  const CliResult result = Run(ReplayArguments("poses.tum", {"--rate", "1"}), &clock);
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, ::testing::StartsWith("evpose replay: " + Path("cube/recording.raw") +
                                                ": changed while it was read: its size was "));
  EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  const std::string poses = ReadText("poses.tum");
  EXPECT_GT(result.Json()["poses"], 50);
  EXPECT_EQ(std::count(poses.begin(), poses.end(), '\n'), result.Json()["poses"]);
}

TEST_F(ReplayTest, ServerThatDiesLeavesAnErrorAndThePosesSoFar) {
  SimulateCube(0.1);
  StartServer();
  CliResult result;
  // The recording is followed without end, so that the stream is open until the server ends.
  std::thread replay([&] {
    result = Run(ReplayArguments("poses.tum", {"--server", server_.address, "--follow", "--max-outage", "0"}));
  });
  // The output is buffered: then some poses have been received.
  EXPECT_TRUE(Poll([this] {
    const std::vector<std::string> names = FilesBeginning("poses.tum.partial");
    return !names.empty() && std::filesystem::file_size(Path(names.front())) > 0;
  }));
  server_.server->Shutdown(absl::ZeroDuration());
  replay.join();
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr(server_.address + ": the stream broke: "));
  const std::string poses = ReadText("poses.tum");
  const auto count = std::count(poses.begin(), poses.end(), '\n');
  EXPECT_GT(count, 10);
  const std::string last = poses.substr(poses.rfind('\n', poses.size() - 2) + 1);
  EXPECT_THAT(result.err, HasSubstr("; " + Path("poses.tum") + ": " + std::to_string(count) + " poses up to " +
                                    last.substr(0, last.find(' ')) + " s\n"));
  EXPECT_THAT(result.err, HasSubstr(" bytes sent, " + std::to_string(count) + " poses received); trace_id="));
  EXPECT_THAT(FilesBeginning("poses"), ElementsAre("poses.tum"));
}

TEST_F(ReplayTest, SessionThatIsKeptCanBeWatchedListedAndDeleted) {
  SimulateCube(0.05);
  StartServer();
  const CliResult replay = Run(ReplayArguments("poses.tum", {"--server", server_.address, "--keep-session"}));
  ASSERT_EQ(replay.status, 0) << replay.err;
  const std::string session = replay.Json()["session"];
  const CliResult watch = Run({"watch", session, "--server", server_.address});
  ASSERT_EQ(watch.status, 0) << watch.err;
  EXPECT_EQ(watch.out, ReadText("poses.tum"));
  ASSERT_EQ(Run(ReplayArguments("poses.jsonl")).status, 0);
  EXPECT_EQ(Run({"watch", session, "--server", server_.address, "--json"}).out, ReadText("poses.jsonl"));
  // One pose per 20 ms of sensor time, in a recording of 50 ms.
  const std::string slow = Run({"watch", session, "--server", server_.address, "--max-rate-hz", "50"}).out;
  EXPECT_GE(std::count(slow.begin(), slow.end(), '\n'), 2);
  EXPECT_LE(std::count(slow.begin(), slow.end(), '\n'), 3);
  EXPECT_EQ(Run({"watch", session, "--server", server_.address, "--max-rate-hz", "0"}).status, 2);
  const nlohmann::json last = Run({"watch", session, "--server", server_.address, "--health", "--json"}).Json();
  EXPECT_EQ(last["poses"], replay.Json()["poses"]);
  EXPECT_EQ(last["objects"][0]["state"], "TRACKING");
  EXPECT_THAT(Run({"watch", session, "--server", server_.address, "--health", "--period", "0.5"}).out,
              HasSubstr("object TRACKING, 0 losses"));
  for (const std::vector<std::string>& wrong : std::vector<std::vector<std::string>>{
           {"--period", "0.5"}, {"--health", "--period", "0.001"}, {"--health", "--max-rate-hz", "5"}}) {
    std::vector<std::string> arguments = {"watch", session, "--server", server_.address};
    arguments.insert(arguments.end(), wrong.begin(), wrong.end());
    EXPECT_EQ(Run(arguments).status, 2) << ::testing::PrintToString(wrong);
  }
  EXPECT_THAT(Run({"sessions", "list", "--server", server_.address}).out, HasSubstr(session + "  ENDED"));
  const nlohmann::json health = Run({"sessions", "get", session, "--server", server_.address, "--json"}).Json();
  EXPECT_EQ(health["poses"], replay.Json()["poses"]);
  // The model is in use as long as the session exists.
  const std::string model = Run({"models", "list", "--server", server_.address, "--json"}).Json()[0]["name"];
  EXPECT_EQ(Run({"models", "delete", model, "--server", server_.address}).status, 1);
  EXPECT_EQ(Run({"sessions", "delete", session, "--server", server_.address}).status, 0);
  EXPECT_EQ(Run({"sessions", "get", session, "--server", server_.address}).status, 1);
  EXPECT_EQ(Run({"watch", session, "--server", server_.address}).status, 1);
  EXPECT_EQ(Run({"watch", session, "--server", server_.address, "--health"}).status, 1);
  EXPECT_EQ(Run({"models", "delete", model, "--server", server_.address}).status, 0);
  EXPECT_EQ(Run({"models", "list", "--server", server_.address}).out, "");
}

// The lines of poses up to a time in microseconds, the header included.
std::string LinesUpTo(const std::string& csv, int64_t t_us) {
  std::string lines;
  std::istringstream stream(csv);
  for (std::string line; std::getline(stream, line);) {
    const std::string time = line.substr(line.find(",object,") + 8);
    if (!lines.empty() && std::stoll(time) > t_us) break;
    lines += line + "\n";
  }
  return lines;
}

TEST_F(ReplayTest, APoseIsResetAtATimeOfTheSensor) {
  SimulateCube(0.1);
  StartServer();
  ASSERT_EQ(Run(ReplayArguments("plain.csv")).status, 0);
  const std::string plain = ReadText("plain.csv");
  // A pose in which the object is out of view: nothing is tracked from there on, or only after a search.
  const std::vector<std::string> reset = {"--reset-pose", "16050000 0.5 0.5 1 0 0 0 1"};
  const CliResult result = Run(ReplayArguments("reset.csv", reset));
  ASSERT_EQ(result.status, 0) << result.err;
  const std::string poses = ReadText("reset.csv");
  EXPECT_NE(poses, plain);
  EXPECT_GT(LinesUpTo(plain, 16'045'000).size(), plain.size() / 4);
  EXPECT_EQ(LinesUpTo(poses, 16'045'000), LinesUpTo(plain, 16'045'000));
  EXPECT_NE(LinesUpTo(poses, 16'070'000), LinesUpTo(plain, 16'070'000));
  std::vector<std::string> with_server = reset;
  with_server.insert(with_server.end(), {"--server", server_.address});
  ASSERT_EQ(Run(ReplayArguments("again.csv", with_server)).status, 0);
  EXPECT_EQ(ReadText("again.csv"), poses);
}

TEST_F(ReplayTest, ResetsThatCannotBeAppliedAreNamed) {
  SimulateCube(0.01);
  const auto run = [&](const std::string& reset, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = ReplayArguments("poses.csv", {"--reset-pose", reset});
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  };
  for (const auto& [reset, text] : std::vector<std::pair<std::string, std::string>>{
           {"0 0 1 0 0 0 1", "--reset-pose: "},
           {"soon 0 0 1 0 0 0 1", "does not begin with a sensor time in microseconds"},
           {"5 0 0 1 0 0 0 2", "--reset-pose: "}}) {
    const CliResult result = run(reset);
    EXPECT_EQ(result.status, 2) << reset;
    EXPECT_THAT(result.err, HasSubstr(text));
  }
  const CliResult late = run("99000000 0 0 1 0 0 0 1");
  EXPECT_EQ(late.status, 1);
  EXPECT_THAT(late.err, HasSubstr("--reset-pose at 99000000 us was not applied: the events end before it"));
  const CliResult unknown = Run({"replay", Path("cube/recording.raw"), "--object", "a=" + Path("cube/model.obj"),
                                 "--camera", Path("cube/camera.yaml"), "--reset-pose", "0 b=0 0 1 0 0 0 1"});
  EXPECT_EQ(unknown.status, 2);
  EXPECT_THAT(unknown.err, HasSubstr("--reset-pose: no --object b"));
  const CliResult pipe = Run({"stream", "-", "--model", Path("cube/model.obj"), "--camera", Path("cube/camera.yaml"),
                              "--server", "127.0.0.1:1", "--resume", Path("state"), "--reset-pose", "0 0 0 1 0 0 0 1"});
  EXPECT_EQ(pipe.status, 2);
  EXPECT_THAT(pipe.err, HasSubstr("is not possible with --resume on standard input"));
}

TEST_F(ReplayTest, ModelsAreNamedByTheirContent) {
  SimulateCube(0.002);
  StartServer();
  const auto upload = [&](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"models",   "upload",        Path("cube/model.obj"),
                                          "--server", server_.address, "--json"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  };
  const CliResult first = upload({});
  ASSERT_EQ(first.status, 0) << first.err;
  EXPECT_EQ(first.Json()["lines"], 12);
  EXPECT_EQ(first.Json()["symmetries"], 24);
  EXPECT_THAT(Run({"models", "list", "--server", server_.address}).out,
              ::testing::MatchesRegex(
                  "models/[0-9a-f]+  12 lines  0 curves  12 faces  24 symmetries  diameter [0-9.]+ m  model.obj\n"));
  EXPECT_EQ(first.Json()["file_name"], "model.obj");
  EXPECT_EQ(upload({}).Json()["name"], first.Json()["name"]);
  const CliResult scaled = upload({"--scale", "0.001"});
  EXPECT_NE(scaled.Json()["name"], first.Json()["name"]);
  EXPECT_NEAR(scaled.Json()["diameter_m"], first.Json()["diameter_m"].get<double>() * 0.001, 1e-9);
  EXPECT_EQ(Run({"models", "get", first.Json()["name"], "--server", server_.address, "--json"}).Json(), first.Json());
  const CliResult as_is = upload({"--surface", "as-is", "--crease-angle", "20"});
  EXPECT_EQ(as_is.Json()["surface"], "as-is");
  EXPECT_EQ(as_is.Json()["crease_angle_deg"], 20.0);
  EXPECT_NE(as_is.Json()["name"], first.Json()["name"]);
}

}  // namespace
}  // namespace evpose
