// SPDX-License-Identifier: Apache-2.0

// Tests evpose info on recordings from other sources.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "absl/strings/str_format.h"
#include "tests/data/test_data.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

struct Recording {
  const char* folder;
  const char* file;
  const char* format;
};

class InfoTest : public CliTest, public ::testing::WithParamInterface<Recording> {};

TEST_P(InfoTest, CountsAndDigestAreTheExpectedOnes) {
  const std::string folder = FindTestData(GetParam().folder);
  if (folder.empty()) GTEST_SKIP() << GetParam().folder << " is not in the test data";
  const nlohmann::json expected = nlohmann::json::parse(std::ifstream(folder + "/expected.json"));
  const CliResult result = Run({"info", folder + "/" + GetParam().file, "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json info = result.Json();
  EXPECT_EQ(info["format"], GetParam().format);
  EXPECT_EQ(info["cd_events"], expected["cd_events"]);
  EXPECT_EQ(info["on_events"], expected["on"]);
  EXPECT_EQ(info["off_events"], expected["off"]);
  EXPECT_EQ(info["triggers"], expected["ext_triggers"]);
  EXPECT_EQ(info["t_first_us"], expected["t_first_us"]);
  EXPECT_EQ(info["t_last_us"], expected["t_last_us"]);
  EXPECT_EQ(info["sha256"], expected["sha256_of_packed_t_u64le_x_u16le_y_u16le_p_u8"]);
}

INSTANTIATE_TEST_SUITE_P(TestData, InfoTest,
                         ::testing::Values(Recording{"dat_atis_crop", "dat_sample.dat", "DAT"},
                                           Recording{"evt21_vendor_testbench", "tc_001_in.raw", "EVT2.1"},
                                           Recording{"evt2_sparklers_gen3", "evt2.raw", "EVT2"},
                                           Recording{"evt3_driving_gen41", "evt3_sample.raw", "EVT3"},
                                           Recording{"evt3_trigger_vga_640x480", "evt3_trigger_vga.raw", "EVT3"},
                                           Recording{"evt3_trigger_vga_first_200", "evt3_trigger_vga.raw", "EVT3"}),
                         [](const auto& test) { return std::string(test.param.folder); });

using InfoOfSimulationTest = CliTest;

TEST_F(InfoOfSimulationTest, DescribesASimulatedRecording) {
  const CliResult simulation =
      Run({"simulate", "--camera", "vga", "--duration", "0.05", "--start", "1", "--out", Path("cube"), "--json"});
  ASSERT_EQ(simulation.status, 0) << simulation.err;
  const CliResult info = Run({"info", Path("cube/recording.raw"), "--json"});
  ASSERT_EQ(info.status, 0) << info.err;
  EXPECT_EQ(info.Json()["cd_events"], simulation.Json()["events"]);
  EXPECT_EQ(info.Json()["format"], "EVT3");
  EXPECT_EQ(info.Json()["width"], 640);
  EXPECT_EQ(info.Json()["height"], 480);
  EXPECT_EQ(info.Json()["invalid_words"], 0);
  EXPECT_EQ(info.Json()["dropped_events"], 0);
  EXPECT_GE(info.Json()["t_first_us"], 1'000'000);
  EXPECT_LT(info.Json()["t_last_us"], 1'050'000);
  const CliResult text = Run({"info", Path("cube/recording.raw")});
  EXPECT_THAT(text.out, HasSubstr("EVT3 640x480"));
  const std::string zero = "\nzero       times count from the sensor's start; Metavision's zero is at ";
  EXPECT_THAT(text.out, HasSubstr(zero));
  ASSERT_EQ(Run({"convert", Path("cube/recording.raw"), Path("cube/recording.csv")}).status, 0);
  EXPECT_THAT(Run({"info", Path("cube/recording.csv")}).out, ::testing::Not(HasSubstr("zero ")));
  EXPECT_THAT(text.out, HasSubstr("sha256     " + info.Json()["sha256"].get<std::string>()));
}

// The packets of a bag contain the camera's words. As in a RAW file, the first time word is the zero of Metavision.
TEST_F(InfoOfSimulationTest, ABagOfPacketsHasTheZeroOfItsFirstTimeWord) {
  const std::string bag = FindTestData("evt3_packets_first_3/packets.db3");
  const nlohmann::json info = Run({"info", bag, "--json"}).Json();
  const int64_t zero_us = info["metavision_zero_us"];
  const int64_t first_us = info["t_first_us"];
  EXPECT_EQ(zero_us % 4096, 0);  // the time of a TIME_HIGH
  EXPECT_GT(zero_us, 0);
  EXPECT_LE(zero_us, first_us);
  EXPECT_EQ(info["t_first_metavision_us"], first_us - zero_us);
  EXPECT_THAT(Run({"info", bag}).out,
              HasSubstr(absl::StrFormat("\nzero       times count from the sensor's start; Metavision's zero, in a RAW "
                                        "file of these packets, is at %.6f s, its first event at %.6f s\n",
                                        zero_us * 1e-6, (first_us - zero_us) * 1e-6)));
  // The message of this format states the time of each event.
  EXPECT_THAT(Run({"info", FindTestData("containers/event_arrays.db3")}).out, ::testing::Not(HasSubstr("\nzero ")));
}

TEST_F(InfoOfSimulationTest, SameSeedSameBytes) {
  const auto digest = [&](const std::string& seed) {
    EXPECT_EQ(Run({"simulate", "--camera", "vga", "--duration", "0.02", "--seed", seed, "--out", Path("cube")}).status,
              0);
    return Run({"info", Path("cube/recording.raw"), "--json"}).Json()["sha256"];
  };
  const nlohmann::json first = digest("7");
  EXPECT_EQ(digest("7"), first);
  EXPECT_NE(digest("8"), first);
}

}  // namespace
}  // namespace evpose
