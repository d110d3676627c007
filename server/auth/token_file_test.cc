// SPDX-License-Identifier: Apache-2.0
#include "server/auth/token_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "server/auth/files_testing.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr char kAbc[] = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";  // of "abc"
constexpr char kEmpty[] = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";

std::string ParseError(const std::string& text) {
  return std::string(TokenTable::Parse(text, "tokens").status().message());
}

TEST(TokenTableTest, TenantAndRole) {
  const auto table = TokenTable::Parse(
      absl::StrCat("# who\r\n\n lab\t", kAbc, "  # since May\r\nadmin ", kEmpty, " operator\n"), "tokens");
  ASSERT_TRUE(table.ok()) << table.status();
  EXPECT_EQ(table->size(), 2u);
  EXPECT_EQ(table->Find("abc"), (Caller{"lab", false}));
  EXPECT_EQ(table->Find(""), (Caller{"admin", true}));
  EXPECT_EQ(table->Find("abd"), std::nullopt);
  EXPECT_EQ(table->Find(kAbc), std::nullopt) << "a digest from the file is not a token";
}

TEST(TokenTableTest, ErrorsNameTheLine) {
  const std::string good = absl::StrCat("lab ", kAbc, "\n");
  EXPECT_THAT(ParseError(good + "lab\n"), HasSubstr("tokens:2: has one field only: write TENANT"));
  EXPECT_THAT(ParseError(absl::StrCat(good, "\n-lab ", kEmpty)),
              HasSubstr("tokens:3: the first field is not a tenant"));
  EXPECT_THAT(ParseError(absl::StrCat(std::string(64, 'x'), " ", kEmpty)),
              HasSubstr("the first field is not a tenant"));
  EXPECT_THAT(ParseError(absl::StrCat(kEmpty, " lab")), HasSubstr("the first field is not a tenant"));
  EXPECT_THAT(ParseError(absl::StrCat("lab ", kAbc, " root")),
              HasSubstr("tokens:1: only the word `operator` may follow"));
  EXPECT_THAT(ParseError(absl::StrCat("lab ", kAbc, " operator x")),
              HasSubstr("tokens:1: only the word `operator` may follow"));
  EXPECT_THAT(ParseError(absl::StrCat(good, "other ", kAbc)),
              HasSubstr("tokens:2: an earlier line has the same token"));
  EXPECT_EQ(TokenTable::Parse("# nothing\n", "tokens")->size(), 0u);
}

TEST(TokenTableTest, ATokenInClearIsRefusedWithoutBeingRepeated) {
  const std::string token = MakeToken("lab", false)->token;
  for (const std::string& line : {absl::StrCat("lab ", token), absl::StrCat(token, " lab"), token}) {
    const std::string error = ParseError(line);
    EXPECT_THAT(error, AllOf(HasSubstr("tokens:1:"), Not(HasSubstr(token.substr(7, 8))))) << error;
  }
  EXPECT_THAT(ParseError("lab " + token), AllOf(HasSubstr("--new-token"), HasSubstr("sha256sum")));
}

