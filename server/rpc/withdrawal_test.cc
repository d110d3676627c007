// SPDX-License-Identifier: Apache-2.0

// Tests callers that are rejected, and the withdrawal of tokens and certificates while streams are open.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "core/base/poll_testing.h"
#include "server/rpc/authentication_testing.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

// Reads a stream to its end.
template <typename Response>
std::string EndOf(grpc::ClientReader<Response>& reader) {
  Response response;
  while (reader.Read(&response)) continue;
  return Describe(reader.Finish());
}

TEST_F(TokensTest, ARemovedTokenIsRejectedAndEndsItsStreams) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  RawTrack waiting(*sessions_);  // has not attached
  grpc::ClientContext poses_context, health_context, events_context;
  v1::WatchPosesRequest poses_request;
  poses_request.set_session(session.name());
  const auto poses = sessions_->WatchPoses(&poses_context, poses_request);
  v1::WatchHealthRequest health_request;
  health_request.set_session(session.name());
  const auto health = sessions_->WatchHealth(&health_context, health_request);
  v1::WatchHealthResponse first;
  EXPECT_TRUE(health->Read(&first));
  v1::WatchEventsRequest events_request;
  events_request.set_session(session.name());
  const auto events = sessions_->WatchEvents(&events_context, events_request);
  ASSERT_TRUE(Poll([this] { return server_->state().sessions.image_watchers > 0; }));
  Use(OpenChannel(server_->port(), field_.token));
  const auto others_track = Attached(CreateSession());

  WriteTokens({field_});
  Use(OpenChannel(server_->port(), lab_.token));
  CreatedSession read;
  EXPECT_EQ(Describe(Get(session.name(), &read)), "UNAUTHENTICATED BAD_TOKEN");
  EXPECT_EQ(Describe(track->Finish()), "UNAUTHENTICATED ACCESS_WITHDRAWN");
  EXPECT_EQ(Describe(waiting.Finish()), "UNAUTHENTICATED ACCESS_WITHDRAWN");
  EXPECT_EQ(EndOf(*poses), "UNAUTHENTICATED ACCESS_WITHDRAWN");
  EXPECT_EQ(EndOf(*health), "UNAUTHENTICATED ACCESS_WITHDRAWN");
  EXPECT_EQ(EndOf(*events), "UNAUTHENTICATED ACCESS_WITHDRAWN");
  EXPECT_EQ(server_->metrics().stream_ends[StreamKind::kTrack][absl::StatusCode::kUnauthenticated].value(), 2u);

  EXPECT_TRUE(others_track->End());
  v1::TrackResponse response;
  EXPECT_TRUE(others_track->ReadUntil(v1::TrackResponse::kSummary, response)) << "another tenant's stream continues";
  EXPECT_EQ(Describe(others_track->Finish()), "OK");
}

TEST_F(TokensTest, ARemovedTokenEndsAnUploadUnderWay) {
  ServerOptions options = Options();
  options.listen_address = "127.0.0.1:0";
  options.token_file = files_.Path("tokens");
  options.tenant.max_model_bytes = options.max_model_bytes;
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(OpenChannel(server_->port(), lab_.token));
  grpc::ClientContext context;
  v1::Model model, other;
  const auto upload = models_->UploadModel(&context, &model);
  ASSERT_TRUE(WriteAllButOneByte(*upload, options.max_model_bytes));
  // The chunk has arrived when there is no room beside it.
  ASSERT_TRUE(Poll([&] { return Describe(Upload({UploadHeader(2)}, &other)) == "RESOURCE_EXHAUSTED TENANT_QUOTA"; }));
  WriteTokens({field_});
  EXPECT_EQ(Describe(upload->Finish()), "UNAUTHENTICATED ACCESS_WITHDRAWN");
}

TEST_F(TokensTest, ATokenOfAnotherTenantEndsItsStreams) {
  const auto track = Attached(CreateSession());
  files_.Write("tokens", absl::StrReplaceAll(lab_.line, {{"lab ", "field "}}));
  EXPECT_EQ(Describe(track->Finish()), "UNAUTHENTICATED ACCESS_WITHDRAWN");
}

TEST_F(TokensTest, AnEmptiedTokenFileAdmitsNobody) {
  const auto track = Attached(CreateSession());
  EXPECT_EQ(server_->state().num_tokens, 3u);
  WriteTokens({});
  EXPECT_EQ(Describe(track->Finish()), "UNAUTHENTICATED ACCESS_WITHDRAWN");
  EXPECT_EQ(server_->state().num_tokens, 0u);
}

