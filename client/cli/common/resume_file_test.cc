// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/resume_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/base/byte_order.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class ResumeFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    record_.position.session = "sessions/1";
    record_.position.resume_token = "a secret";
    record_.position.previous_token = "an older one";
    record_.position.last_pose_seq = (uint64_t{1} << 60) + 1;
    record_.position.lost_poses = 3;
    record_.position.durable = {5, 600, 0xffffffffu};
    record_.position.max_piece_bytes = 262144;
    record_.arguments = {{"--camera", "camera.yaml"}, {"recording", "a.raw"}};
    record_.output_bytes = {{"", 12345}};
  }

  const TemporaryDirectory directory_;
  const std::string path_ = directory_.File("state");
  ResumeRecord record_;
};

TEST_F(ResumeFileTest, ReadsTheLastWrittenState) {
  {
    auto file = ResumeFile::Open(path_);
    ASSERT_TRUE(file.ok()) << file.status();
    EXPECT_FALSE(file->record());
    ASSERT_TRUE(file->Write(ResumeRecord()).ok());
    ASSERT_TRUE(file->Write(record_).ok());
    struct stat info;
    ASSERT_EQ(stat(path_.c_str(), &info), 0);
    EXPECT_EQ(info.st_mode & 0777, 0600u);
  }
  auto file = ResumeFile::Open(path_);
  ASSERT_TRUE(file.ok() && file->record()) << file.status();
  const ResumeRecord& read = *file->record();
  EXPECT_EQ(read.position.session, record_.position.session);
  EXPECT_EQ(read.position.resume_token, record_.position.resume_token);
  EXPECT_EQ(read.position.previous_token, record_.position.previous_token);
  EXPECT_EQ(read.position.last_pose_seq, record_.position.last_pose_seq);
  EXPECT_EQ(read.position.lost_poses, record_.position.lost_poses);
  EXPECT_EQ(read.position.durable, record_.position.durable);
  EXPECT_EQ(read.position.max_piece_bytes, record_.position.max_piece_bytes);
  EXPECT_EQ(read.arguments, record_.arguments);
  EXPECT_EQ(read.output_bytes, record_.output_bytes);
  file->Remove();
  EXPECT_TRUE(std::filesystem::is_empty(directory_.path()));
}

