// SPDX-License-Identifier: Apache-2.0

// Tests tokens and TLS with the command-line client and a server.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "core/base/certificates_testing.h"
#include "core/base/environment_testing.h"
#include "core/base/output_file.h"
#include "core/base/poll_testing.h"
#include "core/base/version.h"
#include "server/auth/token_file.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/cutting_proxy.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

class AuthenticationCliTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    const TestCertificate certificate = authority_.Issue();
    WriteText("ca.crt", authority_.pem());
    WriteText("server.crt", certificate.certificate_pem);
    WriteText("server.key", certificate.key_pem);
    WriteText("tokens", lab_.line + "\n");
    WriteText("lab.token", lab_.token + "\n");
    std::filesystem::permissions(Path("lab.token"), std::filesystem::perms::owner_read);
    server::ServerOptions options;
    options.token_file = Path("tokens");
    plain_ = Start(options);
    options.tls = {Path("server.crt"), Path("server.key"), ""};
    tls_ = Start(options);
  }

  static std::unique_ptr<server::Server> Start(const server::ServerOptions& options) {
    return StartLocalServer(options).server;
  }
  CliResult List(const server::Server& server, std::vector<std::string> more) const {
    more.insert(more.begin(), {"sessions", "list", "--server", "localhost:" + std::to_string(server.port())});
    return Run(more);
  }

  const TestAuthority authority_;
  const server::NewToken lab_ = server::MakeToken("lab", false).value();
  std::unique_ptr<server::Server> plain_;
  std::unique_ptr<server::Server> tls_;
};

TEST_F(AuthenticationCliTest, DoctorSaysWhyAServerRefuses) {
  const auto doctor = [this](const server::Server& server, std::vector<std::string> more) {
    more.insert(more.begin(),
                {"doctor", "--server", "localhost:" + std::to_string(server.port()), "--connect-timeout", "3"});
    return Run(more);
  };
  const CliResult no_token = doctor(*plain_, {});
  EXPECT_EQ(no_token.status, 1);
  EXPECT_THAT(no_token.out, AllOf(HasSubstr("problem      connection"), HasSubstr("-> give the token of this server")));
  EXPECT_THAT(doctor(*plain_, {"--token-file", Path("lab.token")}).out, HasSubstr("ok           connection"));
  EXPECT_THAT(doctor(*tls_, {}).out, HasSubstr("it requires TLS: give --tls"));
  EXPECT_THAT(doctor(*tls_, {"--tls"}).out, HasSubstr("give the authority's certificate with --tls-ca"));
  EXPECT_THAT(doctor(*plain_, {"--tls-ca", Path("ca.crt")}).out, HasSubstr("it does not use TLS"));
  EXPECT_THAT(doctor(*tls_, {"--tls-ca", Path("ca.crt"), "--token-file", Path("lab.token")}).out,
              HasSubstr("ok           connection"));
}

TEST_F(AuthenticationCliTest, WhereATokenComesFrom) {
  EXPECT_EQ(List(*plain_, {"--token-file", Path("lab.token")}).status, 0);
  const CliResult none = List(*plain_, {});
  EXPECT_EQ(none.status, 1);
  EXPECT_THAT(none.err, HasSubstr("the server requires a token: give --token-file (API: "));
  {
    const ScopedEnvironmentVariable right("EVPOSE_TOKEN", lab_.token);
    EXPECT_EQ(List(*plain_, {}).status, 0);
  }
  const ScopedEnvironmentVariable wrong_token("EVPOSE_TOKEN", "evpose_wrong");
  const CliResult wrong = List(*plain_, {});
  EXPECT_EQ(wrong.status, 1);
  EXPECT_THAT(wrong.err, AllOf(HasSubstr("this token is not valid"), Not(HasSubstr("evpose_wrong"))));
  EXPECT_EQ(List(*plain_, {"--token-file", Path("lab.token")}).status, 0) << "the file takes precedence";
}

TEST_F(AuthenticationCliTest, TokenFilesThatCannotBeUsed) {
  EXPECT_THAT(List(*plain_, {"--token-file", Path("none")}).err, HasSubstr(Path("none")));
  WriteText("open.token", lab_.token);
  std::filesystem::permissions(Path("open.token"), static_cast<std::filesystem::perms>(0640));
  const CliResult open = List(*plain_, {"--token-file", Path("open.token")});
  EXPECT_EQ(open.status, 1);
  EXPECT_THAT(open.err, AllOf(HasSubstr("chmod 600 " + Path("open.token")), Not(HasSubstr(lab_.token))));
  WriteText("empty.token", "\n");
  std::filesystem::permissions(Path("empty.token"), static_cast<std::filesystem::perms>(0600));
  EXPECT_THAT(List(*plain_, {"--token-file", Path("empty.token")}).err, HasSubstr("the file has no token"));
  std::filesystem::permissions(Path("tokens"), static_cast<std::filesystem::perms>(0600));
  EXPECT_THAT(
      List(*plain_, {"--token-file", Path("tokens")}).err,
      AllOf(HasSubstr(Path("tokens") + ": is not a token"), HasSubstr("a server's list of tokens is not a token")));
}

