// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/tar_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

constexpr size_t kNoLimit = size_t{1} << 20;

class TarFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    path_ = absl::StrCat(::testing::TempDir(), "/tar_file_test_",
                         ::testing::UnitTest::GetInstance()->current_test_info()->name(), ".tar");
    std::filesystem::remove(path_);
  }

  // Writes an archive of two files, and returns its bytes.
  std::string Write() {
    auto writer = TarWriter::Create(path_);
    EXPECT_TRUE(writer.ok()) << writer.status();
    writer->Add("folder/a.txt", std::string(600, 'a'));
    writer->Add("folder/b.txt", "");
    EXPECT_TRUE(writer->Commit().ok());
    return *ReadFile(path_, kNoLimit);
  }

  // Returns the error of an archive with these bytes.
  std::string Error(const std::string& bytes) {
    EXPECT_TRUE(WriteFile(path_, bytes).ok());
    const auto files = ReadTar(path_, kNoLimit);
    EXPECT_TRUE(absl::IsInvalidArgument(files.status())) << files.status();
    EXPECT_THAT(files.status().message(), HasSubstr(path_));
    return std::string(files.status().message());
  }

  // Replaces bytes of the first header and corrects its check sum.
  static std::string WithField(std::string bytes, size_t offset, const std::string& value) {
    bytes.replace(offset, value.size(), value);
    bytes.replace(148, 8, 8, ' ');
    unsigned sum = 0;
    for (size_t i = 0; i < 512; ++i) sum += static_cast<unsigned char>(bytes[i]);
    bytes.replace(148, 6, absl::StrFormat("%06o", sum));
    return bytes;
  }

  std::string path_;
};

TEST_F(TarFileTest, ReadsWhatItWrites) {
  const std::string bytes = Write();
  EXPECT_EQ(bytes.size() % 512, 0u);
  const auto files = ReadTar(path_, kNoLimit);
  ASSERT_TRUE(files.ok()) << files.status();
  EXPECT_EQ(files->size(), 2u);
  EXPECT_EQ(files->at("folder/a.txt"), std::string(600, 'a'));
  EXPECT_EQ(files->at("folder/b.txt"), "");
  EXPECT_EQ(Write(), bytes) << "the archive depends on its files alone";
}

TEST_F(TarFileTest, OtherProgramsReadAndWriteIt) {
  Write();
  const std::string folder = path_ + ".d";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  const std::string command =
      absl::StrCat("cd '", folder, "' && tar -xf '", path_, "' && tar -cf '", path_, "' folder");
  ASSERT_EQ(std::system(command.c_str()), 0);
  const auto files = ReadTar(path_, kNoLimit);
  ASSERT_TRUE(files.ok()) << files.status();
  EXPECT_EQ(files->at("folder/a.txt"), std::string(600, 'a'));
}

TEST_F(TarFileTest, EveryTruncationIsAnError) {
  const std::string bytes = Write();
  // Without the second block of zeros the archive is complete.
  for (size_t size = 0; size < bytes.size() - 512; size += 64) {
    ASSERT_TRUE(WriteFile(path_, bytes.substr(0, size)).ok());
    EXPECT_FALSE(ReadTar(path_, kNoLimit).ok()) << size;
  }
  EXPECT_THAT(Error(bytes.substr(0, 700)), HasSubstr("byte 0: the archive ends within folder/a.txt"));
  EXPECT_THAT(Error(bytes.substr(0, 512 + 1024)), HasSubstr("no end mark"));
}

TEST_F(TarFileTest, EveryChangedByteOfAHeaderIsAnError) {
  const std::string bytes = Write();
  for (size_t i = 0; i < 512; ++i) {
    std::string changed = bytes;
    changed[i] = static_cast<char>(changed[i] ^ 1);
    // The last byte of the check sum is not part of it.
    if (i == 154 || i == 155) continue;
    ASSERT_TRUE(WriteFile(path_, changed).ok());
    EXPECT_FALSE(ReadTar(path_, kNoLimit).ok()) << i;
  }
}

TEST_F(TarFileTest, HostileMembers) {
  const std::string bytes = Write();
  for (const char* name :
       {"/etc/passwd", "../a.txt\0\0\0\0", "folder/../..", "./a", "folder//a.txt", "a b", "a\nb", ""}) {
    std::string field(name);
    field.resize(100, '\0');
    EXPECT_THAT(Error(WithField(bytes, 0, field)), HasSubstr("not a plain path")) << name;
  }
  EXPECT_THAT(Error(WithField(bytes, 345, "prefix")), HasSubstr("not a plain path"));
  for (const char* type : {"1", "2", "3", "6", "L", "x", "S"}) {
    EXPECT_THAT(Error(WithField(bytes, 156, type)), HasSubstr("is a link or another special member")) << type;
  }
  EXPECT_THAT(Error(WithField(bytes, 124, "77777777777")), HasSubstr("the archive ends within"));
  EXPECT_THAT(Error(WithField(bytes, 124, "-0000000010")), HasSubstr("invalid size"));
  EXPECT_THAT(Error(WithField(bytes, 124, "\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff")), HasSubstr("invalid size"));
  EXPECT_THAT(Error(WithField(bytes, 156, "5")), HasSubstr("invalid size")) << "a directory with contents";
  EXPECT_THAT(Error(WithField(bytes, 257, "other")), HasSubstr("no header"));
  const std::string twice = bytes.substr(0, 512 + 1024) + bytes;
  EXPECT_THAT(Error(twice), HasSubstr("occurs twice"));
}

TEST_F(TarFileTest, Limits) {
  const std::string bytes = Write();
  EXPECT_TRUE(absl::IsInvalidArgument(ReadTar(path_, bytes.size() - 1).status()));
  EXPECT_TRUE(absl::IsNotFound(ReadTar(path_ + ".none", kNoLimit).status()));
  auto writer = TarWriter::Create(path_ + ".long");
  ASSERT_TRUE(writer.ok());
  writer->Add(std::string(100, 'n'), "");
  EXPECT_TRUE(absl::IsInvalidArgument(writer->Commit()));
  EXPECT_FALSE(std::filesystem::exists(path_ + ".long"));
  EXPECT_FALSE(TarWriter::Create(path_ + ".none/a.tar").ok());
}

}  // namespace
}  // namespace evpose::client