TEST_F(ResumeFileTest, OneProcessAtATime) {
  const auto first = ResumeFile::Open(path_);
  ASSERT_TRUE(first.ok());
  const auto second = ResumeFile::Open(path_);
  EXPECT_EQ(second.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(second.status().message(), HasSubstr(path_ + ": another evpose is using it: wait for its end"));
}

TEST_F(ResumeFileTest, TheEndOfASessionFreesTheNameForOneOther) {
  auto first = ResumeFile::Open(path_);
  ASSERT_TRUE(first.ok());
  first->Remove();  // the first one still has the lock of a file without a name
  const auto second = ResumeFile::Open(path_);
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ(ResumeFile::Open(path_).status().code(), absl::StatusCode::kFailedPrecondition);
}

TEST_F(ResumeFileTest, EveryChangedByteIsDetected) {
  const std::string text = record_.ToText();
  for (size_t i = 0; i + 1 < text.size(); ++i) {
    std::string damaged = text;
    damaged[i] = static_cast<char>(damaged[i] ^ 1);
    const auto record = ResumeRecord::FromText(damaged);
    EXPECT_FALSE(record.ok()) << i << ": " << damaged.substr(i, 10);
    EXPECT_THAT(record.status().message(), Not(HasSubstr("secret")));
  }
  EXPECT_FALSE(ResumeRecord::FromText(text.substr(0, text.size() / 2)).ok());
}

// The text of `record` with another value of a field, and with the checksum of that.
std::string WithField(const ResumeRecord& record, const std::string& pointer, const std::string& value) {
  using Json = nlohmann::ordered_json;
  Json json = Json::parse(record.ToText());
  json.erase("crc32c");
  json[Json::json_pointer(pointer)] = Json::parse(value);
  const std::string text = json.dump();
  json["crc32c"] = Crc32c(AsBytes(text));
  return json.dump();
}

TEST_F(ResumeFileTest, NumbersOutsideTheRangeAreNamed) {
  ASSERT_TRUE(ResumeRecord::FromText(WithField(record_, "/durable/seq", "7")).ok());
  const std::vector<std::pair<std::string, std::string>> fields = {{"/last_pose_seq", "last_pose_seq"},
                                                                   {"/lost_poses", "lost_poses"},
                                                                   {"/durable/seq", "seq"},
                                                                   {"/durable/bytes", "bytes"},
                                                                   {"/durable/digest", "digest"},
                                                                   {"/max_piece_bytes", "max_piece_bytes"},
                                                                   {"/output_bytes/a.tum", "output_bytes"},
                                                                   {"/evpose_resume", "evpose_resume"}};
  for (const auto& [pointer, name] : fields) {
    for (const char* value : {"1e300", "-1e300", "-1", "0.5", "18446744073709551616", "true", "\"1\"", "null"}) {
      ASSERT_TRUE(WriteFile(path_, WithField(record_, pointer, value)).ok());
      const auto file = ResumeFile::Open(path_);
      EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument) << pointer << " " << value;
      EXPECT_THAT(file.status().message(),
                  AllOf(HasSubstr(path_ + ": is damaged: " + name + " is not a whole number of at most "),
                        HasSubstr("remove the file")))
          << pointer << " " << value;
    }
  }
  EXPECT_THAT(ResumeRecord::FromText(WithField(record_, "/durable/digest", "4294967296")).status().message(),
              HasSubstr("digest is not a whole number of at most 4294967295"));
  EXPECT_THAT(ResumeRecord::FromText("{\"evpose_resume\": 1, \"crc32c\": 1e300}").status().message(),
              HasSubstr("crc32c is not a whole number of at most 4294967295"));
}

TEST_F(ResumeFileTest, FilesOfAnotherKindAreNamed) {
  for (const char* text : {"", "1 2 3\n", "{}", "[]"}) {
    ASSERT_TRUE(WriteFile(path_, text).ok());
    const auto file = ResumeFile::Open(path_);
    EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument) << text;
    // It may be any file of the user.
    EXPECT_EQ(file.status().message(), path_ + ": is not a file of --resume: give --resume the name of another file");
    EXPECT_FALSE(std::filesystem::exists(path_ + ".lock")) << text;
  }
  EXPECT_THAT(ResumeFile::Open(directory_.path()).status().message(), HasSubstr("is not a file of --resume"));
  EXPECT_FALSE(std::filesystem::exists(directory_.path() + ".lock"));
  for (const char* text : {"{\"evpose_resume\": 2}", "{\"evpose_resume\": \"1\"}"}) {
    ASSERT_TRUE(WriteFile(path_, text).ok());
    const auto file = ResumeFile::Open(path_);
    EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument) << text;
    EXPECT_THAT(file.status().message(), AllOf(HasSubstr(path_ + ": "), HasSubstr("a new session begins"))) << text;
  }
  EXPECT_EQ(ResumeFile::Open(directory_.File("no/such")).status().code(), absl::StatusCode::kNotFound);
}

TEST_F(ResumeFileTest, OtherArgumentsAreNamed) {
  ASSERT_TRUE(ResumeFile::Open(path_)->Write(record_).ok());
  const auto file = ResumeFile::Open(path_);
  ASSERT_TRUE(file.ok());
  EXPECT_TRUE(file->CheckArguments(record_.arguments).ok());
  EXPECT_THAT(file->CheckArguments({{"--camera", "other.yaml"}, {"recording", "a.raw"}}).message(),
              HasSubstr(path_ + ": was started with another --camera"));
  // A file of an earlier version names fewer options.
  EXPECT_TRUE(file->CheckArguments({{"--new-option", ""}}).ok());
  EXPECT_THAT(file->CheckArguments({{"--new-option", "1"}}).message(),
              HasSubstr("was started with another --new-option"));
}

}  // namespace
}  // namespace evpose::client
