// SPDX-License-Identifier: Apache-2.0

// Detection of edges with exact motion, and input without edges.
#include "core/detection/plane_detector.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "core/detection/moving_edges_testing.h"

namespace evpose {
namespace {

using testing::EdgeEventOptions;
using testing::MakeEdgeEvents;
using testing::MovingEdge;

constexpr SensorGeometry kSensor = {640, 480};

LineDetection DetectLines(const std::vector<PixelEvent>& events, const PlaneDetectorOptions& options = {}) {
  return MakePlaneLineDetector(options, kSensor).value()->Detect(events);
}

double Distance(const ImageSegment& line, const Eigen::Vector2d& point) {
  const Eigen::Vector2d d = (line.p2_px - line.p1_px) / line.length_px(), r = point - line.p1_px;
  return std::abs(d.x() * r.y() - d.y() * r.x());
}

// Expects both ends within these distances of the true ones, across the line and along it.
void ExpectSegment(const ImageSegment& found, const ImageSegment& truth, double across_px, double along_px) {
  const bool same_way = (found.p2_px - found.p1_px).dot(truth.p2_px - truth.p1_px) > 0.0;
  const Eigen::Vector2d p1 = same_way ? found.p1_px : found.p2_px, p2 = same_way ? found.p2_px : found.p1_px;
  EXPECT_LT(Distance(truth, p1), across_px);
  EXPECT_LT(Distance(truth, p2), across_px);
  EXPECT_LT((p1 - truth.p1_px).norm(), along_px);
  EXPECT_LT((p2 - truth.p2_px).norm(), along_px);
}

void ExpectEdge(const LineDetection& detection, const DetectedLine& line, const MovingEdge& edge,
                const EdgeEventOptions& options, double across_px = 0.3, double along_px = 2.5) {
  const auto seconds = [&options](int64_t t_us) { return 1e-6 * static_cast<double>(t_us - options.t_begin_us); };
  ExpectSegment(line.at_begin, edge.At(seconds(detection.t_begin_us)), across_px, along_px);
  ExpectSegment(line.at_end, edge.At(seconds(detection.t_end_us)), across_px, along_px);
}

class OneEdge : public ::testing::TestWithParam<double> {};

TEST_P(OneEdge, IsFoundAtBothEndsOfTheStretch) {
  const double angle = GetParam();
  const Eigen::Vector2d along(std::cos(angle), std::sin(angle)), normal(-along.y(), along.x());
  const MovingEdge edge = {Eigen::Vector2d(320.0, 240.0) - 80.0 * along, Eigen::Vector2d(320.0, 240.0) + 80.0 * along,
                           400.0 * normal + 60.0 * along};
  const EdgeEventOptions options;
  const std::vector<PixelEvent> events = MakeEdgeEvents({edge}, options);
  const LineDetection detection = DetectLines(events);
  ASSERT_EQ(detection.lines.size(), 1u);
  const DetectedLine& line = detection.lines[0];
  ExpectEdge(detection, line, edge, options);
  const Eigen::Vector2d way = line.at_end.p2_px - line.at_end.p1_px;
  EXPECT_NEAR(line.normal_velocity_px_per_s, way.dot(along) > 0.0 ? 400.0 : -400.0, 12.0);
  EXPECT_NEAR(line.rms_px, options.noise_px, 0.05);
  const double swept = 160.0 * 400.0 * 1e-6 * static_cast<double>(detection.t_end_us - detection.t_begin_us);
  EXPECT_NEAR(line.num_events, options.events_per_px2 * swept, 0.1 * options.events_per_px2 * swept);
  EXPECT_EQ(detection.t_end_us, events.back().t_us);
}

INSTANTIATE_TEST_SUITE_P(Angles, OneEdge, ::testing::Values(0.0, 0.3, 0.785398, 1.2, 1.570796, 2.2, 2.9, 3.5, 5.0),
                         [](const auto& angle) { return "MilliRad" + std::to_string(std::lround(angle.param * 1e3)); });

TEST(PlaneDetector, FollowsARotatingEdge) {
  const MovingEdge edge = {{200.0, 150.0}, {440.0, 250.0}, {50.0, 300.0}, 1.5};
  const EdgeEventOptions options;
  const LineDetection detection = DetectLines(MakeEdgeEvents({edge}, options));
  ASSERT_EQ(detection.lines.size(), 1u);
  ExpectEdge(detection, detection.lines[0], edge, options, 0.3, 4.0);
}

TEST(PlaneDetector, FindsAStoppedEdgeAtItsPosition) {
  const MovingEdge stopping = {{200.0, 100.0}, {200.0, 300.0}, {300.0, 0.0}, 0.0, 1, 0.02};
  const MovingEdge going = {{400.0, 100.0}, {420.0, 300.0}, {300.0, 0.0}};
  const EdgeEventOptions options = {.duration_s = 0.03};
  PlaneDetectorOptions detector;
  detector.stretch.motion_px = 9.0;  // the stretch has the whole duration of 0.03 s
  const LineDetection detection = DetectLines(MakeEdgeEvents({stopping, going}, options), detector);
  ASSERT_EQ(detection.lines.size(), 2u);
  for (const DetectedLine& line : detection.lines) {
    const bool stopped = line.at_end.p1_px.x() < 300.0;
    ExpectEdge(detection, line, stopped ? stopping : going, options, stopped ? 1.2 : 0.3);
  }
}

TEST(PlaneDetector, SeparatesCloseEdges) {
  const MovingEdge first = {{200.0, 100.0}, {200.0, 300.0}, {300.0, 30.0}};
  for (const uint8_t polarity : {0, 1}) {
    const MovingEdge second = {{208.0, 100.0}, {208.0, 300.0}, {300.0, 30.0}, 0.0, polarity};
    const LineDetection detection = DetectLines(MakeEdgeEvents({first, second}, {}));
    ASSERT_EQ(detection.lines.size(), 2u) << int{polarity};
    for (const DetectedLine& line : detection.lines) {
      const bool is_first = Distance(line.at_end, first.At(0.03).p1_px) < 4.0;
      ExpectEdge(detection, line, is_first ? first : second, {});
    }
  }
}

// The grooves of a puzzle cube, 50 px wide, that turns slowly: lines of 25 px with distances of 5 px, a third noise.
class SmallSlowObject : public ::testing::Test {
 protected:
  static constexpr SensorGeometry kSmallSensor = {128, 128};
  static constexpr int kLines = 6;

