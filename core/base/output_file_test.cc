// SPDX-License-Identifier: Apache-2.0
#include "core/base/output_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <string>
#include <utility>

#include "core/base/temporary_directory_testing.h"
#include "core/base/temporary_files.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

class OutputFileTest : public ::testing::Test {
 protected:
  std::string Path(const std::string& name) const { return directory_.File(name); }
  int NumFiles() const {
    return static_cast<int>(std::distance(std::filesystem::directory_iterator(directory_.path()), {}));
  }

  const TemporaryDirectory directory_;
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

TEST_F(OutputFileTest, WithoutCommitTheOldFileStays) {
  ASSERT_TRUE(WriteFile(Path("a.txt"), "old").ok());
  {
    auto file = OutputFile::Create(Path("a.txt"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(file->Append("new").ok());
  }
  EXPECT_EQ(*ReadFile(Path("a.txt"), 100), "old");
  EXPECT_EQ(NumFiles(), 1);
}

TEST_F(OutputFileTest, ASignalRemovesTheTemporaryFilesOnly) {
  ASSERT_TRUE(WriteFile(Path("complete"), "a").ok());
  {
    auto unfinished = OutputFile::Create(Path("unfinished")).value();
    auto moved = OutputFile(std::move(unfinished));
    EXPECT_EQ(NumFiles(), 2);
    RemoveTemporaryFiles();
    EXPECT_EQ(NumFiles(), 1);
  }
  // Each file gives its place to a later one.
  for (int i = 0; i < 100; ++i) {
    ASSERT_TRUE(OutputFile::Create(Path("discarded")).ok());
    ASSERT_TRUE(WriteFile(Path("complete"), "b").ok());
  }
  const auto last = OutputFile::Create(Path("last"));
  ASSERT_TRUE(last.ok());
  EXPECT_EQ(NumFiles(), 2);
  RemoveTemporaryFiles();
  EXPECT_EQ(ReadFile(Path("complete"), 10).value(), "b");
  EXPECT_EQ(NumFiles(), 1);
}

TEST_F(OutputFileTest, ContinuedFileStaysUntilItIsCommitted) {
  {
    auto file = OutputFile::Continue(Path("a.txt"), 0);
    ASSERT_TRUE(file.ok()) << file.status();
    ASSERT_TRUE(file->Append("one two").ok());
    const auto size = file->Sync();
    ASSERT_TRUE(size.ok()) << size.status();
    EXPECT_EQ(*size, 7u);
    ASSERT_TRUE(file->Append(" thr").ok());  // incomplete when the process was killed
  }
  EXPECT_EQ(*ReadFile(Path("a.txt.partial"), 100), "one two thr");
  auto file = OutputFile::Continue(Path("a.txt"), 7);
  ASSERT_TRUE(file.ok()) << file.status();
  ASSERT_TRUE(file->Append(" three").ok());
  EXPECT_FALSE(std::filesystem::exists(Path("a.txt")));
  ASSERT_TRUE(file->Commit().ok());
  EXPECT_EQ(*ReadFile(Path("a.txt"), 100), "one two three");
  EXPECT_EQ(NumFiles(), 1);
}

TEST_F(OutputFileTest, ErrorsOfContinueNameThePath) {
  EXPECT_EQ(OutputFile::Continue(Path("a.txt"), 1).status().code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(WriteFile(Path("a.txt.partial"), "one").ok());
  const auto shorter = OutputFile::Continue(Path("a.txt"), 4);
  EXPECT_EQ(shorter.status().code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(shorter.status().message(), HasSubstr("a.txt.partial: has 3 bytes, but 4 had been written"));
  EXPECT_EQ(OutputFile::Continue("/dev/null", 0).status().code(), absl::StatusCode::kInvalidArgument);
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
  EXPECT_EQ(WriteFile(directory_.path(), "x").code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(NumFiles(), 0);
}

TEST_F(OutputFileTest, ReadErrors) {
  EXPECT_EQ(ReadFile(Path("missing"), 10).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(ReadFile(directory_.path(), 10).status().code(), absl::StatusCode::kInvalidArgument);
  ASSERT_EQ(mkfifo(Path("pipe").c_str(), 0600), 0);
  EXPECT_EQ(ReadFile(Path("pipe"), 10).status(),
            absl::InvalidArgumentError(Path("pipe") +
                                       ": is a pipe or device, not a file; write its contents to a file first"));
  EXPECT_EQ(CheckIsFile(Path("pipe")), ReadFile(Path("pipe"), 10).status());
  EXPECT_EQ(CheckIsFile(Path("missing")).code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(WriteFile(Path("big"), "12345678901").ok());
  EXPECT_EQ(ReadFile(Path("big"), 10).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(ReadFile(Path("big"), 11).value(), "12345678901");
  EXPECT_TRUE(CheckIsFile(Path("big")).ok());
}

}  // namespace
}  // namespace evpose
