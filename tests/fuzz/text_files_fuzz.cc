// SPDX-License-Identifier: Apache-2.0

// Fuzz target for the text files of users (camera, sensor profile, trajectory) and for a pose as an argument. Accepted
// values are valid, and writing and reading them again gives the same values.
#include "core/camera_files/camera_file.h"
#include "core/estimation/sensor_profile.h"
#include "core/geometry/trajectory.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

// Each format that has the lens gives the same camera back.
void TryCamera(const std::string& text) {
  const auto camera = ParseCameraModel(text, "camera");
  if (!camera.ok()) return;
  EVPOSE_FUZZ_REQUIRE(camera->Validate().ok());
  for (const CameraFormat format :
       {CameraFormat::kRos, CameraFormat::kKalibr, CameraFormat::kMetavision, CameraFormat::kOpenCv}) {
    const auto written = FormatCamera(*camera, format);
    EVPOSE_FUZZ_REQUIRE(written.ok() || format == CameraFormat::kKalibr || format == CameraFormat::kMetavision);
    if (!written.ok()) continue;
    const auto again = ParseCameraModel(*written, "written");
    EVPOSE_FUZZ_REQUIRE(again.ok() && *again == *camera);
  }
}

void TrySensorProfile(const std::string& text) {
  const auto profile = ParseSensorProfile(text, "sensor.yaml");
  if (!profile.ok()) return;
  EVPOSE_FUZZ_REQUIRE(profile->Validate().ok());
  const auto again = ParseSensorProfile(SensorProfileToYaml(*profile), "written.yaml");
  EVPOSE_FUZZ_REQUIRE(again.ok() && *again == *profile);
}

void TryTrajectory(const std::string& text) {
  const auto trajectory = ParseTumTrajectory(text, "poses.tum");
  if (!trajectory.ok()) return;
  std::string written;
  for (const StampedPose& pose : *trajectory) written += TumLine(pose) + "\n";
  const auto again = ParseTumTrajectory(written, "written.tum");
  EVPOSE_FUZZ_REQUIRE(again.ok() && again->size() == trajectory->size());
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  FuzzInput input(data, size);
  switch (input.Choice(4)) {
    case 0:
      TryCamera(input.RestAsText());
      break;
    case 1:
      TrySensorProfile(input.RestAsText());
      break;
    case 2:
      TryTrajectory(input.RestAsText());
      break;
    default:
      (void)ParsePose(input.RestAsText());
  }
  return 0;
}
