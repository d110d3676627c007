// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/token_requests.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::server {
namespace {

std::vector<std::string> Tokens(const std::vector<TokenRequest>& requests) {
  std::vector<std::string> tokens;
  for (const TokenRequest& request : requests) tokens.push_back(request.token);
  return tokens;
}

TEST(TokenRequestsTest, AnswersThoseWithAPersistedRecordInOrder) {
  TokenRequests requests;
  EXPECT_TRUE(requests.RemoveAnswerable(9, true).empty());
  requests.Add({2, "b", nullptr});
  requests.Add({4, "d", nullptr});
  requests.Add({3, "c", nullptr});
  EXPECT_TRUE(requests.RemoveAnswerable(1, false).empty());
  EXPECT_THAT(Tokens(requests.RemoveAnswerable(3, false)), testing::ElementsAre("b", "c"));
  EXPECT_TRUE(requests.RemoveAnswerable(3, false).empty()) << "each is answered once";
  requests.Add({5, "e", nullptr});
  EXPECT_THAT(Tokens(requests.RemoveAnswerable(0, true)), testing::ElementsAre("d", "e")) << "closed: all of them";
}

}  // namespace
}  // namespace evpose::server
