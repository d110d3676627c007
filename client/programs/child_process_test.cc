// SPDX-License-Identifier: Apache-2.0
#include "client/programs/child_process.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "core/base/byte_order.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

std::unique_ptr<ChildProcess> Shell(const std::string& script) {
  return ChildProcess::Start("/bin/sh", {"-c", script}).value();
}

std::string ReadAll(ChildProcess& process) {
  std::string text;
  std::vector<uint8_t> buffer(1000);
  while (true) {
    const size_t count = process.Read(absl::MakeSpan(buffer)).value();
    if (count == 0) return text;
    text.append(buffer.begin(), buffer.begin() + static_cast<int64_t>(count));
  }
}

TEST(ChildProcessTest, ReadsMoreThanAPipeHolds) {
  const auto process = Shell("head -c 1000000 /dev/zero");
  EXPECT_EQ(ReadAll(*process).size(), 1'000'000u);
  EXPECT_TRUE(process->Wait().ok());
  EXPECT_TRUE(process->Wait().ok());
}

TEST(ChildProcessTest, WritesAndReads) {
  const auto process = Shell("read word; echo got $word");
  const std::string line = "hello\n";
  ASSERT_TRUE(process->Write(AsBytes(line)).ok());
  EXPECT_EQ(ReadAll(*process), "got hello\n");
  EXPECT_TRUE(process->Wait().ok());
}

TEST(ChildProcessTest, WaitEndsTheInput) {
  const auto process = Shell("cat >/dev/null");
  EXPECT_TRUE(process->Wait().ok());
}

TEST(ChildProcessTest, AFailureHasTheLastLineWithoutTheProgram) {
  const auto process = Shell("echo first >&2; echo 'sh: the file is damaged' >&2; echo >&2; exit 1");
  EXPECT_EQ(process->Wait(), absl::InvalidArgumentError("the file is damaged"));
}

TEST(ChildProcessTest, ACrashIsReported) {
  const auto process = Shell("kill -SEGV $$");
  EXPECT_EQ(ReadAll(*process), "");
  EXPECT_EQ(process->Wait(), absl::InternalError("sh was ended by signal 11"));
}

TEST(ChildProcessTest, WritingToAProgramThatFailedReportsItsError) {
  const auto process = Shell("echo 'no space' >&2; exit 1");
  const std::vector<uint8_t> bytes(1 << 20);
  absl::Status status;
  for (int i = 0; i < 100 && status.ok(); ++i) status = process->Write(bytes);
  EXPECT_EQ(status, absl::InvalidArgumentError("no space"));
}

TEST(ChildProcessTest, AMissingProgramIsAnError) {
  EXPECT_THAT(ChildProcess::Start("/nowhere/program", {}).status().message(),
              HasSubstr("/nowhere/program cannot be started"));
}

TEST(ChildProcessTest, TheDestructorEndsARunningProgram) {
  const auto process = Shell("exec cat");  // without an end of its input it would wait for ever
}

}  // namespace
}  // namespace evpose::client
