// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/event_edges.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/initialization/templates/edge_blobs.h"
#include "core/initialization/templates/edge_distance_map.h"
#include "core/initialization/templates/long_lines.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using Eigen::Vector2d;

constexpr SensorGeometry kEdgeSensor = {320, 240};

// An edge from `begin` to `end` that moves with a velocity along its normal; each pixel that it sweeps has `per_px`
// events.
struct MovingEdge {
  Vector2d begin, end, velocity_px_per_s;
  double per_px = 2.0;
};

std::vector<PixelEvent> EventsOf(const std::vector<MovingEdge>& edges, int64_t duration_us, double noise_per_s = 0.0) {
  Random random(7);
  std::vector<PixelEvent> events;
  for (const MovingEdge& edge : edges) {
    const double length = (edge.end - edge.begin).norm();
    const double rate = edge.per_px * length * edge.velocity_px_per_s.norm();
    for (double t = random.Exponential(rate); t < 1e-6 * static_cast<double>(duration_us);
         t += random.Exponential(rate)) {
      const Vector2d at = edge.begin + random.Uniform(0.0, 1.0) * (edge.end - edge.begin) + t * edge.velocity_px_per_s;
      events.push_back({static_cast<int64_t>(1e6 * t), static_cast<float>(std::round(at.x())),
                        static_cast<float>(std::round(at.y())), 1});
    }
  }
  for (double t = 0.0; noise_per_s > 0.0 && t < 1e-6 * static_cast<double>(duration_us);
       t += random.Exponential(noise_per_s)) {
    events.push_back({static_cast<int64_t>(1e6 * t), static_cast<float>(random.UniformInt(kEdgeSensor.width_px)),
                      static_cast<float>(random.UniformInt(kEdgeSensor.height_px)),
                      static_cast<uint8_t>(random.UniformInt(2))});
  }
  std::stable_sort(events.begin(), events.end(), [](const auto& a, const auto& b) { return a.t_us < b.t_us; });
  return events;
}

TEST(EventEdges, LieOnTheEdgeAtTheMiddleOfTheStretch) {
  const Vector2d along = Vector2d(3.0, 4.0) / 5.0, normal(-along.y(), along.x());
  for (const double speed : {30.0, 300.0, 3000.0}) {  // px/s
    const MovingEdge edge{{120.0, 60.0}, Vector2d(120.0, 60.0) + 100.0 * along, speed * normal};
    EventEdgeDetector detector({}, kEdgeSensor);
    const EventEdges edges = detector.Detect(EventsOf({edge}, static_cast<int64_t>(8e6 / speed)));
    EXPECT_NEAR(edges.motion_px, 3.0, 1.0) << speed;
    ASSERT_GT(edges.points.size(), 50u) << speed;
    const double t_s = 1e-6 * static_cast<double>(edges.t_mid_us());
    double sum2 = 0.0;
    int num_along = 0;
    for (const EventEdgePoint& point : edges.points) {
      const double across = normal.dot(point.at_px - edge.begin - t_s * edge.velocity_px_per_s);
      sum2 += across * across;
      num_along +=
          std::abs(point.normal.dot(normal)) > 0.95 && std::abs(point.flow_px_per_s.dot(normal) / speed - 1.0) < 0.35;
    }
    EXPECT_LT(std::sqrt(sum2 / static_cast<double>(edges.points.size())), 0.4) << speed;
    EXPECT_GT(num_along, 0.8 * static_cast<double>(edges.points.size())) << speed;
  }
}

