// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/sensor_profile.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <limits>
#include <string>

namespace evpose {
namespace {

using ::testing::HasSubstr;

constexpr char kYaml[] = R"(name: lab
pixel_noise_px: 0.6
blur_px: 0.7
contrast_threshold: 0.2
refractory_us: 90
latency_us: 120
uncertainty: 0.3
)";

std::string ErrorOf(const std::string& yaml) {
  const auto profile = ParseSensorProfile(yaml, "my.yaml");
  EXPECT_EQ(profile.status().code(), absl::StatusCode::kInvalidArgument) << yaml;
  EXPECT_THAT(std::string(profile.status().message()), HasSubstr("my.yaml: "));
  return std::string(profile.status().message());
}

TEST(SensorProfile, EveryFieldIsRead) {
  const auto profile = ParseSensorProfile(kYaml, "my.yaml");
  ASSERT_TRUE(profile.ok()) << profile.status();
  EXPECT_EQ(profile->name, "lab");
  EXPECT_EQ(profile->pixel_noise_px, 0.6);
  EXPECT_EQ(profile->blur_px, 0.7);
  EXPECT_EQ(profile->contrast_threshold, 0.2);
  EXPECT_EQ(profile->refractory_us, 90.0);
  EXPECT_EQ(profile->latency_us, 120.0);
  EXPECT_EQ(profile->uncertainty, 0.3);
}

TEST(SensorProfile, AnAbsentFieldHasTheDefault) {
  const auto profile = ParseSensorProfile("blur_px: 0.7\n", "my.yaml");
  ASSERT_TRUE(profile.ok()) << profile.status();
  SensorProfile expected;
  expected.blur_px = 0.7;
  EXPECT_EQ(*profile, expected);
}

TEST(SensorProfile, YamlRoundTripGivesTheSameBits) {
  const SensorProfile odd = {
      "a \"b\": \xc3\xbc\x01\n", 1.0 / 3.0, 0.1 + 0.2, 2.0 / 7.0, 1e3 / 7.0, -1e3 / 3.0, 2.0 / 3.0};
  const auto back = ParseSensorProfile(SensorProfileToYaml(odd), "p");
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(*back, odd);
}

TEST(SensorProfile, ErrorsNameFileAndField) {
  EXPECT_THAT(ErrorOf(""), HasSubstr("not a sensor profile"));
  EXPECT_THAT(ErrorOf("# nothing\n"), HasSubstr("contrast_threshold"));
  EXPECT_THAT(ErrorOf("just words"), HasSubstr("not a sensor profile"));
  EXPECT_THAT(ErrorOf("[1, 2]"), HasSubstr("not a sensor profile"));
  EXPECT_THAT(ErrorOf("blur_px: 0.7\nlatency_us: {"), HasSubstr("line "));
  EXPECT_THAT(ErrorOf("lag_px: 0.1"), HasSubstr("lag_px: is not a field"));
  EXPECT_THAT(ErrorOf("blur_px: wide"), HasSubstr("blur_px: is not a number"));
  EXPECT_THAT(ErrorOf("blur_px: [0.7]"), HasSubstr("blur_px: is not a number"));
  EXPECT_THAT(ErrorOf("blur_px:"), HasSubstr("blur_px: is not a number"));
  EXPECT_THAT(ErrorOf("name: {a: b}"), HasSubstr("name: must be a YAML scalar"));
  EXPECT_THAT(ErrorOf("name: \xcc\xf5\x8f"), HasSubstr("name must be text in UTF-8"));
  EXPECT_THAT(ErrorOf("blur_px: 50"), HasSubstr("blur_px is 50; it must lie in [0, 5]"));
  EXPECT_THAT(ErrorOf("contrast_threshold: 0"), HasSubstr("contrast_threshold is 0; it must lie in"));
  EXPECT_THAT(ErrorOf("pixel_noise_px: -1"), HasSubstr("pixel_noise_px is -1; it must lie in"));
  EXPECT_THAT(ErrorOf("latency_us: .nan"), HasSubstr("latency_us is nan; it must lie in"));
  EXPECT_THAT(ErrorOf("image_width: 1280\nimage_height: 720"), HasSubstr("image_width: is not a field"));
  EXPECT_THAT(ErrorOf("? [a, b]\n: 1\n"), HasSubstr("a key must be a YAML scalar"));
  EXPECT_THAT(ErrorOf(std::string(100'000, '#')), HasSubstr("larger than"));
}

TEST(SensorProfile, FilesThatCannotBeRead) {
  const auto missing = LoadSensorProfile("/does/not/exist.yaml");
  EXPECT_EQ(missing.status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(missing.status().message()), HasSubstr("/does/not/exist.yaml"));
  EXPECT_THAT(std::string(LoadSensorProfile(::testing::TempDir()).status().message()), HasSubstr("is a directory"));
}

TEST(SensorProfile, TheFileForTheEvk4IsTheDefault) {
  const auto shipped = LoadSensorProfile(EVPOSE_SOURCE_DIR "/deploy/sensors/evk4.yaml");
  ASSERT_TRUE(shipped.ok()) << shipped.status();
  EXPECT_EQ(*shipped, SensorProfile());
}

TEST(SensorProfile, ValidateNamesTheField) {
  SensorProfile profile;
  EXPECT_TRUE(profile.Validate().ok());
  profile.latency_us = std::numeric_limits<double>::infinity();
  EXPECT_THAT(std::string(profile.Validate().message()), HasSubstr("latency_us"));
}

}  // namespace
}  // namespace evpose
