// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/lsd_detector.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>

#include "core/detection/moving_edges_testing.h"

namespace evpose {
namespace {

using testing::MakeEdgeEvents;
using testing::MovingEdge;

constexpr SensorGeometry kSensor = {640, 480};

TEST(LsdDetector, MeasuresTheMotionOfAnEdge) {
  for (const double angle : {0.2, 1.1, 2.0, 2.9}) {
    const Eigen::Vector2d along(std::cos(angle), std::sin(angle)), normal(-along.y(), along.x());
    const Eigen::Vector2d middle(320.0, 240.0);
    const MovingEdge edge = {middle - 80.0 * along, middle + 80.0 * along, 400.0 * normal};
    const auto detector = MakeLsdLineDetector({}, kSensor).value();
    const LineDetection detection = detector->Detect(MakeEdgeEvents({edge}, {}));
    ASSERT_FALSE(detection.lines.empty()) << angle;
    const DetectedLine& line = detection.lines[0];
    const ImageSegment truth = edge.At(1e-6 * static_cast<double>(detection.t_end_us - 1'000'000));
    const Eigen::Vector2d way = (line.at_end.p2_px - line.at_end.p1_px).normalized();
    EXPECT_LT(std::abs(way.dot(normal)), 0.035);
    EXPECT_LT(std::abs(normal.dot(0.5 * (line.at_end.p1_px + line.at_end.p2_px) - truth.p1_px)), 0.6);
    EXPECT_NEAR(line.normal_velocity_px_per_s, way.dot(along) > 0.0 ? 400.0 : -400.0, 60.0);
    EXPECT_GT(line.at_end.length_px(), 80.0);
  }
}

TEST(LsdDetector, NoEdgeNoLine) {
  const auto detector = MakeLsdLineDetector({}, kSensor).value();
  EXPECT_TRUE(detector->Detect({}).lines.empty());
  EXPECT_TRUE(detector->Detect({{5, 100.0f, 100.0f, 1}}).lines.empty());
  const float nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(detector->Detect({{5, nan, nan, 1}, {6, 1e30f, 0.0f, 1}}).lines.empty());
  std::vector<PixelEvent> flood;
  for (int k = 0; k < 50'000; ++k) flood.push_back({1000 + k / 4, 300.0f, 200.0f, static_cast<uint8_t>(k % 2)});
  EXPECT_TRUE(detector->Detect(flood).lines.empty());
}

TEST(LsdDetector, RejectsInvalidOptions) {
  const auto message = [](auto change) {
    LsdDetectorOptions options;
    change(options);
    return std::string(MakeLsdLineDetector(options, kSensor).status().message());
  };
  EXPECT_NE(message([](auto& o) { o.stretch.motion_px = 0.0; }).find("motion_px"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.white_events = 0; }).find("white_events"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.blur_px = -1.0; }).find("blur_px"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.gate_px = 0.0; }).find("gate_px"), std::string::npos);
  EXPECT_FALSE(MakeLsdLineDetector({}, {640, 0}).ok());
}

}  // namespace
}  // namespace evpose