TEST(EventEdges, NoiseAndHotPixelsAreNoEdges) {
  const MovingEdge edge{{40.0, 60.0}, {40.0, 160.0}, {500.0, 0.0}};
  std::vector<PixelEvent> events = EventsOf({edge}, 20'000, 200'000.0);
  for (int64_t t_us = 0; t_us < 20'000; t_us += 20) events.push_back({t_us, 200.0f, 100.0f, 1});
  std::stable_sort(events.begin(), events.end(), [](const auto& a, const auto& b) { return a.t_us < b.t_us; });
  EventEdgeDetector detector({}, kEdgeSensor);
  const EventEdges edges = detector.Detect(events);
  int beside = 0;
  for (const EventEdgePoint& point : edges.points) beside += point.at_px.x() > 70.0;
  EXPECT_GT(edges.points.size(), 100u);
  EXPECT_LE(beside, 3);
  EXPECT_TRUE(detector.Detect({}).points.empty());
}

TEST(EventEdges, OptionsAreChecked) {
  EventEdgeOptions options;
  EXPECT_TRUE(options.Validate().ok());
  options.min_events = 0;
  EXPECT_NE(options.Validate().message().find("min_events"), std::string::npos);
}

EventEdgePoint PointAt(double u, double v, const Vector2d& normal) { return {{u, v}, normal, 10.0 * normal, 1.0f}; }

TEST(EdgeBlobs, AreTheConnectedGroupsAndAllTogether) {
  std::vector<EventEdgePoint> points;
  for (int i = 0; i < 100; ++i) points.push_back(PointAt(20.0 + i % 50, i < 50 ? 30.0 : 60.0, {0.0, 1.0}));
  for (int i = 0; i < 31; ++i) points.push_back(PointAt(20.0, 30.0 + i, {1.0, 0.0}));
  for (int i = 0; i < 60; ++i) points.push_back(PointAt(250.0, 150.0 + i, {1.0, 0.0}));
  points.push_back(PointAt(300.0, 10.0, {1.0, 0.0}));  // noise
  const std::vector<ImageBox> boxes = FindEdgeBlobs(points, kEdgeSensor, 3);
  ASSERT_EQ(boxes.size(), 3u);
  EXPECT_NEAR((boxes[0].low_px - Vector2d(20.0, 30.0)).norm(), 0.0, 3.0);
  EXPECT_NEAR((boxes[0].high_px - Vector2d(69.0, 60.0)).norm(), 0.0, 3.0);
  EXPECT_NEAR(0.5 * (boxes[1].low_px.x() + boxes[1].high_px.x()), 250.0, 1.0);
  EXPECT_NEAR(boxes[2].low_px.x(), 20.0, 3.0);
  EXPECT_NEAR(boxes[2].high_px.x(), 250.0, 3.0);
  EXPECT_TRUE(FindEdgeBlobs({}, kEdgeSensor, 3).empty());
}

// Both sides of a bar of 40 px, tilted, from the upper to the lower border of the image.
void AddBar(std::vector<EventEdgePoint>& points) {
  const Vector2d normal = Vector2d(1.0, -0.15).normalized();
  for (int v = 0; v < kEdgeSensor.height_px; ++v) {
    for (const double u : {140.0, 180.0}) points.push_back(PointAt(u + 0.15 * v, v, normal));
  }
}

// The outline of a rectangle.
void AddRectangle(const Vector2d& low, const Vector2d& high, std::vector<EventEdgePoint>& points) {
  for (double u = low.x(); u <= high.x(); ++u) {
    for (const double v : {low.y(), high.y()}) points.push_back(PointAt(u, v, {0.0, 1.0}));
  }
  for (double v = low.y(); v <= high.y(); ++v) {
    for (const double u : {low.x(), high.x()}) points.push_back(PointAt(u, v, {1.0, 0.0}));
  }
}

TEST(LongLines, AreTheSidesOfABarBeforeAnObject) {
  std::vector<EventEdgePoint> points;
  AddRectangle({110.0, 90.0}, {240.0, 150.0}, points);
  const std::vector<EventEdgePoint> object = points;
  AddBar(points);
  const std::vector<EventEdgePoint> rest = WithoutLongLines(points, kEdgeSensor);
  // A band of 10 px about each side of the bar crosses two edges of the object.
  EXPECT_GE(rest.size(), object.size() - 60);
  EXPECT_LE(rest.size(), object.size());
  const std::vector<ImageBox> boxes = FindEdgeBlobs(rest, kEdgeSensor, 2);
  ASSERT_EQ(boxes.size(), 2u);
  EXPECT_NEAR((boxes[1].low_px - Vector2d(110.0, 90.0)).norm(), 0.0, 3.0);
  EXPECT_NEAR((boxes[1].high_px - Vector2d(240.0, 150.0)).norm(), 0.0, 3.0);
}

TEST(LongLines, AreNotTheEdgesOfAnObject) {
  std::vector<EventEdgePoint> points;
  EXPECT_TRUE(WithoutLongLines(points, kEdgeSensor).empty());
  AddRectangle({30.0, 90.0}, {280.0, 110.0}, points);
  EXPECT_TRUE(WithoutLongLines(points, kEdgeSensor).empty());
  AddRectangle({100.0, 40.0}, {140.0, 200.0}, points);
  EXPECT_TRUE(WithoutLongLines(points, kEdgeSensor).empty());
}

TEST(LongLines, NothingIsReturnedForALineAlone) {
  std::vector<EventEdgePoint> points;
  AddBar(points);
  EXPECT_TRUE(WithoutLongLines(points, kEdgeSensor).empty());
}

TEST(EdgeDistanceMap, HasDistancesByDirection) {
  std::vector<EventEdgePoint> points;
  for (int v = 50; v <= 150; ++v) points.push_back(PointAt(100.0, v, {1.0, 0.0}));
  const EdgeDistanceMap map(points, {{40.0, 40.0}, {160.0, 160.0}});
  EXPECT_NEAR(map.cell_px(), 1.0, 1e-9);
  const Vector2d at = map.ToCells({104.0, 100.0});
  const int x = static_cast<int>(std::lround(at.x())), y = static_cast<int>(std::lround(at.y()));
  const int vertical = OrientationBin(0.0, 1.0), horizontal = OrientationBin(1.0, 0.0);
  EXPECT_NEAR(map.Nearness(vertical, x, y), 255.0 * (1.0 - 4.0 / EdgeDistanceMap::kReach), 1.0);
  EXPECT_EQ(map.Nearness(horizontal, x, y), 0);
  const uint16_t nearest = map.Nearest(vertical, x, y);
  ASSERT_NE(nearest, EdgeDistanceMap::kNoEdge);
  EXPECT_NEAR(map.edges()[nearest].at.x(), at.x() - 4.0, 1e-3);
  EXPECT_EQ(map.Nearness(vertical, -1, y), 0);
  EXPECT_EQ(map.Nearest(vertical, map.width(), y), EdgeDistanceMap::kNoEdge);
  EXPECT_EQ(map.edge_weight(), 101.0);
}

TEST(Orientation, BinsAreSectorsOf15Degrees) {
  for (int degrees = -180; degrees < 180; ++degrees) {
    const double angle = (degrees + 0.5) * std::numbers::pi / 180.0;
    EXPECT_EQ(OrientationBin(std::cos(angle), std::sin(angle)), (degrees + 360) % 180 / 15) << degrees;
  }
}

}  // namespace
}  // namespace evpose