  static MovingEdge Edge(int i) {
    const Eigen::Vector2d from(45.0 + 5.0 * i, 50.0), along(4.0, 24.0);
    return {from, from + along, {6.0, 0.0}, 0.0, static_cast<uint8_t>(i % 2)};
  }
  // The number of edges of which a line is found.
  static int NumFound(const PlaneDetectorOptions& options) {
    std::vector<MovingEdge> edges;
    for (int i = 0; i < kLines; ++i) edges.push_back(Edge(i));
    const EdgeEventOptions events = {.duration_s = 0.6,
                                     .events_per_px2 = 2.0,
                                     .noise_px = 0.5,
                                     .clutter_per_px2 = 0.04,
                                     .width_px = 128,
                                     .height_px = 128};
    const LineDetection detection =
        MakePlaneLineDetector(options, kSmallSensor).value()->Detect(MakeEdgeEvents(edges, events));
    int found = 0;
    for (int i = 0; i < kLines; ++i) {
      const ImageSegment truth = Edge(i).At(1e-6 * static_cast<double>(detection.t_end_us - events.t_begin_us));
      found += std::any_of(detection.lines.begin(), detection.lines.end(), [&](const DetectedLine& line) {
        return Distance(truth, line.at_end.p1_px) < 1.0 && Distance(truth, line.at_end.p2_px) < 1.0;
      });
    }
    return found;
  }
};

TEST_F(SmallSlowObject, HasItsLinesFoundAtTheScaleOfItsSensor) {
  EXPECT_GE(NumFound(PlaneDetectorOptions::ForSensor(kSmallSensor)), kLines - 1);
}

TEST_F(SmallSlowObject, IsNotFoundWithinTheTimeOfFastObjects) {
  PlaneDetectorOptions options = PlaneDetectorOptions::ForSensor(kSmallSensor);
  options.stretch.max_slow_duration_us = options.stretch.max_duration_us;
  EXPECT_LE(NumFound(options), kLines / 2);
}

TEST(PlaneDetectorOptions, ScaleWithTheWidthOfTheSensorWithinBounds) {
  const PlaneDetectorOptions full;
  for (const int width : {640, 1280}) {
    const PlaneDetectorOptions options = PlaneDetectorOptions::ForSensor({width, 480});
    EXPECT_EQ(options.lines.min_length_px, full.lines.min_length_px);
    EXPECT_EQ(options.segmentation.max_curvature, full.segmentation.max_curvature);
  }
  for (const auto& [width, scale] : {std::pair{480, 0.75}, {320, 0.5}, {128, 0.5}, {1, 0.5}}) {
    const PlaneDetectorOptions options = PlaneDetectorOptions::ForSensor({width, 120});
    EXPECT_NEAR(options.lines.min_length_px, scale * full.lines.min_length_px, 1e-9);
    EXPECT_NEAR(options.stretch.motion_px, scale * full.stretch.motion_px, 1e-9);
    EXPECT_GE(options.lines.fit.gate_px, 2.0);
    EXPECT_TRUE(options.Validate().ok()) << options.Validate();
  }
}

TEST(PlaneDetector, MergesTheTwoSidesOfAStripe) {
  const MovingEdge left = {{200.0, 100.0}, {230.0, 300.0}, {300.0, 30.0}, 0.0, 1};
  const MovingEdge right = {{203.0, 100.0}, {233.0, 300.0}, {300.0, 30.0}, 0.0, 0};
  const MovingEdge middle = {{201.5, 100.0}, {231.5, 300.0}, {300.0, 30.0}};
  const LineDetection detection = DetectLines(MakeEdgeEvents({left, right}, {}));
  ASSERT_EQ(detection.lines.size(), 1u);
  ExpectEdge(detection, detection.lines[0], middle, {});
}

TEST(PlaneDetector, MergesAnEdgeAcrossAReversalOfContrast) {
  const MovingEdge bright = {{150.0, 100.0}, {250.0, 140.0}, {-60.0, 300.0}, 0.0, 1};
  const MovingEdge dark = {{250.0, 140.0}, {350.0, 180.0}, {-60.0, 300.0}, 0.0, 0};
  const MovingEdge whole = {{150.0, 100.0}, {350.0, 180.0}, {-60.0, 300.0}};
  const LineDetection detection = DetectLines(MakeEdgeEvents({bright, dark}, {}));
  ASSERT_EQ(detection.lines.size(), 1u);
  ExpectEdge(detection, detection.lines[0], whole, {});
}

TEST(PlaneDetector, SplitsWhereAnEdgeBends) {
  const Eigen::Vector2d corner(320.0, 200.0), velocity(20.0, 350.0);
  for (const double bend_deg : {6.0, 10.0, 25.0, 60.0}) {
    const double bend = bend_deg / 57.29578;
    const MovingEdge first = {corner - Eigen::Vector2d(120.0, 0.0), corner, velocity};
    const MovingEdge second = {corner, corner + 120.0 * Eigen::Vector2d(std::cos(bend), std::sin(bend)), velocity};
    const LineDetection detection = DetectLines(MakeEdgeEvents({first, second}, {}));
    ASSERT_EQ(detection.lines.size(), 2u) << bend_deg;
    for (const DetectedLine& line : detection.lines) {
      const bool is_first = std::min(line.at_end.p1_px.x(), line.at_end.p2_px.x()) < 250.0;
      // At a small angle the gates of both lines overlap over a long distance, so that the corner is less accurate.
      const double along_px = bend_deg < 20.0 ? 20.0 : 3.0;
      ExpectEdge(detection, line, is_first ? first : second, {}, 0.8, along_px);
    }
  }
}

TEST(PlaneDetector, IsolatedEventsDoNotLengthenALine) {
  const MovingEdge edge = {{200.0, 200.0}, {320.0, 210.0}, {0.0, 300.0}};
  std::vector<PixelEvent> events = MakeEdgeEvents({edge}, {});
  for (PixelEvent& event : events) {  // some of the noise is moved onto the line, beyond its end
    if (event.u_px > 500.0f && event.u_px < 530.0f) {
      const double t = 1e-6 * static_cast<double>(event.t_us - 1'000'000);
      const double share = (event.u_px - 500.0) / 120.0 + 1.03;
      const ImageSegment now = edge.At(t);
      const Eigen::Vector2d point = now.p1_px + share * (now.p2_px - now.p1_px);
      event.u_px = static_cast<float>(point.x());
      event.v_px = static_cast<float>(point.y());
      event.polarity = 1;
    }
  }
  const LineDetection detection = DetectLines(events);
  ASSERT_EQ(detection.lines.size(), 1u);
  ExpectEdge(detection, detection.lines[0], edge, {}, 0.3, 3.0);
}

TEST(PlaneDetector, FindsAnEdgeInDenseClutter) {
  const MovingEdge edge = {{150.0, 100.0}, {400.0, 330.0}, {250.0, -250.0}};
  const EdgeEventOptions options = {.events_per_px2 = 3.0, .clutter_per_px2 = 0.5};
  const std::vector<PixelEvent> events = MakeEdgeEvents({edge}, options);
  ASSERT_GT(events.size(), 150'000u);  // about one in ten is an event of the edge
  const LineDetection detection = DetectLines(events);
  ASSERT_FALSE(detection.lines.empty());
  const DetectedLine& line = detection.lines[0];
  const ImageSegment truth = edge.At(1e-6 * static_cast<double>(detection.t_end_us - options.t_begin_us));
  EXPECT_LT(Distance(truth, line.at_end.p1_px), 1.0);
  EXPECT_LT(Distance(truth, line.at_end.p2_px), 1.0);
  EXPECT_GT(line.at_end.length_px(), 0.5 * truth.length_px());
}

TEST(PlaneDetector, LinesEndInTheirCommonCorners) {
  const Eigen::Vector2d velocity(260.0, 220.0);
  const Eigen::Vector2d a(200.0, 150.0), b(330.0, 190.0), c(250.0, 300.0);
  const std::vector<MovingEdge> edges = {{a, b, velocity}, {b, c, velocity}, {c, a, velocity}};
  const EdgeEventOptions options = {.duration_s = 0.03, .events_per_px2 = 1.0};
  const LineDetection detection = DetectLines(MakeEdgeEvents(edges, options));
  ASSERT_EQ(detection.lines.size(), 3u);
  for (const MovingEdge& edge : edges) {
    const auto best = std::min_element(
        detection.lines.begin(), detection.lines.end(), [&edge](const DetectedLine& x, const DetectedLine& y) {
          const Eigen::Vector2d middle = 0.5 * (edge.At(0.03).p1_px + edge.At(0.03).p2_px);
          return Distance(x.at_end, middle) < Distance(y.at_end, middle);
        });
    ExpectEdge(detection, *best, edge, options, 0.5, 0.8);
  }
}

std::string Bytes(const LineDetection& detection) {
  std::string bytes;
  const auto add = [&bytes](const auto& value) { bytes.append(reinterpret_cast<const char*>(&value), sizeof(value)); };
  add(detection.t_begin_us);
  add(detection.t_end_us);
  for (const DetectedLine& line : detection.lines) {
    for (const ImageSegment& segment : {line.at_begin, line.at_end}) {
      for (const Eigen::Vector2d& point : {segment.p1_px, segment.p2_px}) {
        add(point.x());
        add(point.y());
      }
    }
    add(line.normal_velocity_px_per_s);
    add(line.num_events);
    add(line.rms_px);
  }
  return bytes;
}

TEST(PlaneDetector, TheSameEventsGiveTheSameBits) {
  const std::vector<MovingEdge> edges = {{{100.0, 100.0}, {300.0, 120.0}, {30.0, 200.0}, 0.5},
                                         {{100.0, 100.0}, {130.0, 300.0}, {250.0, 20.0}, 0.5, 0},
                                         {{400.0, 100.0}, {360.0, 300.0}, {250.0, 20.0}, -0.3}};
  const std::vector<PixelEvent> events = MakeEdgeEvents(edges, {.events_per_px2 = 6.0});
  const std::vector<PixelEvent> others = MakeEdgeEvents(edges, {.duration_s = 0.02, .seed = 5});
  const auto detector = MakePlaneLineDetector({}, kSensor).value();
  const std::string first = Bytes(detector->Detect(events));
  EXPECT_GT(first.size(), 3 * sizeof(DetectedLine) / 2);
  EXPECT_NE(Bytes(detector->Detect(others)), first);
  EXPECT_EQ(Bytes(detector->Detect(events)), first);  // a call leaves no state
  EXPECT_EQ(Bytes(DetectLines(events)), first);
}

TEST(PlaneDetector, ReturnsNoLineWithoutAnEdge) {
  EXPECT_TRUE(DetectLines({}).lines.empty());
  EXPECT_TRUE(DetectLines({{5, 100.0f, 100.0f, 1}}).lines.empty());
  const float nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(DetectLines({{5, nan, nan, 1}, {6, 1e30f, -1e30f, 0}}).lines.empty());

  std::vector<PixelEvent> flood, moment, clutter;
  Random random(3);
  for (int k = 0; k < 100'000; ++k) {
    flood.push_back({1000 + k / 4, 300.0f, 200.0f, static_cast<uint8_t>(k % 2)});
    const auto u = static_cast<float>(random.UniformInt(640)), v = static_cast<float>(random.UniformInt(480));
    moment.push_back({1000, u, v, static_cast<uint8_t>(k % 2)});
    clutter.push_back({1000 + k / 4, u, v, static_cast<uint8_t>(k % 2)});
  }
  EXPECT_TRUE(DetectLines(flood).lines.empty());
  EXPECT_TRUE(DetectLines(moment).lines.empty());
  EXPECT_TRUE(DetectLines(clutter).lines.empty());
}

TEST(PlaneDetector, ALineOfEventsAtOneTimeIsFinite) {
  std::vector<PixelEvent> events;
  for (int k = 0; k < 2000; ++k) events.push_back({1000, 100.0f + static_cast<float>(k % 200), 240.0f, 1});
  const LineDetection detection = DetectLines(events);
  EXPECT_EQ(detection.t_begin_us, 1000);
  EXPECT_EQ(detection.t_end_us, 1000);
  for (const DetectedLine& line : detection.lines) {
    for (const ImageSegment& segment : {line.at_begin, line.at_end}) {
      EXPECT_TRUE(segment.p1_px.allFinite() && segment.p2_px.allFinite());
      EXPECT_LT(Distance(segment, {200.0, 240.0}), 1.0);
    }
    EXPECT_TRUE(std::isfinite(line.normal_velocity_px_per_s));
  }
}

TEST(PlaneDetector, RejectsInvalidOptions) {
  const auto message = [](auto change) {
    PlaneDetectorOptions options;
    change(options);
    return std::string(MakePlaneLineDetector(options, kSensor).status().message());
  };
  EXPECT_NE(message([](auto& o) { o.stretch.motion_px = -1.0; }).find("motion_px"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.segmentation.cell_px = 0.0; }).find("cell_px"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.segmentation.smoothness_deg = 0.0; }).find("smoothness_deg"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.lines.fit.gate_px = 0.0; }).find("gate_px"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.lines.corner_px = -1.0; }).find("corner_px"), std::string::npos);
  EXPECT_FALSE(MakePlaneLineDetector({}, {0, 480}).ok());
}

}  // namespace
}  // namespace evpose
