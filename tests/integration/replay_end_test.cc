// SPDX-License-Identifier: Apache-2.0

// The pose files and the exit status of a replay without a pose, or after an interrupt.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

class ReplayEndTest : public CliTest {};

TEST_F(ReplayEndTest, WithoutAPoseAnEarlierFileStays) {
  SimulateCube(0.001);
  WriteText("poses.tum", "earlier\n");
  std::vector<std::string> arguments = SearchArguments("poses.tum");
  const CliResult json = Run(arguments);
  EXPECT_EQ(json.status, 1);
  EXPECT_THAT(json.err,
              HasSubstr("no pose was found; the report has the reason; earlier pose files stay as they were"));
  EXPECT_EQ(json.Json()["files"], nlohmann::json::array());
  std::erase(arguments, "--json");
  EXPECT_THAT(Run(arguments).out,
              HasSubstr("poses.tum: not written, because there is no pose for it; the earlier file"));
  EXPECT_EQ(ReadText("poses.tum"), "earlier\n");
  EXPECT_EQ(FilesBeginning("poses.tum").size(), 1u) << "no temporary file";

  EXPECT_EQ(Run(SearchArguments("first.tum")).status, 1);
  EXPECT_TRUE(std::filesystem::exists(Path("first.tum"))) << "without an earlier file, an empty one is written";
}

}  // namespace
}  // namespace evpose
