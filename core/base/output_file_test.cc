#include "core/base/output_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>

namespace evpose {
namespace {

using ::testing::HasSubstr;

class OutputFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    directory_ = std::filesystem::path(::testing::TempDir()) / (std::string("output_file_test_") + info->name());
    std::filesystem::remove_all(directory_);
    std::filesystem::create_directories(directory_);
  }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  std::string Path(const std::string& name) const { return (directory_ / name).string(); }
  int NumFiles() const { return static_cast<int>(std::distance(std::filesystem::directory_iterator(directory_), {})); }

  std::filesystem::path directory_;
};

TEST_F(OutputFileTest, AppearsOnlyWhenCommitted) {
  auto file = OutputFile::Create(Path("a.txt"));
  ASSERT_TRUE(file.ok()) << file.status();
  ASSERT_TRUE(file->Append("one ").ok());
  ASSERT_TRUE(file->Append("two").ok());
  EXPECT_FALSE(std::filesystem::exists(Path("a.txt")));
  ASSERT_TRUE(file->Commit().ok());
  EXPECT_EQ(*ReadFile(Path("a.txt"), 100), "one two");
  EXPECT_EQ(NumFiles(), 1);
}

TEST_F(OutputFileTest, AbandonedLeavesTheOldFile) {
  ASSERT_TRUE(WriteFile(Path("a.txt"), "old").ok());
  {
    auto file = OutputFile::Create(Path("a.txt"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(file->Append("new").ok());
  }
  EXPECT_EQ(*ReadFile(Path("a.txt"), 100), "old");
  EXPECT_EQ(NumFiles(), 1);
}

TEST_F(OutputFileTest, FollowsALink) {
  ASSERT_TRUE(WriteFile(Path("target"), "old").ok());
  std::filesystem::create_symlink(Path("target"), Path("link"));
  ASSERT_TRUE(WriteFile(Path("link"), "new").ok());
  EXPECT_TRUE(std::filesystem::is_symlink(Path("link")));
  EXPECT_EQ(*ReadFile(Path("target"), 100), "new");
}

TEST_F(OutputFileTest, DevicesAreWrittenAndStay) {
  ASSERT_TRUE(WriteFile("/dev/null", "gone").ok());
  EXPECT_TRUE(std::filesystem::is_character_file("/dev/null"));
}

TEST_F(OutputFileTest, FullDiskIsAnError) { EXPECT_FALSE(WriteFile("/dev/full", std::string(1 << 20, 'x')).ok()); }

TEST_F(OutputFileTest, ErrorsNameThePath) {
  const absl::Status missing = WriteFile(Path("no/such/file"), "x");
  EXPECT_EQ(missing.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(missing.message(), HasSubstr(Path("no/such/file")));
  EXPECT_EQ(WriteFile(directory_.string(), "x").code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(NumFiles(), 0);
}

TEST_F(OutputFileTest, ReadErrors) {
  EXPECT_EQ(ReadFile(Path("missing"), 10).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(ReadFile(directory_.string(), 10).status().code(), absl::StatusCode::kInvalidArgument);
  ASSERT_TRUE(WriteFile(Path("big"), "12345678901").ok());
  EXPECT_EQ(ReadFile(Path("big"), 10).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(ReadFile(Path("big"), 11).value(), "12345678901");
}

}  // namespace
}  // namespace evpose
