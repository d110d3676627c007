// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_testing.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <pwd.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/poll_testing.h"

namespace evpose::server {
namespace {

constexpr char kPrograms[] = "/usr/lib/postgresql/15/bin/";  // Debian's package adds them to no PATH

// The user that runs PostgreSQL; null: the present one.
// NOLINTNEXTLINE(concurrency-mt-unsafe): only the thread of a test asks for users
const passwd* OtherUser() { return geteuid() == 0 ? getpwnam("nobody") : nullptr; }

void GiveToUser(const std::string& path) {
  const passwd* const user = OtherUser();
  if (user == nullptr) return;
  const auto give = [user](const std::string& place) {
    if (lchown(place.c_str(), user->pw_uid, user->pw_gid) != 0) throw std::runtime_error("lchown of " + place);
  };
  give(path);
  for (const auto& entry : std::filesystem::recursive_directory_iterator(path)) give(entry.path());
}

// Starts a program whose output is written to `log`. Its processes keep a copy of `end` until they end.
pid_t StartProgram(std::vector<std::string> arguments, int log, int end) {
  arguments[0].insert(0, kPrograms);
  std::vector<char*> words;
  for (std::string& argument : arguments) words.push_back(argument.data());
  words.push_back(nullptr);
  const passwd* const user = OtherUser();
  const pid_t process = fork();
  if (process != 0) return process;
  if (user != nullptr && (setgid(user->pw_gid) != 0 || setuid(user->pw_uid) != 0)) _exit(126);
  prctl(PR_SET_PDEATHSIG, SIGQUIT);  // ends all processes of the server
  dup2(log, STDOUT_FILENO);
  dup2(log, STDERR_FILENO);
  dup(end);  // the copy is not closed by execv
  if (chdir("/") != 0) _exit(126);
  execv(words[0], words.data());
  _exit(127);
}

// Runs a program until it ends, or until it has written a line that contains `ready`. Returns what it has written.
// `end` is at the end of the file when all processes of the program have ended.
std::string RunProgram(const std::vector<std::string>& arguments, const std::string& ready, pid_t& process, int& end) {
  int log[2], ends[2];
  if (pipe2(log, O_CLOEXEC) != 0 || pipe2(ends, O_CLOEXEC) != 0) throw std::runtime_error("there is no pipe left");
  process = StartProgram(arguments, log[1], ends[1]);
  close(log[1]);
  close(ends[1]);
  end = ends[0];
  FILE* const lines = fdopen(log[0], "r");
  char line[1024];
  std::string output;
  while (std::fgets(line, sizeof(line), lines) != nullptr) {
    output += line;
    if (!ready.empty() && absl::StrContains(output, ready)) break;
  }
  std::fclose(lines);  // later output is lost
  return output;
}

// Waits until a program's first process and then all others have ended. Returns the status of the first.
int AwaitEnd(pid_t process, int end) {
  int status = 0;
  waitpid(process, &status, 0);
  char byte;
  while (read(end, &byte, 1) < 0 && errno == EINTR) continue;
  close(end);
  return status;
}

void RunToEnd(const std::vector<std::string>& arguments) {
  pid_t process = -1;
  int end = -1;
  const std::string output = RunProgram(arguments, "", process, end);
  const int status = AwaitEnd(process, end);
  if (status != 0) {
    throw std::runtime_error(absl::StrCat(arguments[0], " (deploy/install-dependencies.sh --test) failed: ", output));
  }
}

// Copies an empty cluster to a directory. It is made once and kept beside the test program, because initdb takes more
// than a second.
void CopyEmptyCluster(const std::string& to) {
  namespace fs = std::filesystem;
  const std::string kept = fs::read_symlink("/proc/self/exe").parent_path() / "empty_postgresql_15";
  const int lock = open((kept + ".lock").c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0644);
  if (lock >= 0) flock(lock, LOCK_EX);
  if (!fs::exists(kept)) {
    const TemporaryDirectory scratch;
    GiveToUser(scratch.path());
    RunToEnd({"initdb", "-D", scratch.File("data"), "-U", "evpose", "-A", "trust", "-E", "UTF8", "--locale=C",
              "--no-sync", "--wal-segsize=1"});
    std::ofstream(scratch.File("data/pg_hba.conf"))
        << "local all keyed scram-sha-256\nlocal all all trust\nlocal replication all trust\n";
    fs::remove_all(kept + ".partial");
    fs::copy(scratch.File("data"), kept + ".partial", fs::copy_options::recursive);
    fs::rename(kept + ".partial", kept);
  }
  fs::copy(kept, to, fs::copy_options::recursive);
  if (lock >= 0) close(lock);
}

}  // namespace

PostgresServer::PostgresServer(const std::vector<std::string>& settings) : settings_(settings) {
  CopyEmptyCluster(data());
  GiveToUser(directory_.path());
  Start();
}

PostgresServer::PostgresServer(StandbyOf standby) {
  GiveToUser(directory_.path());
  RunToEnd({"pg_basebackup", "-D", data(), "-d",
            "host=" + standby.primary.host() + " user=evpose application_name=standby", "-R", "-X", "stream", "-c",
            "fast", "--no-sync"});
  Start();
}

PostgresServer::~PostgresServer() { Signal(SIGQUIT); }

void PostgresServer::Start() {
  std::vector<std::string> words = {"postgres", "-D", data(), "-c", "listen_addresses=", "-c",
                                    "unix_socket_directories=" + directory_.path(), "-c", "shared_buffers=16MB", "-c",
                                    "wal_init_zero=off",
                                    // A busy machine must not make the primary take the standby for lost.
                                    "-c", "wal_sender_timeout=0", "-c", "wal_receiver_timeout=0"};
  for (const std::string& setting : settings_) words.insert(words.end(), {"-c", setting});
  const std::string output = RunProgram(words, "ready to accept", process_, end_);
  if (absl::StrContains(output, "ready to accept")) return;
  AwaitEnd(process_, end_);
  process_ = -1;
  ADD_FAILURE() << "postgres did not start: " << output;
}

// A connection's process that has not noticed the end of the first one could still commit.
void PostgresServer::Signal(int signal) {
  if (process_ <= 0) return;
  kill(process_, signal);
  AwaitEnd(process_, end_);
  process_ = -1;
}

void PostgresServer::Kill() { Signal(SIGKILL); }

void PostgresServer::Stop() { Signal(SIGINT); }

void PostgresServer::SetSynchronous(const std::string& standby) const {
  Run("ALTER SYSTEM SET synchronous_standby_names = '" + standby + "'");
  Run("SELECT pg_reload_conf()");
  ASSERT_TRUE(Poll([&] { return Run("SHOW synchronous_standby_names") == standby; }));
}

void PostgresServer::AwaitSynchronous(const std::string& standby) const {
  SetSynchronous(standby);
  ASSERT_TRUE(
      Poll([this] { return Run("SELECT count(*) FROM pg_stat_replication WHERE sync_state = 'sync'") == "1"; }));
}

std::string PostgresServer::Run(const std::string& sql) const {
  // The address has no target_session_attrs, because the server may be a standby.
  const PostgresAddress address = {.parameters = {{"host", host()}, {"user", "evpose"}, {"dbname", "postgres"}}};
  auto connection = PostgresConnection::Open(address, absl::Seconds(60)).value();
  const auto rows = connection->Execute(sql.c_str());
  EXPECT_EQ(rows.status(), absl::OkStatus()) << sql;
  return rows.ok() && rows->size() > 0 ? rows->Bytes(0, 0) : "";
}

}  // namespace evpose::server
