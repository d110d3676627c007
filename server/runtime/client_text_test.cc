// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/client_text.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

TEST(ClientTextTest, CutsAndEscapes) {
  EXPECT_EQ(Shortened("sessions/0123456789abcdef0123456789abcdef"), "sessions/0123456789abcdef0123456789abcdef");
  EXPECT_EQ(Shortened(std::string(kMaxNameBytes, 'x')), std::string(kMaxNameBytes, 'x'));
  EXPECT_EQ(Shortened(std::string(kMaxNameBytes + 1, 'x')), std::string(kMaxNameBytes, 'x') + "...");
  EXPECT_EQ(Shortened("a\n\x1b\"\xe2\x80\xae"), R"(a\n\x1b\"\xe2\x80\xae)");
  EXPECT_LE(Shortened(std::string(10'000, '\0')).size(), 4 * kMaxNameBytes + 3);
}

TEST(ClientTextTest, PlainTextHasNoControlCharacters) {
  for (const absl::string_view plain :
       {"", "cube", "W\xc3\xbcrfel 2", "\xe7\xab\x8b\xe6\x96\xb9", "\xf0\x9f\x8e\xb2"}) {
    EXPECT_TRUE(IsPlainText(plain)) << Shortened(plain);
  }
  for (const absl::string_view odd :
       {absl::string_view("a\0b", 3), absl::string_view("a\n"), absl::string_view("\x1b[2J"), absl::string_view("\x7f"),
        absl::string_view("\xc2\x85"),
        absl::string_view("a\xe2\x80\xae"
                          "b"),
        absl::string_view("\xe2\x81\xa6x"), absl::string_view("\xff"), absl::string_view("\xc3"),
        absl::string_view("\xc0\x80"), absl::string_view("\xed\xa0\x80")}) {
    EXPECT_FALSE(IsPlainText(odd)) << Shortened(odd);
  }
}

}  // namespace
}  // namespace evpose::server