TEST_F(TokensTest, FailedAuthenticationsAreCountedAndLoggedAtALimitedRate) {
  captured_log.Take();
  const auto stranger = OpenChannel(server_->port(), "evpose_stranger");
  constexpr uint64_t kCalls = 500;
  for (uint64_t i = 0; i < kCalls; ++i) CallWithEmptyMessage(stranger, "/evpose.v1.AdminService/GetServerInfo");
  const OneFor<AuthenticationFailure, 3>& failures = server_->metrics().authentication_failures;
  EXPECT_EQ(failures[AuthenticationFailure::kBadToken].value(), kCalls);
  EXPECT_EQ(failures[AuthenticationFailure::kNoToken].value(), 0u);
  const std::string log = captured_log.Take();
  EXPECT_THAT(log, HasSubstr("warning authentication_failed peer="));
  EXPECT_THAT(log, HasSubstr(" reason=BAD_TOKEN "));
  const std::vector<std::string> lines = absl::StrSplit(log, '\n', absl::SkipEmpty());
  EXPECT_LT(lines.size(), kCalls / 2);
}

TEST_F(TokensTest, LongNamesAreCutInErrorsAndInTheLog) {
  const std::string name(5000, 'x');
  CreatedSession read;
  const grpc::Status status = Get(name, &read);
  EXPECT_EQ(Describe(status), "NOT_FOUND SESSION_NOT_FOUND");
  EXPECT_LT(status.error_message().size(), 300u);
  EXPECT_LT(status.error_details().size(), 600u);
  captured_log.Take();
  RawTrack track(*sessions_);
  track.Attach(name, "guess");
  EXPECT_EQ(Describe(track.Finish()), "NOT_FOUND SESSION_NOT_FOUND");
  const std::string log = captured_log.Take();
  EXPECT_THAT(log, HasSubstr("attach_refused"));
  EXPECT_THAT(log, Not(HasSubstr(std::string(101, 'x'))));
}

TEST_F(TokensTest, ATenantHasItsOwnLimitOfStreams) {
  ServerOptions options = Options();
  options.listen_address = "127.0.0.1:0";
  options.token_file = files_.Path("tokens");
  options.tenant.max_streams = 1;
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(OpenChannel(server_->port(), lab_.token));
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  RawTrack second(*sessions_);
  const grpc::Status refused = second.Finish();
  EXPECT_EQ(Describe(refused), "RESOURCE_EXHAUSTED TENANT_QUOTA");
  EXPECT_EQ(DetailOf<google::rpc::QuotaFailure>(refused).violations(0).subject(), "tenant_streams");
  Use(OpenChannel(server_->port(), field_.token));
  const auto others = Attached(CreateSession());
}

TEST_F(TlsTest, TheCommonNameMustBeUnique) {
  Start(TlsOptions(true));
  const TestCertificateOptions two = {.common_name = "lab", .second_common_name = "field"};
  EXPECT_EQ(Call(ConnectTls("", clients_.Issue(two))), "UNAUTHENTICATED BAD_CERTIFICATE");
}

TEST_F(TlsTest, RevokedCertificatesAreRejectedAndEndTheirStreams) {
  ServerOptions options = TlsOptions(true);
  options.tls.client_crl = files_.Write("clients.crl", clients_.Revoke({}));
  Start(options);
  const TestCertificate lost = clients_.Issue({.common_name = "lab"});
  Use(ConnectTls("", lost));
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  files_.Write("clients.crl", "nothing");
  CreatedSession read;
  EXPECT_EQ(Describe(Get(session.name(), &read)), "OK") << "a damaged list leaves the previous one in use";
  files_.Write("clients.crl", clients_.Revoke({lost}));
  EXPECT_EQ(Describe(track->Finish()), "UNAUTHENTICATED ACCESS_WITHDRAWN");
  EXPECT_EQ(Describe(Get(session.name(), &read)), "UNAUTHENTICATED BAD_CERTIFICATE") << "the same connection";
  std::filesystem::remove(options.tls.client_crl);
  EXPECT_EQ(Call(ConnectTls("", lost)), "UNAUTHENTICATED BAD_CERTIFICATE") << "the previous list stays in use";
  EXPECT_EQ(Call(ConnectTls("", clients_.Issue({.common_name = "lab"}))), "OK");
}

TEST_F(TlsTest, AStreamEndsWhenItsCertificateExpires) {
  Start(TlsOptions(true));
  Use(ConnectTls("", clients_.Issue({.common_name = "lab"})));
  v1::WatchHealthRequest request;
  request.set_session(CreateSession().name());
  // On a slow machine the certificate may expire before the stream begins.
  for (absl::Duration validity = absl::Seconds(2); validity < absl::Hours(1); validity *= 2) {
    const TestCertificateOptions brief = {.common_name = "lab", .not_after = absl::Now() + validity};
    const auto sessions = v1::SessionService::NewStub(ConnectTls("", clients_.Issue(brief)));
    grpc::ClientContext context;
    const auto health = sessions->WatchHealth(&context, request);
    v1::WatchHealthResponse first;
    if (!health->Read(&first)) {
      (void)health->Finish();
      continue;
    }
    EXPECT_EQ(EndOf(*health), "UNAUTHENTICATED ACCESS_WITHDRAWN");
    return;
  }
  FAIL() << "no stream began";
}

}  // namespace
}  // namespace evpose::server
