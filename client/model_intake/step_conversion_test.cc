// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/step_conversion.h"

#include <sys/stat.h>

#include <fstream>
#include <string>

#include "core/base/temporary_directory_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace evpose::client {
namespace {

class RunConverterTest : public testing::Test {
 protected:
  // Runs a program in place of evpose-convert-step.
  absl::StatusOr<ConvertedModel> Run(const std::string& commands) {
    const std::string path = directory_.File("evpose-convert-step");
    std::ofstream(path) << "#!/bin/sh\n" << commands << "\n";
    chmod(path.c_str(), 0700);
    return RunConverter(path, "part of a machine.step");
  }

  const TemporaryDirectory directory_;
};

TEST_F(RunConverterTest, ReturnsWhatTheProgramPrints) {
  const auto printed = Run("printf '%s\\n' \"$1\"; printf 'report\\nnotice: 1 face is missing\\n' >&2");
  ASSERT_TRUE(printed.ok()) << printed.status();
  EXPECT_EQ(printed->mesh, "part of a machine.step\n");
  EXPECT_THAT(printed->notices, testing::ElementsAre("1 face is missing"));
}

TEST_F(RunConverterTest, AFailureHasTheLastLineOfTheProgram) {
  const absl::Status status = Run("echo warning >&2; echo 'evpose-convert-step: has no face' >&2; exit 1").status();
  EXPECT_EQ(status, absl::InvalidArgumentError("has no face"));
}

TEST_F(RunConverterTest, ACrashAndAMissingProgramAreInternal) {
  EXPECT_THAT(std::string(Run("kill -SEGV $$").status().message()), testing::HasSubstr("was ended by signal 11"));
  EXPECT_EQ(RunConverter(directory_.File("none"), "a.step").status().code(), absl::StatusCode::kInternal);
}

}  // namespace
}  // namespace evpose::client