TEST(TokenTableTest, AGeneratedTokenIsAcceptedWithItsLine) {
  const auto made = MakeToken("lab", true);
  ASSERT_TRUE(made.ok());
  EXPECT_THAT(made->token, testing::MatchesRegex("evpose_[0-9a-f]*"));
  EXPECT_EQ(made->token.size(), 7u + 64u);
  EXPECT_NE(made->token, MakeToken("lab", true)->token);
  EXPECT_EQ(TokenTable::Parse(made->line, "tokens")->Find(made->token), (Caller{"lab", true}));
  EXPECT_EQ(MakeToken("two words", false).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(TokenFileTest, LinesAreAdded) {
  const TestFiles files;
  const std::string path = files.Path("tokens");
  const NewToken lab = MakeToken("lab", false).value();
  const NewToken admin = MakeToken("admin", true).value();
  EXPECT_TRUE(AppendTokenLine(path, lab.line).ok());
  EXPECT_EQ(StampOf(path).mode & 0777, 0600u);
  ASSERT_EQ(chmod(path.c_str(), 0640), 0);
  EXPECT_TRUE(AppendTokenLine(path, admin.line).ok());
  EXPECT_EQ(StampOf(path).mode & 0777, 0640u);
  EXPECT_EQ(AppendTokenLine(path, lab.line).code(), absl::StatusCode::kInvalidArgument)
      << "the token is in the file already";
  const auto file = TokenFile::Open(path).value();
  EXPECT_EQ(file->Find(lab.token), (Caller{"lab", false}));
  EXPECT_EQ(file->Find(admin.token), (Caller{"admin", true}));
  files.Write("tokens", "# without a line's end");
  EXPECT_TRUE(AppendTokenLine(path, lab.line).ok());
  EXPECT_EQ(file->Find(lab.token), (Caller{"lab", false}));
  EXPECT_EQ(AppendTokenLine("/no/such/directory/tokens", lab.line).code(), absl::StatusCode::kNotFound);
}

TEST(TokenFileTest, IsReadAgainWhenItChanges) {
  const TestFiles files;
  const std::string path = files.Write("tokens", absl::StrCat("lab ", kAbc));
  captured_log.Take();
  const auto file = TokenFile::Open(path);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_THAT(captured_log.Take(), Not(HasSubstr("warning")));
  EXPECT_EQ((*file)->Find("abc"), (Caller{"lab", false}));
  EXPECT_EQ((*file)->Find(""), std::nullopt);

  files.Write("tokens", absl::StrCat("lab ", kEmpty));
  EXPECT_EQ((*file)->Find("abc"), std::nullopt);
  EXPECT_EQ((*file)->Find(""), (Caller{"lab", false}));
}

TEST(TokenFileTest, ABrokenNewVersionIsRefusedInTheLog) {
  const TestFiles files;
  const std::string path = files.Write("tokens", absl::StrCat("lab ", kAbc));
  const auto file = TokenFile::Open(path).value();
  const uint64_t version = file->version();
  captured_log.Take();
  files.Write("tokens", "lab secret");
  EXPECT_EQ(file->Find("abc"), (Caller{"lab", false}));
  EXPECT_EQ(file->version(), version);
  const std::string log = captured_log.Take();
  EXPECT_THAT(log, AllOf(HasSubstr("error"), HasSubstr(path), Not(HasSubstr("secret"))));
  file->Find("abc");
  EXPECT_EQ(captured_log.Take(), "") << "the error is logged once";
}

TEST(TokenFileTest, AnEmptiedOrDeletedFileAdmitsNobody) {
  const TestFiles files;
  const std::string line = absl::StrCat("lab ", kAbc);
  const std::string path = files.Write("tokens", line);
  const auto file = TokenFile::Open(path).value();
  for (const bool is_deleted : {false, true}) {
    files.Write("tokens", line);
    EXPECT_EQ(file->Find("abc"), (Caller{"lab", false}));
    const uint64_t version = file->version();
    captured_log.Take();
    if (is_deleted) {
      std::filesystem::remove(path);
    } else {
      files.Write("tokens", "# all withdrawn\n");
    }
    EXPECT_EQ(file->Find("abc"), std::nullopt) << is_deleted;
    EXPECT_EQ(file->size(), 0u);
    EXPECT_GT(file->version(), version);
    EXPECT_THAT(captured_log.Take(), AllOf(HasSubstr("error no_tokens"), HasSubstr(path)));
  }
}

TEST(TokenFileTest, FilesThatCannotBeOpenedAreErrors) {
  const TestFiles files;
  EXPECT_EQ(TokenFile::Open(files.Path("none")).status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(TokenFile::Open(files.Write("tokens", "")).status().message()),
              HasSubstr("tokens: the file has no token"));
}

TEST(TokenFileTest, AFileWithAccessForOtherUsersIsLogged) {
  const TestFiles files;
  const std::string path = files.Write("tokens", absl::StrCat("lab ", kAbc));
  ASSERT_EQ(chmod(path.c_str(), 0644), 0);
  captured_log.Take();
  EXPECT_TRUE(TokenFile::Open(path).ok());
  EXPECT_THAT(captured_log.Take(), AllOf(HasSubstr("warning"), HasSubstr("chmod 600")));
  // Readable by a group, as for the account of a service or a pod.
  ASSERT_EQ(chmod(path.c_str(), 0440), 0);
  EXPECT_TRUE(TokenFile::Open(path).ok());
  EXPECT_THAT(captured_log.Take(), Not(HasSubstr("warning")));
}

}  // namespace
}  // namespace evpose::server
