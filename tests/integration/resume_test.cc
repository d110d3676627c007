// SPDX-License-Identifier: Apache-2.0

// Tests sessions with network failures and killed clients: the poses are identical to those of an undisturbed replay.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <functional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "core/base/poll_testing.h"
#include "core/base/process_testing.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/cutting_proxy.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class ResumeTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    StartServer();
  }
  void StartServer() {
    server_ = {};
    server_ = StartLocalServer();
    proxy_.SetTarget(server_.server->port());
  }

  // The poses of an undisturbed replay.
  std::string Undisturbed() {
    const CliResult result = Run(ReplayArguments("undisturbed.csv"));
    EXPECT_EQ(result.status, 0) << result.err;
    return ReadText("undisturbed.csv");
  }

  // The same arguments for stream, from standard input.
  std::vector<std::string> StreamArguments(const std::string& out, const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = ReplayArguments(out, more);
    arguments[0] = std::string("stream");
    arguments[1] = std::string("-");
    return arguments;
  }

  // Starts evpose, with /dev/null or a pipe as its standard input.
  TestProcess Start(std::vector<std::string> arguments, int in = -1) const {
    arguments.insert(arguments.begin(), EVPOSE_PROGRAM);
    return TestProcess(std::move(arguments), {.in = in, .out = Path("program.out")});
  }
  // Waits until `condition` holds or the program has ended.
  static void Await(TestProcess& program, const std::function<bool()>& condition) {
    EXPECT_TRUE(Poll([&] { return !program.IsRunning() || condition(); }));
  }
  void AwaitSize(TestProcess& program, const std::string& file, uint64_t size) const {
    Await(program, [&] { return SizeOf(file) >= size; });
  }

  uint64_t SizeOf(const std::string& name) const {
    struct stat info;
    return stat(Path(name).c_str(), &info) == 0 ? static_cast<uint64_t>(info.st_size) : 0;
  }

  uint64_t SizeOfSpool() const {
    uint64_t bytes = 0;
    std::error_code error;
    for (const auto& entry : std::filesystem::directory_iterator(Path("state.spool"), error))
      bytes += entry.file_size();
    return bytes;
  }

  static void ExpectEachPoseOnce(const std::string& csv) {
    uint64_t expected_seq = 1;
    for (size_t begin = csv.find('\n') + 1; begin < csv.size(); begin = csv.find('\n', begin) + 1, ++expected_seq) {
      ASSERT_EQ(std::stoull(csv.substr(begin)), expected_seq);
    }
    EXPECT_GT(expected_seq, 1u);
  }

  // The writing end of a pipe; a program has the reading end.
  struct Pipe {
    Pipe() { EXPECT_EQ(pipe2(ends, O_CLOEXEC), 0); }
    ~Pipe() {
      for (const int end : ends) {
        if (end >= 0) close(end);
      }
    }
    void CloseWriter() { close(std::exchange(ends[1], -1)); }
    bool Write(const std::string& bytes) const {
      for (size_t done = 0; done < bytes.size();) {
        const ssize_t size = write(ends[1], bytes.data() + done, bytes.size() - done);
        if (size <= 0) return false;
        done += static_cast<size_t>(size);
      }
      return true;
    }
    int ends[2] = {-1, -1};
  };

  LocalServer server_;
  CuttingProxy proxy_;
  std::mt19937 random_{42};
};