TEST_F(AuthenticationCliTest, OptionsOfTls) {
  const std::vector<std::string> token = {"--token-file", Path("lab.token")};
  const auto with = [&token](std::vector<std::string> more) {
    more.insert(more.end(), token.begin(), token.end());
    return more;
  };
  EXPECT_EQ(List(*tls_, with({"--tls-ca", Path("ca.crt")})).status, 0);
  EXPECT_THAT(List(*tls_, with({"--tls"})).err, HasSubstr("give the authority's certificate with --tls-ca"));
  EXPECT_THAT(List(*tls_, token).err, HasSubstr("it requires TLS"));
  EXPECT_THAT(List(*plain_, with({"--tls-ca", Path("ca.crt")})).err, HasSubstr("it does not use TLS"));
  const CliResult half = List(*tls_, with({"--tls-cert", Path("server.crt")}));
  EXPECT_EQ(half.status, 2);
  EXPECT_THAT(half.err, HasSubstr("--tls-cert and --tls-key belong together"));
}

TEST_F(AuthenticationCliTest, OptionsForAServerNeedAServer) {
  const std::vector<std::vector<std::string>> ways = {
      {"--tls-ca", "file"},       {"--tls-cert", "file"}, {"--tls-key", "file"}, {"--token-file", "file"},
      {"--connect-timeout", "5"}, {"--max-outage", "5"},  {"--keep-session"},    {"--tls"}};
  for (const std::vector<std::string>& way : ways) {
    std::vector<std::string> arguments = {"replay", "r.raw", "--model", "m.obj", "--camera", "c.yaml"};
    arguments.insert(arguments.end(), way.begin(), way.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << way[0];
    EXPECT_THAT(result.err, HasSubstr(way[0] + " requires --server")) << way[0];
  }
}

TEST_F(AuthenticationCliTest, ATokenThatCannotBePrintedIsAnError) {
  const CliResult result = RunShell("evpose-server --new-token lab --token-file made > /dev/full");
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("the token could not be written"));
  EXPECT_THAT(result.err, HasSubstr("remove its line, the last one, from made"));
  const CliResult help = RunShell("evpose-server --help > /dev/full");
  EXPECT_EQ(help.status, 1);
  EXPECT_THAT(help.err, HasSubstr("the disk is full"));
}

TEST_F(AuthenticationCliTest, AnErrorOfTlsIsOneLine) {
  const std::string to = "evpose sessions list --token-file lab.token --connect-timeout 5 --server localhost:";
  for (const std::string& command : {absl::StrCat(to, tls_->port(), " --tls"), absl::StrCat(to, tls_->port()),
                                     absl::StrCat(to, plain_->port(), " --tls-ca ca.crt")}) {
    const CliResult result = RunShell("unset GRPC_VERBOSITY\n" + command);
    EXPECT_EQ(result.status, 1) << command;
    EXPECT_THAT(result.err, StartsWith("evpose sessions list: ")) << command;
    EXPECT_EQ(result.err.find('\n'), result.err.size() - 1) << result.err;
  }
}

TEST_F(AuthenticationCliTest, DrainAndLogLevelNeedAnOperator) {
  const std::string address = "localhost:" + std::to_string(plain_->port());
  const auto run = [&](std::vector<std::string> command) {
    command.insert(command.end(), {"--server", address, "--token-file", Path("lab.token")});
    return Run(command);
  };
  const CliResult drain = run({"sessions", "drain"});
  EXPECT_EQ(drain.status, 1);
  EXPECT_THAT(drain.err, HasSubstr("the caller is not an operator and may not drain the server"));
  const CliResult level = run({"server", "log-level", "debug"});
  EXPECT_EQ(level.status, 1);
  EXPECT_THAT(level.err, HasSubstr("the caller is not an operator and may not set the log level"));
  EXPECT_EQ(run({"server", "log-level", "loud"}).status, 2);
  const CliResult info = run({"server", "info", "--json"});
  EXPECT_EQ(info.status, 0) << info.err;
  EXPECT_EQ(info.Json()["commit"], ThisBuild().commit);
}

TEST_F(AuthenticationCliTest, AReplayThroughTlsGivesTheSamePoses) {
  SimulateCube(0.1);
  ASSERT_EQ(Run(ReplayArguments("inside.tum")).status, 0);
  const CliResult result =
      Run(ReplayArguments("tls.tum", {"--server", "localhost:" + std::to_string(tls_->port()), "--tls-ca",
                                      Path("ca.crt"), "--token-file", Path("lab.token")}));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_FALSE(ReadText("tls.tum").empty());
  EXPECT_EQ(ReadText("tls.tum"), ReadText("inside.tum"));
}

