// SPDX-License-Identifier: Apache-2.0

// Tests the end of a stream with a slow store.
#include <string>

#include "core/base/temporary_directory.h"
#include "server/rpc/server_testing.h"

namespace evpose::server {
namespace {

class DurableEndTest : private TemporaryDirectory, public RpcTest {  // the server is destroyed before its directory
 protected:
  DurableEndTest() : RpcTest(OnSqlite(path())) {}

  static ServerOptions OnSqlite(const std::string& directory) {
    ServerOptions options = Options();
    options.store.store = "sqlite";
    options.store.data_dir = directory;
    return options;
  }
};

// The client sends `end` and closes its half of the stream, as client libraries do, long before the last poses are
// stored.
TEST_F(DurableEndTest, AClientThatHalfClosesBehindItsEndGetsTheSummary) {
  for (int i = 0; i < 3; ++i) {
    const CreatedSession session = CreateSession();
    const auto track = Attached(session);
    ASSERT_TRUE(track->Events(1, Flat64(SomeEvents(0, 50))));
    ASSERT_TRUE(track->End());
    track->WritesDone();
    v1::TrackResponse response;
    EXPECT_TRUE(track->ReadUntil(v1::TrackResponse::kSummary, response));
    EXPECT_EQ(response.summary().health().poses(), 50u);
    EXPECT_EQ(Describe(track->Finish()), "OK");
    EXPECT_EQ(Describe(Delete(session.name())), "OK");
  }
}

}  // namespace
}  // namespace evpose::server
