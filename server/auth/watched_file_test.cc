// SPDX-License-Identifier: Apache-2.0
#include "server/auth/watched_file.h"

#include <gtest/gtest.h>

#include <chrono>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/auth/files_testing.h"

namespace evpose::server {
namespace {

using File = WatchedFile<std::string>;

class WatchedFileTest : public testing::Test {
 protected:
  WatchedFileTest() {
    files_.Write("file", "first");
    file_ = File::Open(
                files_.Path("file"),
                [this](const std::string& path) -> absl::StatusOr<std::string> {
                  ++num_reads_;
                  if (!error_.ok()) return error_;
                  return ReadFile(path, 100);
                },
                [this](const absl::StatusOr<std::string>& read) { reported_.push_back(read.status()); },
                [this] { return now_; })
                .value();
  }

  const TestFiles files_;
  absl::Status error_;
  int num_reads_ = 0;
  std::vector<absl::Status> reported_;
  std::chrono::steady_clock::time_point now_;
  std::unique_ptr<File> file_;
};

TEST_F(WatchedFileTest, AfterAnErrorOfReadingItIsReadAgainOncePerSecond) {
  error_ = absl::ResourceExhaustedError("too many open files");
  files_.Write("file", "second");
  EXPECT_EQ(*file_->Current(), "first");
  EXPECT_EQ(*file_->Current(), "first");
  EXPECT_EQ(num_reads_, 2) << "the second one has failed";
  now_ += std::chrono::seconds(1);
  EXPECT_EQ(*file_->Current(), "first");
  EXPECT_EQ(num_reads_, 3);
  EXPECT_EQ(reported_, std::vector<absl::Status>({error_})) << "the same error is reported once";
  error_ = absl::OkStatus();
  EXPECT_EQ(file_->version(), 1u);
  now_ += std::chrono::seconds(1);
  EXPECT_EQ(*file_->Current(), "second");
  EXPECT_EQ(file_->version(), 2u);
  now_ += std::chrono::seconds(1);
  EXPECT_EQ(*file_->Current(), "second");
  EXPECT_EQ(num_reads_, 4);
}

TEST_F(WatchedFileTest, AnErrorOfTheContentsRemainsUntilTheFileChanges) {
  error_ = absl::InvalidArgumentError("file:1: is not a line");
  files_.Write("file", "wrong");
  EXPECT_EQ(*file_->Current(), "first");
  now_ += std::chrono::hours(1);
  EXPECT_EQ(*file_->Current(), "first");
  EXPECT_EQ(num_reads_, 2);
  error_ = absl::OkStatus();
  files_.Write("file", "second");
  EXPECT_EQ(*file_->Current(), "second");
  EXPECT_EQ(num_reads_, 3);
}

}  // namespace
}  // namespace evpose::server