TEST_F(AuthenticationCliTest, ABrokenStreamResumesWithTheCurrentToken) {
  SimulateCube(0.3);
  ASSERT_EQ(Run(ReplayArguments("inside.tum")).status, 0);
  CuttingProxy proxy;
  proxy.SetTarget(plain_->port());
  proxy.CutAfter(std::vector<uint64_t>(10, 50'000));
  const std::jthread renewal([&] {
    EXPECT_TRUE(Poll([&] { return proxy.num_cut() > 0; }));
    proxy.SetTarget(0);
    EXPECT_TRUE(Poll([&] { return proxy.num_refused() > 0; }));
    // No client is connected: from now on every call with the first token fails.
    const server::NewToken renewed = server::MakeToken("lab", false).value();
    WriteText("tokens", renewed.line + "\n");
    std::filesystem::permissions(Path("lab.token"), std::filesystem::perms::owner_write,
                                 std::filesystem::perm_options::add);
    WriteText("lab.token", renewed.token + "\n");
    proxy.SetTarget(plain_->port());
  });
  const CliResult result =
      Run(ReplayArguments("renewed.tum", {"--server", "localhost" + proxy.address().substr(proxy.address().find(':')),
                                          "--chunk-bytes", "4096", "--token-file", Path("lab.token")}));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(ReadText("renewed.tum"), ReadText("inside.tum"));
}

TEST_F(AuthenticationCliTest, TheNameInACertificateIsTheTenant) {
  for (const std::string tenant : {"lab", "field"}) {
    const TestCertificate certificate = authority_.Issue({.common_name = tenant});
    WriteText(tenant + ".crt", certificate.certificate_pem);
    WriteText(tenant + ".key", certificate.key_pem);
  }
  server::ServerOptions options;
  options.tls = {Path("server.crt"), Path("server.key"), Path("ca.crt")};
  const auto server = Start(options);
  const auto as = [&](const std::string& tenant) -> std::vector<std::string> {
    return {"--server",   "localhost:" + std::to_string(server->port()),
            "--tls-ca",   Path("ca.crt"),
            "--tls-cert", Path(tenant + ".crt"),
            "--tls-key",  Path(tenant + ".key")};
  };
  SimulateCube(0.02);
  std::vector<std::string> replay = as("lab");
  replay.push_back("--keep-session");
  const CliResult kept = Run(ReplayArguments("lab.tum", replay));
  ASSERT_EQ(kept.status, 0) << kept.err;
  const auto list = [&](const std::string& tenant) {
    std::vector<std::string> arguments = as(tenant);
    arguments.insert(arguments.begin(), {"sessions", "list"});
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 0) << result.err;
    return result.out;
  };
  EXPECT_THAT(list("lab"), StartsWith("sessions/"));
  EXPECT_EQ(list("field"), "");
  std::vector<std::string> drain = as("lab");
  drain.insert(drain.begin(), {"sessions", "drain"});
  EXPECT_THAT(Run(drain).err, HasSubstr("the caller is not an operator"));
}

TEST_F(AuthenticationCliTest, TheCommandsOfTheReadmeWorkAsPrinted) {
  const std::string readme = ReadFile(EVPOSE_AUTH_README, 1u << 20).value();
  const std::string marker = "<!-- who may use a server -->\n```\n";
  const size_t begin = readme.find(marker);
  ASSERT_NE(begin, std::string::npos);
  std::string script = readme.substr(begin + marker.size());
  script = script.substr(0, script.find("```"));
  // The commands of the README with a free port, and with code that waits for the server and ends it.
  const std::string original = script;
  script = absl::StrReplaceAll(script, {{"0.0.0.0:50051", "0.0.0.0:0 --port-file port"},
                                        {"localhost:50051", "localhost:$(cat port)"},
                                        {"--token-file tokens &\n",
                                         "--token-file tokens &\nserver=$!\ntrap 'kill $server; wait $server' EXIT\n"
                                         "pid=$server\nawait 'test -s port'\n"}});
  ASSERT_NE(script.find("await "), std::string::npos) << original;
  std::filesystem::create_directories(Path("readme"));
  const CliResult result = RunShell("cd readme\n" + script);
  EXPECT_EQ(result.status, 0) << script << result.err;
  EXPECT_THAT(result.err, Not(HasSubstr("warning"))) << "openssl makes keys with access for their owner only";
  EXPECT_THAT(ReadText("readme/lab.token"), StartsWith("evpose_"));
  EXPECT_THAT(result.err, Not(HasSubstr(ReadText("readme/lab.token").substr(0, 20))));
}

}  // namespace
}  // namespace evpose