TEST_F(ResumeTest, ConnectionCutAtRandomPlaces) {
  SimulateCube(0.3);
  const std::string expected = Undisturbed();
  const uint64_t size = std::filesystem::file_size(Path("cube/recording.raw"));
  constexpr int kCuts = 50;
  // Some of the planned cuts are beyond the end of the stream.
  for (int num_cuts = 3; proxy_.num_cut() < kCuts;
       num_cuts = std::clamp(2 * (kCuts - proxy_.num_cut()), 3, kCuts / 2)) {
    std::vector<uint64_t> limits = {30'000};  // the first cut is in the stream; another test covers earlier ones
    const uint64_t mean = size / static_cast<uint64_t>(num_cuts);
    while (limits.size() < static_cast<size_t>(num_cuts)) limits.push_back(2'000 + random_() % (2 * mean));
    proxy_.CutAfter(limits);
    const int before = proxy_.num_cut();
    const CliResult result = Run(ReplayArguments("cut.csv", {"--server", proxy_.address()}));
    ASSERT_EQ(result.status, 0) << result.err;
    EXPECT_TRUE(ReadText("cut.csv") == expected);
    const nlohmann::json report = result.Json();
    ASSERT_GE(proxy_.num_cut() - before, num_cuts / 3);
    // A cut after the summary is not an outage.
    EXPECT_LE(report["outages"], proxy_.num_cut() - before);
    EXPECT_GE(report["outages"], proxy_.num_cut() - before - 1);
    EXPECT_EQ(report["lost_poses"], 0);
    EXPECT_THAT(result.err, AllOf(HasSubstr("no connection for "), HasSubstr("connected again after")));
  }
}

TEST_F(ResumeTest, AReplayRestartsWhenTheConnectionBreaksBeforeItsSessionExists) {
  SimulateCube(0.1);
  const std::string expected = Undisturbed();
  // The connection is cut at places from the connection preface of HTTP/2, through the upload of the model, until after
  // the creation of the session.
  for (uint64_t limit = 50; limit < 12'000; limit += 150 + limit / 2) {
    const int before = proxy_.num_cut();
    proxy_.CutAfter({limit, limit, limit + 1'000});
    const CliResult result = Run(ReplayArguments("cut.csv", {"--server", proxy_.address()}));
    ASSERT_EQ(result.status, 0) << limit << ": " << result.err;
    EXPECT_TRUE(ReadText("cut.csv") == expected) << limit;
    EXPECT_EQ(proxy_.num_cut() - before, 3) << limit;
    const CliResult sessions = Run({"sessions", "list", "--server", server_.address, "--json"});
    EXPECT_TRUE(sessions.Json().empty()) << limit << ": " << sessions.out;
  }
}

TEST_F(ResumeTest, AServerThatIsReplacedBeforeTheSessionExistsGetsTheModelAgain) {
  SimulateCube(0.1);
  const std::string expected = Undisturbed();
  proxy_.CutAfter({3'000});
  CliResult result;
  std::thread replay([&] { result = Run(ReplayArguments("poses.csv", {"--server", proxy_.address()})); });
  EXPECT_TRUE(Poll([this] { return proxy_.num_cut() > 0; }));
  StartServer();
  replay.join();
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_TRUE(ReadText("poses.csv") == expected);
}

TEST_F(ResumeTest, ClientKilledAtRandomMoments) {
  SimulateCube(0.3);
  const std::string expected = Undisturbed();
  const std::vector<std::string> arguments =
      ReplayArguments("poses.csv", {"--server", server_.address, "--resume", Path("state"), "--rate", "1"});
  constexpr int kKills = 20;
  int num_killed = 0;
  for (int round = 0; round < 3 * kKills && num_killed < kKills; ++round) {
    for (int life = 0; life < 3 && num_killed < kKills; ++life) {
      const uint64_t wanted = SizeOf("poses.csv.partial") + random_() % (expected.size() / 2);
      TestProcess program = Start(arguments);
      AwaitSize(program, "poses.csv.partial", wanted);
      program.Signal(SIGKILL);
      const int status = program.Wait();
      ASSERT_TRUE(status == -SIGKILL || status == 0) << program.Stderr();
      num_killed += status == -SIGKILL;
      if (status == 0) break;
    }
    if (!std::filesystem::exists(Path("poses.csv"))) {
      const CliResult result = Run(arguments);
      ASSERT_EQ(result.status, 0) << result.err;
      EXPECT_EQ(result.Json()["lost_poses"], 0);
    }
    EXPECT_TRUE(ReadText("poses.csv") == expected);
    EXPECT_THAT(FilesBeginning("poses.csv."), IsEmpty());
    EXPECT_THAT(FilesBeginning("state"), IsEmpty());
    std::filesystem::remove(Path("poses.csv"));
  }
  EXPECT_EQ(num_killed, kKills);
}

TEST_F(ResumeTest, AnInterruptedReplayIsContinuedByTheSameCommand) {
  SimulateCube(0.3);
  const std::string expected = Undisturbed();
  const std::vector<std::string> arguments =
      ReplayArguments("poses.csv", {"--server", server_.address, "--resume", Path("state"), "--rate", "0.1"});
  TestProcess program = Start(arguments);
  AwaitSize(program, "poses.csv.partial", 10'000);
  program.Signal(SIGINT);
  EXPECT_EQ(program.Wait(), 1);
  EXPECT_THAT(program.Stderr(), HasSubstr("recording.raw: interrupted before its end (after "));
  EXPECT_THAT(program.Stderr(), HasSubstr("; the same command continues from there\n"));
  EXPECT_FALSE(std::filesystem::exists(Path("poses.csv")));
  EXPECT_EQ(Run({"sessions", "list", "--server", server_.address, "--json"}).Json().size(), 1u);
  const CliResult result = Run(arguments);
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_TRUE(ReadText("poses.csv") == expected);
  EXPECT_THAT(FilesBeginning("poses.csv."), IsEmpty());
  EXPECT_THAT(FilesBeginning("state"), IsEmpty());
}

TEST_F(ResumeTest, StreamFromAPipeBeforeTheServerStarts) {
  SimulateCube(0.2);
  const std::string expected = Undisturbed();
  proxy_.SetTarget(0);
  Pipe pipe;
  TestProcess program =
      Start(StreamArguments("poses.csv", {"--server", proxy_.address(), "--connect-timeout", "600"}), pipe.ends[0]);
  // The client accepts the data although there is no server; it is more than a pipe holds.
  ASSERT_TRUE(pipe.Write(ReadText("cube/recording.raw")));
  pipe.CloseWriter();
  Await(program, [this] { return proxy_.num_refused() >= 2; });
  proxy_.SetTarget(server_.server->port());
  ASSERT_EQ(program.Wait(), 0) << program.Stderr();
  EXPECT_TRUE(ReadText("poses.csv") == expected);
}

TEST_F(ResumeTest, StreamSpoolsEventsBeyondTheMemory) {
  SimulateCube(0.5);
  const std::string expected = Undisturbed();
  proxy_.SetTarget(0);
  ASSERT_GT(std::filesystem::file_size(Path("cube/recording.raw")), uint64_t{1} << 20);
  std::filesystem::create_directory(Path("spool"));
  Pipe pipe;
  TestProcess program = Start(StreamArguments("poses.csv", {"--server", proxy_.address(), "--memory-bytes", "1048576",
                                                            "--spool", Path("spool"), "--connect-timeout", "600"}),
                              pipe.ends[0]);
  ASSERT_TRUE(pipe.Write(ReadText("cube/recording.raw")));
  pipe.CloseWriter();
  Await(program, [this] { return proxy_.num_refused() >= 2; });
  proxy_.SetTarget(server_.server->port());
  ASSERT_EQ(program.Wait(), 0) << program.Stderr();
  EXPECT_TRUE(ReadText("poses.csv") == expected);
  EXPECT_TRUE(std::filesystem::is_empty(Path("spool")));
}

TEST_F(ResumeTest, StreamEndsCleanlyOnASignal) {
  SimulateCube(0.2);
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) {
    Pipe pipe;
    TestProcess program = Start(StreamArguments("poses.csv", {"--server", server_.address}), pipe.ends[0]);
    ASSERT_TRUE(pipe.Write(ReadText("cube/recording.raw")));
    // The stream has delivered some poses. The pipe stays open, as that of a camera.
    Await(program, [this] {
      const nlohmann::json list = Run({"sessions", "list", "--server", server_.address, "--json"}).Json();
      return SizeOf("program.out") > 0 || SizeOf("poses.csv") > 0 || (!list.empty() && list[0]["poses"] > 10);
    });
    program.Signal(number);
    if (number == SIGHUP) program.Signal(number);  // as from a terminal that is closed
    ASSERT_EQ(program.Wait(), 0) << program.Stderr();
    const nlohmann::json report = nlohmann::json::parse(ReadText("program.out"));
    EXPECT_EQ(report["interrupted"], true);
    EXPECT_GT(report["poses"], 10);
    const std::string poses = ReadText("poses.csv");
    EXPECT_EQ(std::count(poses.begin(), poses.end(), '\n'), report["poses"].get<int>() + 1);
    EXPECT_EQ(Run({"sessions", "list", "--server", server_.address}).out, "");
    std::filesystem::remove(Path("poses.csv"));
    std::filesystem::remove(Path("program.out"));
  }
}

// The data that the client had read are in its spool, with or without a server. Data that a camera sends while no
// client reads are lost, and the server is notified of the gap.
TEST_F(ResumeTest, AKilledStreamSendsTheEventsThatItHadRead) {
  constexpr uint64_t kLastChunk = 8'192;
  SimulateCube(0.3);
  const std::string expected = Undisturbed();
  const std::string recording = ReadText("cube/recording.raw");
  const std::string header = recording.substr(0, recording.find("% end\n") + 6);
  const size_t half = header.size() + (recording.size() - header.size()) / 4 * 2;
  const std::vector<std::string> arguments =
      StreamArguments("poses.csv", {"--server", proxy_.address(), "--resume", Path("state")});
  for (const bool server_is_there : {false, true}) {
    proxy_.SetTarget(server_is_there ? server_.server->port() : 0);
    {
      Pipe pipe;
      TestProcess program = Start(arguments, pipe.ends[0]);
      ASSERT_TRUE(pipe.Write(recording.substr(0, half)));
      // The last chunk is still incomplete.
      Await(program, [&] { return SizeOfSpool() + kLastChunk >= half; });
      if (server_is_there) AwaitSize(program, "poses.csv.partial", 10'000);
      program.Signal(SIGKILL);
      ASSERT_EQ(program.Wait(), -SIGKILL) << program.Stderr();
    }
    proxy_.SetTarget(server_.server->port());
    Pipe pipe;
    TestProcess program = Start(arguments, pipe.ends[0]);
    ASSERT_TRUE(pipe.Write(header + recording.substr(half)));
    pipe.CloseWriter();
    ASSERT_EQ(program.Wait(), 0) << program.Stderr();
    const nlohmann::json report = nlohmann::json::parse(ReadText("program.out"));
    // The spool's size counts the headers of its records, so that a little more than the last chunk may have been
    // outside it.
    EXPECT_GT(report["sent_bytes"].get<uint64_t>() + 2 * kLastChunk, recording.size() - header.size());
    const std::string poses = ReadText("poses.csv");
    const size_t begin = expected.size() / 5 * 2;
    EXPECT_EQ(poses.substr(0, begin), expected.substr(0, begin));
    ExpectEachPoseOnce(poses);
    EXPECT_THAT(FilesBeginning("state"), IsEmpty());
    std::filesystem::remove(Path("poses.csv"));
  }
}

TEST_F(ResumeTest, StreamOfAFileIsThatOfAReplay) {
  SimulateCube(0.1);
  const std::string expected = Undisturbed();
  std::vector<std::string> arguments = ReplayArguments("poses.csv", {"--server", server_.address});
  arguments[0] = std::string("stream");
  TestProcess program = Start(arguments);
  const uint64_t num_events = Run({"info", Path("cube/recording.raw"), "--json"}).Json()["cd_events"];
  Await(program, [&] {
    const nlohmann::json list = Run({"sessions", "list", "--server", server_.address, "--json"}).Json();
    return !list.empty() && list[0]["events"] >= num_events / 10 * 9;
  });
  program.Signal(SIGTERM);  // the program waits for the file to grow
  ASSERT_EQ(program.Wait(), 0) << program.Stderr();
  const size_t begin = expected.size() / 5 * 4;
  EXPECT_EQ(ReadText("poses.csv").substr(0, begin), expected.substr(0, begin));
}

class ResumeBadInputTest : public ResumeTest {
 protected:
  // A killed replay leaves a resume file.
  void KillOne() {
    SimulateCube(0.3);
    TestProcess program = Start(Arguments());
    AwaitSize(program, "poses.csv.partial", 10'000);
    program.Signal(SIGKILL);
    ASSERT_EQ(program.Wait(), -SIGKILL) << program.Stderr();
  }
  std::vector<std::string> Arguments() const {
    return ReplayArguments("poses.csv", {"--server", server_.address, "--resume", Path("state"), "--rate", "0.2"});
  }
  std::string Error(const std::vector<std::string>& arguments) const {
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 1) << result.out;
    return result.err;
  }
};

TEST_F(ResumeBadInputTest, ResumeFileOfAnotherRun) {
  KillOne();
  const std::string record = ReadText("state");
  const auto expect_error = [&](const std::vector<std::string>& arguments, const std::string& text) {
    EXPECT_THAT(Error(arguments), HasSubstr(text));
    EXPECT_TRUE(std::filesystem::exists(Path("poses.csv.partial")));
    WriteText("state", record);
  };
  std::string damaged = record;
  char& digit = damaged[damaged.find("last_pose_seq") + 16];
  digit = digit == '9' ? '8' : '9';
  WriteText("state", damaged);
  expect_error(Arguments(), Path("state") + ": is damaged");
  std::vector<std::string> other = Arguments();
  other.insert(other.end(), {"--chunk-bytes", "4096"});
  expect_error(other, Path("state") + ": was started with another --chunk-bytes");
  std::filesystem::rename(Path("poses.csv.partial"), Path("moved"));
  EXPECT_THAT(Error(Arguments()), HasSubstr("poses.csv.partial: cannot be written"));
  std::filesystem::rename(Path("moved"), Path("poses.csv.partial"));

  // The file now has other events under the same name.
  std::string recording = ReadText("cube/recording.raw");
  const std::string whole = recording;
  recording[recording.find("% end\n") + 8] ^= 1;  // in the first chunk, whose digest is in the resume file
  WriteText("cube/recording.raw", recording);
  EXPECT_THAT(Error(Arguments()), HasSubstr("differ from those that the session was fed with"));
  WriteText("cube/recording.raw", whole);

  std::vector<std::string> arguments = Arguments();
  arguments.back() = std::string("max");
  const CliResult result = Run(arguments);
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_TRUE(ReadText("poses.csv") == Undisturbed());
}

TEST_F(ResumeBadInputTest, DeletedSession) {
  KillOne();
  StartServer();
  EXPECT_THAT(Error(Arguments()), HasSubstr("the server no longer has the session: remove " + Path("state")));
}

TEST_F(ResumeBadInputTest, WrongUsage) {
  SimulateCube(0.01);
  EXPECT_EQ(Run(ReplayArguments("a.csv", {"--resume", Path("state")})).status, 2);
  std::vector<std::string> arguments =
      ReplayArguments("a.csv", {"--server", server_.address, "--resume", Path("state")});
  arguments[1] = std::string("-");
  EXPECT_EQ(Run(arguments).status, 2);
  EXPECT_EQ(Run(StreamArguments("a.csv", {})).status, 2);
  EXPECT_EQ(Run(StreamArguments("a.csv", {"--server", server_.address, "--max-lag", "1"})).status, 2);
  EXPECT_EQ(Run(StreamArguments("a.csv", {"--server", server_.address, "--overload", "never"})).status, 2);
}

TEST_F(ResumeBadInputTest, SpoolThatCannotBeWritten) {
  SimulateCube(0.01);
  const auto stream = [this](const std::string& spool) {
    Pipe pipe;
    EXPECT_TRUE(pipe.Write(ReadText("cube/recording.raw").substr(0, 4'000)));
    pipe.CloseWriter();
    TestProcess program =
        Start(StreamArguments("poses.csv", {"--server", server_.address, "--spool", spool}), pipe.ends[0]);
    EXPECT_EQ(program.Wait(), 1);
    return program.Stderr();
  };
  EXPECT_THAT(stream(Path("no/such")), HasSubstr(Path("no/such") + ": the spool's directory cannot be made"));
  WriteText("file", "");
  EXPECT_THAT(stream(Path("file")), HasSubstr(Path("file")));
}

TEST_F(ResumeBadInputTest, UnreachableServerBeforeTheSessionExists) {
  SimulateCube(0.1);
  std::vector<uint64_t> limits(10'000, 0);  // more than it tries in that time
  limits.front() = 3'000;
  proxy_.CutAfter(limits);
  const CliResult result = Run(
      ReplayArguments("poses.csv", {"--server", proxy_.address(), "--max-outage", "0.3", "--connect-timeout", "0.2"}));
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr("no connection for "), HasSubstr("no server at " + proxy_.address())));
  EXPECT_THAT(FilesBeginning("poses"), IsEmpty());
}

TEST_F(ResumeBadInputTest, UnreachableServer) {
  SimulateCube(0.1);
  std::vector<uint64_t> limits(10'000, 0);  // more than it tries in that time
  limits.front() = 30'000;
  proxy_.CutAfter(limits);
  const CliResult result = Run(ReplayArguments("poses.csv", {"--server", proxy_.address(), "--max-outage", "0.3"}));
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr(proxy_.address() + ": the stream broke: "), HasSubstr("gave up after")));
  EXPECT_THAT(FilesBeginning("poses.csv."), IsEmpty()) << "poses.csv has the poses that were received";
}

}  // namespace
}  // namespace evpose
