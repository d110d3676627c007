// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/spool.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "core/base/temporary_directory_testing.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

class SpoolTest : public ::testing::Test {
 protected:
  void SetUp() override {
    options_.directory = directory_;
    options_.max_bytes = 16 << 20;  // segments of 128 KiB
    options_.outlives_process = true;
  }

  std::unique_ptr<Spool> Open() {
    auto spool = Spool::Open(options_);
    EXPECT_TRUE(spool.ok()) << spool.status();
    return spool.ok() ? *std::move(spool) : nullptr;
  }

  // Different chunks of at least 50 000 bytes: two and a half fill a segment.
  void Append(Spool& spool, int count) {
    for (int i = 0; i < count; ++i) {
      const FeedPoint point = spool.last();
      std::string payload(50'000 + point.seq, static_cast<char>('a' + point.seq % 26));
      const OutgoingChunk chunk = point.seq % 7 == 5 ? MakeOutgoingReset(point, std::move(payload))
                                                     : MakeOutgoingChunk(point, std::move(payload), point.seq % 7 == 3);
      ASSERT_TRUE(spool.Append(chunk).ok());
      chunks_.push_back(chunk);
    }
  }

  void ExpectChunk(Spool& spool, uint64_t seq) {
    const auto chunk = spool.Read(seq);
    ASSERT_TRUE(chunk.ok()) << chunk.status();
    const OutgoingChunk& expected = chunks_[seq - 1];
    EXPECT_EQ(chunk->end, expected.end);
    EXPECT_EQ(chunk->payload, expected.payload);
    EXPECT_EQ(chunk->discontinuity, expected.discontinuity);
    EXPECT_EQ(chunk->is_reset, expected.is_reset);
    EXPECT_EQ(chunk->crc32c, expected.crc32c);
    const auto point = spool.PointAfter(seq);
    ASSERT_TRUE(point.ok()) << point.status();
    EXPECT_EQ(*point, expected.end);
  }

  std::vector<std::string> Files() const {
    std::vector<std::string> files;
    for (const auto& entry : std::filesystem::directory_iterator(directory_)) files.push_back(entry.path().string());
    std::sort(files.begin(), files.end());
    return files;
  }

  void FlipByte(const std::string& path, int64_t offset) {
    std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
    file.seekg(offset);
    const char byte = static_cast<char>(file.get() ^ 1);
    file.seekp(offset);
    file.put(byte);
  }

  const TemporaryDirectory parent_;
  const std::string directory_ = parent_.File("spool");
  SpoolOptions options_;
  std::vector<OutgoingChunk> chunks_;  // appended
};

TEST_F(SpoolTest, ReturnsStoredChunksInAnyOrder) {
  const auto spool = Open();
  EXPECT_TRUE(spool->empty());
  Append(*spool, 12);
  EXPECT_FALSE(spool->empty());
  for (const uint64_t seq : {1, 2, 3, 4, 12, 5, 4, 11, 12, 1}) ExpectChunk(*spool, seq);
  EXPECT_FALSE(spool->Read(0).ok());
  EXPECT_FALSE(spool->Read(13).ok());
}

TEST_F(SpoolTest, OnlyItsOwnerMayReadIt) {
  const auto spool = Open();
  Append(*spool, 1);
  struct stat info;
  ASSERT_EQ(stat(directory_.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0700u);
  ASSERT_EQ(stat(Files().front().c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600u);
}

TEST_F(SpoolTest, FilesAreDeletedWithTheirChunks) {
  const auto spool = Open();
  Append(*spool, 12);
  const size_t num_files = Files().size();
  EXPECT_EQ(num_files, 4u);
  spool->Release(2);
  EXPECT_EQ(Files().size(), num_files);
  spool->Release(3);
  EXPECT_EQ(Files().size(), num_files - 1);
  EXPECT_EQ(spool->first_seq(), 4u);
  EXPECT_FALSE(spool->Read(3).ok());
  ExpectChunk(*spool, 4);
  spool->Release(12);
  EXPECT_EQ(Files().size(), 1u) << "the last file contains the position for the next process";
  Append(*spool, 1);
  ExpectChunk(*spool, 13);
}

TEST_F(SpoolTest, WithoutNamesNoFileIsLeft) {
  options_.outlives_process = false;
  const auto spool = Open();
  Append(*spool, 5);
  EXPECT_TRUE(Files().empty());
  ExpectChunk(*spool, 3);
  spool->Release(5);
  EXPECT_TRUE(spool->empty());
  Append(*spool, 1);
  ExpectChunk(*spool, 6);
}

TEST_F(SpoolTest, AnotherProcessContinues) {
  Append(*Open(), 5);
  const auto spool = Open();
  EXPECT_EQ(spool->first_seq(), 1u);
  EXPECT_EQ(spool->last(), chunks_.back().end);
  Append(*spool, 5);
  for (uint64_t seq = 1; seq <= 10; ++seq) ExpectChunk(*spool, seq);
}

TEST_F(SpoolTest, RecordCutAnywhereIsDropped) {
  Append(*Open(), 2);
  const std::string path = Files().back();
  const auto whole = std::filesystem::file_size(path);
  const auto second = whole - chunks_[1].payload.size() - 44;
  for (const auto size : {whole - 1, second + 45, second + 44, second + 43, second + 1}) {
    std::filesystem::resize_file(path, size);
    const auto spool = Open();
    EXPECT_EQ(spool->last(), chunks_[0].end);
    EXPECT_EQ(std::filesystem::file_size(path), second);
    chunks_.pop_back();
    Append(*spool, 1);
  }
  ExpectChunk(*Open(), 2);
}

TEST_F(SpoolTest, EmptyLastFileIsIgnored) {
  Append(*Open(), 1);
  std::ofstream(directory_ + "/00000000000000000002.spool").flush();
  const auto spool = Open();
  EXPECT_EQ(spool->last(), chunks_[0].end);
  Append(*spool, 1);
  ExpectChunk(*spool, 2);
}

TEST_F(SpoolTest, DamageBeforeTheLastFileIsNamed) {
  Append(*Open(), 6);
  const std::string path = Files().front();
  for (const int64_t offset : {0, 5, 20, 41, 44, 50'000}) {
    FlipByte(path, offset);
    const auto spool = Spool::Open(options_);
    EXPECT_EQ(spool.status().code(), absl::StatusCode::kDataLoss) << offset;
    EXPECT_THAT(spool.status().message(), HasSubstr(path + ": damaged at byte 0"));
    FlipByte(path, offset);
  }
  EXPECT_TRUE(Spool::Open(options_).ok());
}

TEST_F(SpoolTest, ChangedBytesAreNotSent) {
  const auto spool = Open();
  Append(*spool, 2);
  FlipByte(Files().front(), 100);
  EXPECT_EQ(spool->Read(1).status().code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(spool->Read(1).status().message(), HasSubstr("damaged at byte 0"));
  ExpectChunk(*spool, 2);
}

TEST_F(SpoolTest, DirectoryThatCannotBeUsedIsNamedAtOnce) {
  options_.directory = directory_ + "/no/such";
  EXPECT_EQ(Spool::Open(options_).status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(Spool::Open(options_).status().message(), HasSubstr(options_.directory));
  options_.directory = directory_;
  std::ofstream(directory_).flush();
  EXPECT_THAT(Spool::Open(options_).status().message(), HasSubstr(directory_));
  EXPECT_FALSE(Spool::Open(options_).ok());
}

TEST_F(SpoolTest, FullDiskIsAnErrorAndKeepsStoredChunks) {
  const auto spool = Open();
  Append(*spool, 1);
  // A limit on the size of files has the same effect as a full disk.
  rlimit before;
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit limit = before;
  limit.rlim_cur = 60'000;
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
  const absl::Status full = spool->Append(MakeOutgoingChunk(spool->last(), std::string(50'000, 'x'), false));
  setrlimit(RLIMIT_FSIZE, &before);
  EXPECT_FALSE(full.ok());
  EXPECT_THAT(full.message(), HasSubstr(directory_ + ": the spool cannot be written"));
  EXPECT_EQ(spool->last(), chunks_[0].end);
  ExpectChunk(*spool, 1);
  Append(*spool, 1);
  ExpectChunk(*spool, 2);
  EXPECT_EQ(Open()->last(), chunks_[1].end);
}

TEST_F(SpoolTest, AcceptsChunksUpToItsLimit) {
  const auto spool = Open();
  const OutgoingChunk chunk = MakeOutgoingChunk({}, std::string(1 << 20, 'x'), false);
  int count = 0;
  for (; spool->HasRoomFor(chunk); ++count) {
    ASSERT_TRUE(spool->Append(MakeOutgoingChunk(spool->last(), chunk.payload, false)).ok());
  }
  EXPECT_EQ(count, 15);  // of 16 MiB, since the records have headers
  spool->Release(3);
  EXPECT_TRUE(spool->HasRoomFor(chunk));
  options_.max_bytes = 1;
  EXPECT_THAT(Spool::Open(options_).status().message(), HasSubstr("max_bytes"));
}

}  // namespace
}  // namespace evpose::client
