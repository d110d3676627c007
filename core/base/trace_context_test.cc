// SPDX-License-Identifier: Apache-2.0
#include "core/base/trace_context.h"

#include <gtest/gtest.h>

#include <set>
#include <string>

namespace evpose {
namespace {

const TraceContext kContext = {"0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"};
const std::string kHeader = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";

TEST(TraceContextTest, TheTraceIdIsADigestOfTheNameOfTheSession) {
  // printf sessions/0123456789abcdef0123456789abcdef | sha256sum
  EXPECT_EQ(TraceIdOf("sessions/0123456789abcdef0123456789abcdef"), "d6b45b4d0b1ad1cba172fe86eb7a7833");
  EXPECT_EQ(TraceIdOf(""), "e3b0c44298fc1c149afbf4c8996fb924");
  EXPECT_EQ(TraceIdOf("sessions/x\nforged=1").size(), 32u) << "whatever a client calls a session";
}

TEST(TraceContextTest, SpanIdsDiffer) {
  std::set<std::string> ids;
  for (int i = 0; i < 100; ++i) ids.insert(NewSpanId());
  EXPECT_EQ(ids.size(), 100u);
  for (const std::string& id : ids) EXPECT_TRUE(ParseTraceparent(Traceparent({kContext.trace_id, id}))) << id;
}

TEST(TraceContextTest, ReadsWhatItWrites) {
  EXPECT_EQ(Traceparent(kContext), kHeader);
  EXPECT_EQ(ParseTraceparent(kHeader), kContext);
}

TEST(TraceContextTest, ReadsLaterVersions) {
  std::string later = kHeader;
  later[1] = '1';
  EXPECT_EQ(ParseTraceparent(later), kContext);
  EXPECT_EQ(ParseTraceparent(later + "-what follows"), kContext);
  EXPECT_FALSE(ParseTraceparent(later + "0"));
  EXPECT_FALSE(ParseTraceparent(kHeader + "-01")) << "version 00 has nothing more";
  later[0] = later[1] = 'f';
  EXPECT_FALSE(ParseTraceparent(later));
}

TEST(TraceContextTest, RejectsWhatIsMalformed) {
  for (size_t length = 0; length < kHeader.size(); ++length) EXPECT_FALSE(ParseTraceparent(kHeader.substr(0, length)));
  for (size_t place = 0; place < kHeader.size(); ++place) {
    for (const char wrong : {'g', 'A', '\n', '\0', '"', ' '}) {
      std::string header = kHeader;
      header[place] = wrong;
      EXPECT_FALSE(ParseTraceparent(header)) << place << " " << wrong;
    }
  }
  EXPECT_FALSE(ParseTraceparent("00-00000000000000000000000000000000-b7ad6b7169203331-01"));
  EXPECT_FALSE(ParseTraceparent("00-0af7651916cd43dd8448eb211c80319c-0000000000000000-01"));
  EXPECT_FALSE(ParseTraceparent(std::string(100'000, 'a')));
}

}  // namespace
}  // namespace evpose
