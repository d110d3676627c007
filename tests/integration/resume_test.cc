// SPDX-License-Identifier: Apache-2.0

// Tests sessions with network failures and killed clients: the poses are identical to those of an undisturbed replay.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "server/rpc/server.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/cutting_proxy.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// A running evpose; its standard input is `in`, its outputs are files.
class Program {
 public:
  Program(std::vector<std::string> arguments, int in, const std::string& out_path, const std::string& err_path) {
    arguments.insert(arguments.begin(), EVPOSE_PROGRAM);
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, in, STDIN_FILENO);
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, out_path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, err_path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    EXPECT_EQ(posix_spawn(&pid_, EVPOSE_PROGRAM, &actions, nullptr, argv.data(), environ), 0);
    posix_spawn_file_actions_destroy(&actions);
  }
  ~Program() {
    if (pid_ == 0) return;
    Signal(SIGKILL);
    Wait();
  }

  void Signal(int number) const {
    if (pid_ > 0) kill(pid_, number);  // pid 0 would signal this process and its group
  }
  bool IsRunning() {
    if (pid_ != 0 && waitpid(pid_, &status_, WNOHANG) == pid_) pid_ = 0;
    return pid_ != 0;
  }
  // Waits for the end. Returns the exit status, or minus the number of the signal that ended the process.
  int Wait() {
    if (pid_ != 0) waitpid(pid_, &status_, 0);
    pid_ = 0;
    return WIFEXITED(status_) ? WEXITSTATUS(status_) : -WTERMSIG(status_);
  }

 private:
  pid_t pid_ = 0;
  int status_ = 0;
};

class ResumeTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    StartServer();
  }
  void StartServer() {
    server_.reset();
    auto server = server::Server::Start({});
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
    address_ = "127.0.0.1:" + std::to_string(server_->port());
    proxy_.SetTarget(server_->port());
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

  Program Start(const std::vector<std::string>& arguments, int in) const {
    return Program(arguments, in, Path("program.out"), Path("program.err"));
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

  std::unique_ptr<server::Server> server_;
  std::string address_;
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
  // From the connection preface of HTTP/2, through the upload of the model, until after the creation of the session.
  for (uint64_t limit = 50; limit < 12'000; limit += 150 + limit / 2) {
    const int before = proxy_.num_cut();
    proxy_.CutAfter({limit, limit, limit + 1'000});
    const CliResult result = Run(ReplayArguments("cut.csv", {"--server", proxy_.address()}));
    ASSERT_EQ(result.status, 0) << limit << ": " << result.err;
    EXPECT_TRUE(ReadText("cut.csv") == expected) << limit;
    EXPECT_EQ(proxy_.num_cut() - before, 3) << limit;
    const CliResult sessions = Run({"sessions", "list", "--server", address_, "--json"});
    EXPECT_TRUE(sessions.Json().empty()) << limit << ": " << sessions.out;
  }
}

TEST_F(ResumeTest, AServerThatIsReplacedBeforeTheSessionExistsGetsTheModelAgain) {
  SimulateCube(0.1);
  const std::string expected = Undisturbed();
  proxy_.CutAfter({3'000});
  CliResult result;
  std::thread replay([&] { result = Run(ReplayArguments("poses.csv", {"--server", proxy_.address()})); });
  while (proxy_.num_cut() == 0) std::this_thread::yield();
  StartServer();
  replay.join();
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_TRUE(ReadText("poses.csv") == expected);
}

TEST_F(ResumeTest, ClientKilledAtRandomMoments) {
  SimulateCube(0.3);
  const std::string expected = Undisturbed();
  const std::vector<std::string> arguments =
      ReplayArguments("poses.csv", {"--server", address_, "--resume", Path("state"), "--rate", "1"});
  const int null = open("/dev/null", O_RDONLY | O_CLOEXEC);
  constexpr int kKills = 20;
  int num_killed = 0;
  for (int round = 0; round < 3 * kKills && num_killed < kKills; ++round) {
    for (int life = 0; life < 3 && num_killed < kKills; ++life) {
      const uint64_t wanted = SizeOf("poses.csv.partial") + random_() % (expected.size() / 2);
      Program program = Start(arguments, null);
      while (program.IsRunning() && SizeOf("poses.csv.partial") < wanted) std::this_thread::yield();
      program.Signal(SIGKILL);
      const int status = program.Wait();
      ASSERT_TRUE(status == -SIGKILL || status == 0) << ReadText("program.err");
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
  close(null);
  EXPECT_EQ(num_killed, kKills);
}

TEST_F(ResumeTest, AnInterruptedReplayIsContinuedByTheSameCommand) {
  SimulateCube(0.3);
  const std::string expected = Undisturbed();
  const std::vector<std::string> arguments =
      ReplayArguments("poses.csv", {"--server", address_, "--resume", Path("state"), "--rate", "0.1"});
  const int null = open("/dev/null", O_RDONLY | O_CLOEXEC);
  Program program = Start(arguments, null);
  while (program.IsRunning() && SizeOf("poses.csv.partial") < 10'000) std::this_thread::yield();
  program.Signal(SIGINT);
  EXPECT_EQ(program.Wait(), 1);
  close(null);
  EXPECT_THAT(ReadText("program.err"), HasSubstr("recording.raw: interrupted before its end (after "));
  EXPECT_THAT(ReadText("program.err"), HasSubstr("; the same command continues from there\n"));
  EXPECT_FALSE(std::filesystem::exists(Path("poses.csv")));
  EXPECT_EQ(Run({"sessions", "list", "--server", address_, "--json"}).Json().size(), 1u);
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
  Program program =
      Start(StreamArguments("poses.csv", {"--server", proxy_.address(), "--connect-timeout", "600"}), pipe.ends[0]);
  // The client accepts the data although there is no server; it is more than a pipe holds.
  ASSERT_TRUE(pipe.Write(ReadText("cube/recording.raw")));
  pipe.CloseWriter();
  while (program.IsRunning() && proxy_.num_refused() < 2) std::this_thread::yield();
  proxy_.SetTarget(server_->port());
  ASSERT_EQ(program.Wait(), 0) << ReadText("program.err");
  EXPECT_TRUE(ReadText("poses.csv") == expected);
}

TEST_F(ResumeTest, StreamSpoolsEventsBeyondTheMemory) {
  SimulateCube(0.5);
  const std::string expected = Undisturbed();
  proxy_.SetTarget(0);
  ASSERT_GT(std::filesystem::file_size(Path("cube/recording.raw")), uint64_t{1} << 20);
  std::filesystem::create_directory(Path("spool"));
  Pipe pipe;
  Program program = Start(StreamArguments("poses.csv", {"--server", proxy_.address(), "--memory-bytes", "1048576",
                                                        "--spool", Path("spool"), "--connect-timeout", "600"}),
                          pipe.ends[0]);
  ASSERT_TRUE(pipe.Write(ReadText("cube/recording.raw")));
  pipe.CloseWriter();
  while (program.IsRunning() && proxy_.num_refused() < 2) std::this_thread::yield();
  proxy_.SetTarget(server_->port());
  ASSERT_EQ(program.Wait(), 0) << ReadText("program.err");
  EXPECT_TRUE(ReadText("poses.csv") == expected);
  EXPECT_TRUE(std::filesystem::is_empty(Path("spool")));
}

TEST_F(ResumeTest, StreamEndsCleanlyOnASignal) {
  SimulateCube(0.2);
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) {
    Pipe pipe;
    Program program = Start(StreamArguments("poses.csv", {"--server", address_}), pipe.ends[0]);
    ASSERT_TRUE(pipe.Write(ReadText("cube/recording.raw")));
    while (program.IsRunning() && SizeOf("program.out") == 0 && SizeOf("poses.csv") == 0) {
      // The stream has delivered some poses. The pipe stays open, as that of a camera.
      const CliResult list = Run({"sessions", "list", "--server", address_, "--json"});
      if (!list.Json().empty() && list.Json()[0]["poses"] > 10) break;
    }
    program.Signal(number);
    if (number == SIGHUP) program.Signal(number);  // as from a terminal that is closed
    ASSERT_EQ(program.Wait(), 0) << ReadText("program.err");
    const nlohmann::json report = nlohmann::json::parse(ReadText("program.out"));
    EXPECT_EQ(report["interrupted"], true);
    EXPECT_GT(report["poses"], 10);
    const std::string poses = ReadText("poses.csv");
    EXPECT_EQ(std::count(poses.begin(), poses.end(), '\n'), report["poses"].get<int>() + 1);
    EXPECT_EQ(Run({"sessions", "list", "--server", address_}).out, "");
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
    proxy_.SetTarget(server_is_there ? server_->port() : 0);
    {
      Pipe pipe;
      Program program = Start(arguments, pipe.ends[0]);
      ASSERT_TRUE(pipe.Write(recording.substr(0, half)));
      // The last chunk is still incomplete.
      while (program.IsRunning() && SizeOfSpool() + kLastChunk < half) std::this_thread::yield();
      while (program.IsRunning() && server_is_there && SizeOf("poses.csv.partial") < 10'000) std::this_thread::yield();
      program.Signal(SIGKILL);
      ASSERT_EQ(program.Wait(), -SIGKILL) << ReadText("program.err");
    }
    proxy_.SetTarget(server_->port());
    Pipe pipe;
    Program program = Start(arguments, pipe.ends[0]);
    ASSERT_TRUE(pipe.Write(header + recording.substr(half)));
    pipe.CloseWriter();
    ASSERT_EQ(program.Wait(), 0) << ReadText("program.err");
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
  std::vector<std::string> arguments = ReplayArguments("poses.csv", {"--server", address_});
  arguments[0] = std::string("stream");
  const int null = open("/dev/null", O_RDONLY | O_CLOEXEC);
  Program program = Start(arguments, null);
  const uint64_t num_events = Run({"info", Path("cube/recording.raw"), "--json"}).Json()["cd_events"];
  uint64_t processed = 0;
  while (program.IsRunning() && processed < num_events / 10 * 9) {
    const nlohmann::json list = Run({"sessions", "list", "--server", address_, "--json"}).Json();
    if (!list.empty()) processed = list[0]["events"];
  }
  program.Signal(SIGTERM);  // the program waits for the file to grow
  ASSERT_EQ(program.Wait(), 0) << ReadText("program.err");
  const size_t begin = expected.size() / 5 * 4;
  EXPECT_EQ(ReadText("poses.csv").substr(0, begin), expected.substr(0, begin));
  close(null);
}

class ResumeBadInputTest : public ResumeTest {
 protected:
  // A killed replay leaves a resume file.
  void KillOne() {
    SimulateCube(0.3);
    const int null = open("/dev/null", O_RDONLY | O_CLOEXEC);
    Program program = Start(Arguments(), null);
    while (program.IsRunning() && SizeOf("poses.csv.partial") < 10'000) std::this_thread::yield();
    program.Signal(SIGKILL);
    ASSERT_EQ(program.Wait(), -SIGKILL) << ReadText("program.err");
    close(null);
  }
  std::vector<std::string> Arguments() const {
    return ReplayArguments("poses.csv", {"--server", address_, "--resume", Path("state"), "--rate", "0.2"});
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
  std::vector<std::string> arguments = ReplayArguments("a.csv", {"--server", address_, "--resume", Path("state")});
  arguments[1] = std::string("-");
  EXPECT_EQ(Run(arguments).status, 2);
  EXPECT_EQ(Run(StreamArguments("a.csv", {})).status, 2);
  EXPECT_EQ(Run(StreamArguments("a.csv", {"--server", address_, "--max-lag", "1"})).status, 2);
  EXPECT_EQ(Run(StreamArguments("a.csv", {"--server", address_, "--overload", "never"})).status, 2);
}

TEST_F(ResumeBadInputTest, SpoolThatCannotBeWritten) {
  SimulateCube(0.01);
  const auto stream = [this](const std::string& spool) {
    Pipe pipe;
    EXPECT_TRUE(pipe.Write(ReadText("cube/recording.raw").substr(0, 4'000)));
    pipe.CloseWriter();
    Program program = Start(StreamArguments("poses.csv", {"--server", address_, "--spool", spool}), pipe.ends[0]);
    EXPECT_EQ(program.Wait(), 1);
    return ReadText("program.err");
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
