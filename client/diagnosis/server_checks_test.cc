// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/server_checks.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/base/version.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

const ServerCheckOptions kOptions;

TEST(ServerChecksTest, AnotherVersionIsAdvice) {
  ServerInfo server;
  server.version = ThisBuild().version;
  server.commit = ThisBuild().commit;
  EXPECT_EQ(CheckServerVersion(server).verdict, Verdict::kOk);
  server.version = "0.0.1";
  EXPECT_EQ(CheckServerVersion(server).verdict, Verdict::kAdvice);
  EXPECT_THAT(CheckServerVersion(server).text, HasSubstr("evpose-server 0.0.1"));
  EXPECT_THAT(CheckServerVersion(server).remedy, HasSubstr("same version"));
}

TEST(ServerChecksTest, SessionsUpToTheLimit) {
  ServerInfo server;
  server.max_sessions = 10;
  server.active_sessions = 9;
  EXPECT_EQ(CheckSessions(server, kOptions).verdict, Verdict::kOk);
  server.active_sessions = 10;
  EXPECT_EQ(CheckSessions(server, kOptions).verdict, Verdict::kProblem);
  EXPECT_THAT(CheckSessions(server, kOptions).remedy, HasSubstr("--max-sessions"));
  server.active_sessions = 0;
  server.skipped_events = 7;
  EXPECT_EQ(CheckSessions(server, kOptions).verdict, Verdict::kOk);
  EXPECT_THAT(CheckSessions(server, kOptions).text, HasSubstr("7 events"));
  server.is_draining = true;
  EXPECT_EQ(CheckSessions(server, kOptions).verdict, Verdict::kProblem);
}

TEST(ServerChecksTest, ModelLargerThanTheLimit) {
  ServerInfo server;
  server.max_model_bytes = 100;
  EXPECT_EQ(CheckModelBytes(server, std::nullopt).verdict, Verdict::kNotChecked);
  EXPECT_EQ(CheckModelBytes(server, 100).verdict, Verdict::kOk);
  const Finding finding = CheckModelBytes(server, 101);
  EXPECT_EQ(finding.verdict, Verdict::kProblem);
  EXPECT_EQ(finding.value, 101.0);
  EXPECT_EQ(finding.limit, 100.0);
}

// 1 MB in 0.1 s, not counting the round trip: 10 MB/s.
TEST(ServerChecksTest, LinkBesideTheEventsOfTheRecording) {
  const LinkProbe probe = {1'000'000, absl::Milliseconds(110), absl::Milliseconds(10)};
  EXPECT_NEAR(*CheckLink(probe, std::nullopt, kOptions).value, 80.0, 1e-9);
  EXPECT_EQ(CheckLink(probe, std::nullopt, kOptions).verdict, Verdict::kOk);
  EXPECT_EQ(CheckLink(probe, 4.9e6, kOptions).verdict, Verdict::kOk);
  EXPECT_EQ(CheckLink(probe, 5.1e6, kOptions).verdict, Verdict::kAdvice);
  const Finding slow = CheckLink(probe, 11e6, kOptions);
  EXPECT_EQ(slow.verdict, Verdict::kProblem);
  EXPECT_NEAR(*slow.value, 1.1, 1e-9);
  EXPECT_THAT(slow.text, HasSubstr("the recording has 88 Mbit/s"));
  EXPECT_THAT(slow.remedy, HasSubstr("faster network"));
  // Even a round trip of nearly the whole duration raises the rate by at most a factor of ten.
  const LinkProbe short_probe = {1000, absl::Milliseconds(10), absl::Milliseconds(10)};
  EXPECT_NEAR(*CheckLink(short_probe, std::nullopt, kOptions).value, 8.0, 1e-9);
  const LinkProbe ended = {1000, absl::Seconds(5), absl::ZeroDuration(), /*is_complete=*/false};
  EXPECT_THAT(CheckLink(ended, std::nullopt, kOptions).text, HasSubstr("carried less than 0.001 MB in 5 s"));
}

TEST(ServerChecksTest, ClockOutsideTheTimesOfTheCall) {
  const absl::Time sent = absl::FromUnixSeconds(1000);
  const absl::Time received = sent + absl::Milliseconds(100);
  const auto check = [&](absl::Duration after_sent) {
    return CheckServerClock(sent, received, sent + after_sent, kOptions);
  };
  EXPECT_EQ(check(absl::Milliseconds(50)).value, 0.0);
  EXPECT_EQ(check(absl::Milliseconds(1050)).verdict, Verdict::kOk);
  EXPECT_EQ(check(absl::Milliseconds(1150)).verdict, Verdict::kAdvice);
  EXPECT_THAT(check(absl::Milliseconds(1150)).text, HasSubstr("1.050 s ahead of"));
  EXPECT_EQ(check(absl::Seconds(-61)).verdict, Verdict::kProblem);
  EXPECT_THAT(check(absl::Seconds(-61)).text, HasSubstr("61.000 s behind"));
  EXPECT_THAT(check(absl::Seconds(-61)).remedy, HasSubstr("synchronise"));
  EXPECT_EQ(CheckServerClock(sent, received, absl::InfiniteFuture(), kOptions).verdict, Verdict::kProblem);
  EXPECT_EQ(CheckServerClock(sent, received, std::nullopt, kOptions).verdict, Verdict::kNotChecked);
}

TEST(ServerChecksTest, CausesOfAMissingConnection) {
  const auto first = [](const std::string& address, const absl::Status& status) {
    const std::vector<Finding> findings = DescribeUnconnected(address, status);
    for (size_t i = 1; i < findings.size(); ++i) EXPECT_EQ(findings[i].verdict, Verdict::kNotChecked);
    EXPECT_EQ(findings[0].verdict, Verdict::kProblem);
    EXPECT_FALSE(findings[0].text.empty());
    return findings[0];
  };
  const absl::Status unavailable = absl::UnavailableError("no server");
  // Names of RFC 6761 have no address.
  EXPECT_THAT(first("nowhere.invalid:50051", unavailable).text, HasSubstr("has no address"));
  EXPECT_THAT(first("nowhere.invalid:50051", unavailable).remedy, HasSubstr("DNS"));
  EXPECT_THAT(first("a:1", absl::UnauthenticatedError("no token")).remedy, HasSubstr("--token-file"));
  EXPECT_THAT(first("a:1", absl::UnimplementedError("another service")).remedy, HasSubstr("--listen"));
  EXPECT_EQ(first("a:1", absl::FailedPreconditionError("it requires TLS")).text, "it requires TLS");
}

}  // namespace
}  // namespace evpose::client
