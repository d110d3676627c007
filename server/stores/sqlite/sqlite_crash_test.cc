// SPDX-License-Identifier: Apache-2.0

// Kills the process at random moments and checks that every acknowledged commit is stored and that no commit is stored
// in part.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <random>
#include <thread>

#include "server/stores/sqlite/sqlite_store.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {
namespace {

constexpr size_t kSessions = 4;
constexpr int kDeaths = 50;

std::string Name(size_t session) { return "sessions/" + std::to_string(session); }

// The n-th commit of a session. The size of the checkpoint varies with n.
SessionCommit MakeCommit(size_t session, uint64_t n) {
  return {.checkpoint = Noise(1000 * (n * 37 % 100), n),
          .lifecycle = std::to_string(n),
          .poses = {Segment(Name(session), n, n)},
          .first_pose_seq_kept = n > 20 ? n - 20 : 1};
}

struct Acknowledged {
  size_t session;
  uint64_t commit;
};

// Commits until the process is killed, and writes each acknowledged commit to the pipe.
[[noreturn]] void CommitForever(const std::string& data_dir, int acknowledged) {
  const std::unique_ptr<Store> store = OpenSqliteStore({.data_dir = data_dir}).value();
  std::vector<std::thread> threads;
  for (size_t session = 0; session < kSessions; ++session) {
    threads.emplace_back([&store, acknowledged, session] {
      Store::AcquiredSession acquired = store->AcquireSession(Name(session)).value();
      const std::string& last = acquired.session.lifecycle;
      for (uint64_t n = std::stoull(last) + 1; CommitNow(*acquired.lease, MakeCommit(session, n)).ok(); ++n) {
        const Acknowledged acknowledgement = {.session = session, .commit = n};
        if (write(acknowledged, &acknowledgement, sizeof(acknowledgement)) != sizeof(acknowledgement)) break;
      }
      _exit(1);
    });
  }
  for (std::thread& thread : threads) thread.join();
  _exit(1);
}

TEST(SqliteCrashTest, AcknowledgedCommitsSurviveFiftyKills) {
  const TemporaryDirectory directory;
  const std::string data_dir = directory.path() + "/data";
  {
    const std::unique_ptr<Store> store = OpenSqliteStore({.data_dir = data_dir}).value();
    for (size_t i = 0; i < kSessions; ++i) ASSERT_TRUE(store->CreateSession(Record(Name(i)), "0").ok());
  }
  std::array<uint64_t, kSessions> last_acknowledged = {};
  std::mt19937_64 random(1);
  for (int death = 0; death < kDeaths; ++death) {
    int pipe_ends[2];
    ASSERT_EQ(pipe(pipe_ends), 0);
    const pid_t child = fork();
    if (child == 0) CommitForever(data_dir, pipe_ends[1]);
    close(pipe_ends[1]);
    Acknowledged acknowledgement = {};
    const uint64_t num_before_kill = 1 + random() % 40;
    uint64_t count = 0;
    while (read(pipe_ends[0], &acknowledgement, sizeof(acknowledgement)) == sizeof(acknowledgement)) {
      last_acknowledged[acknowledgement.session] = acknowledgement.commit;
      if (++count == num_before_kill) kill(child, SIGKILL);
    }
    close(pipe_ends[0]);
    int status = 0;
    waitpid(child, &status, 0);
    ASSERT_TRUE(WIFSIGNALED(status)) << "the child process failed before it was killed";

    const std::unique_ptr<Store> store = OpenSqliteStore({.data_dir = data_dir}).value();
    ASSERT_TRUE(store->damage().empty()) << store->damage()[0];
    for (size_t i = 0; i < kSessions; ++i) {
      const StoredSession session = store->ReadSession(Name(i)).value();
      const uint64_t n = std::stoull(session.lifecycle);
      EXPECT_GE(n, last_acknowledged[i]);
      EXPECT_LE(n, last_acknowledged[i] + 1) << "only one commit was in progress";
      last_acknowledged[i] = n;
      if (n == 0) continue;
      EXPECT_TRUE(session.checkpoint == MakeCommit(i, n).checkpoint);
      ASSERT_FALSE(session.poses.empty());
      EXPECT_EQ(session.poses.back().bytes, Segment(Name(i), n, n).bytes);
      EXPECT_EQ(session.poses.size(), std::min<uint64_t>(n, 21));
    }
  }
}

}  // namespace
}  // namespace evpose::server
