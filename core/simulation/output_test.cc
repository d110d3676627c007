// SPDX-License-Identifier: Apache-2.0

// The files of a simulation, read by the readers of the project.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "core/base/output_file.h"
#include "core/camera_files/camera_file.h"
#include "core/recordings/recording_reader.h"
#include "core/simulation/simulate_testing.h"
#include "core/simulation/simulator.h"

namespace evpose {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// An empty directory for the running test.
fs::path TestDirectory() {
  const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
  const fs::path path = fs::path(::testing::TempDir()) / (std::string("evpose_simulation_") + info->name());
  fs::remove_all(path);
  fs::create_directories(path);
  return path;
}

// 60 ms of a small scene, with the wrap of EVT3's clock.
SimulationOptions AcrossTheWrap() {
  SimulationOptions options = *SimulationPreset("cube", "vga", 2.0);
  options.duration_us = 60'000;
  options.t_begin_us = (1 << 24) - 30'000;
  return options;
}

struct Decoded {
  std::vector<Event> events;
  DecodeCounts counts;
};

Decoded Decode(const fs::path& path) {
  const auto reader = RecordingReader::Open(path.string());
  EXPECT_TRUE(reader.ok()) << reader.status();
  if (!reader.ok()) return {};
  const auto decoder = *MakeEventDecoder((*reader)->header().encoding, (*reader)->header().geometry);
  DecodedEvents out;
  std::vector<uint8_t> buffer(1 << 16);
  while (const size_t size = (*reader)->Read(absl::MakeSpan(buffer)).value_or(0)) {
    decoder->Decode(absl::MakeConstSpan(buffer.data(), size), out);
  }
  return {{out.events.begin(), out.events.end()}, decoder->counts()};
}

TEST(SimulateToDirectoryTest, RecordingDecodesToTheSimulatedEventsAcrossTheClocksWrap) {
  const fs::path directory = TestDirectory() / "made" / "when missing";
  const SimulationOptions options = AcrossTheWrap();
  const auto report = SimulateToDirectory(options, directory.string());
  ASSERT_TRUE(report.ok()) << report.status();
  const std::vector<Event> simulated = SimulatedEvents(options);
  const Decoded decoded = Decode(directory / "recording.raw");
  ASSERT_GT(simulated.size(), 1000u);
  EXPECT_LT(simulated.front().t_us, 1 << 24);
  EXPECT_GT(simulated.back().t_us, 1 << 24);
  EXPECT_EQ(decoded.events, simulated);
  EXPECT_EQ(decoded.counts.clock_wraps, 1u);
  EXPECT_EQ(decoded.counts.dropped_events(), 0u);
  EXPECT_EQ(decoded.counts.invalid_words(), 0u);
  EXPECT_EQ(report->events, simulated.size());
}

TEST(SimulateToDirectoryTest, TruthModelAndCameraReadBackAsSimulated) {
  const fs::path directory = TestDirectory();
  for (const std::string& name : SimulatedObjectNames()) {
    SimulationOptions options = *SimulationPreset(name, "vga");
    options.duration_us = 5000;
    const auto report = SimulateToDirectory(options, directory.string());  // replaces the files of the last iteration
    ASSERT_TRUE(report.ok()) << report.status();

    const auto truth = ReadTumTrajectory((directory / "truth.tum").string());
    ASSERT_TRUE(truth.ok()) << truth.status();
    const Trajectory expected = SimulatedTruth(options);
    ASSERT_EQ(truth->size(), 6u);
    EXPECT_EQ(truth->front().t_us, options.t_begin_us);
    EXPECT_EQ((*truth)[3].camera_from_object.translation_m, expected[3].camera_from_object.translation_m);

    const auto camera = LoadCameraModel((directory / "camera.yaml").string());
    ASSERT_TRUE(camera.ok()) << camera.status();
    EXPECT_EQ(camera->width_px, options.camera.width_px);
    EXPECT_EQ(camera->fx_px, options.camera.fx_px);
    EXPECT_EQ(camera->distortion, options.camera.distortion);

    const auto model = LoadObjectModel((directory / "model.obj").string());
    ASSERT_TRUE(model.ok()) << model.status();
    const ObjectModel made = *SimulatedModel(options);
    EXPECT_EQ(model->triangles.size(), made.triangles.size()) << name;
    EXPECT_NEAR(model->diameter_m, made.diameter_m, 1e-6) << name;
    ASSERT_EQ(model->lines.size(), made.lines.size()) << name << ": " << ::testing::PrintToString(model->notices);
    for (const ModelLine& line : model->lines) EXPECT_FALSE(line.face_normals.empty()) << name;
  }
}

TEST(SimulateToDirectoryTest, DefaultRecordingContainsTheWrap) {
  const SimulationOptions options;
  EXPECT_LT(options.t_begin_us, 1 << 24);
  EXPECT_GT(options.t_begin_us + options.duration_us, 1 << 24);
}

TEST(SimulateToDirectoryTest, WritesNothingForInvalidOptions) {
  const fs::path directory = TestDirectory() / "new";
  SimulationOptions options = AcrossTheWrap();
  options.sensor.threshold_off = -1.0;
  EXPECT_EQ(SimulateToDirectory(options, directory.string()).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_FALSE(fs::exists(directory));
}

TEST(SimulateToDirectoryTest, NamesADirectoryThatCannotBeCreated) {
  const fs::path file = TestDirectory() / "file";
  std::ofstream(file) << "in the way";
  const auto report = SimulateToDirectory(AcrossTheWrap(), (file / "inside").string());
  EXPECT_FALSE(report.ok());
  EXPECT_THAT(std::string(report.status().message()), HasSubstr((file / "inside").string()));
  EXPECT_FALSE(SimulateToDirectory(AcrossTheWrap(), file.string()).ok());
  EXPECT_EQ(*ReadFile(file.string(), 100), "in the way");
}

TEST(SimulateToDirectoryTest, KeepsOldFilesWhenOneCannotBeReplaced) {
  const fs::path directory = TestDirectory();
  std::ofstream(directory / "recording.raw") << "old";
  fs::create_directories(directory / "truth.tum" / "a directory in the way");
  const auto report = SimulateToDirectory(AcrossTheWrap(), directory.string());
  ASSERT_FALSE(report.ok());
  EXPECT_THAT(std::string(report.status().message()), HasSubstr("truth.tum"));
  EXPECT_EQ(*ReadFile((directory / "recording.raw").string(), 100), "old");
  size_t entries = 0;
  for (const auto& entry : fs::directory_iterator(directory)) entries += entry.exists() ? 1 : 0;
  EXPECT_EQ(entries, 2u);  // no temporary files
}

}  // namespace
}  // namespace evpose
