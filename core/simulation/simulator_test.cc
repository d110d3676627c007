// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/simulator.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "core/geometry/projected_line.h"
#include "core/geometry/undistortion_table.h"
#include "core/numerics/statistics.h"
#include "core/simulation/simulate_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

SimulationOptions SmallScene(const std::string& object, int64_t duration_us = 200'000) {
  SimulationOptions options = *SimulationPreset(object, "vga");
  options.duration_us = duration_us;
  return options;
}

// Options of an ideal sensor without noise, behind the default lens.
SimulationOptions IdealScene(const std::string& object, int64_t duration_us) {
  SimulationOptions options = SmallScene(object, duration_us);
  options.sensor.leak_hz = options.sensor.shot_noise_hz = options.sensor.hot_pixel_ratio = 0.0;
  options.sensor.bandwidth_hz = 0.0;
  options.sensor.refractory_us = 0.0;
  return options;
}

// The position of an event relative to the nearest line of the model at the time of the event.
struct LineDistance {
  int line = -1;
  double px = 0.0;              // signed: positive ahead of the moving line
  double speed_px_per_s = 0.0;  // normal speed of the line
  bool on = false;
};

class LineMatcher {
 public:
  explicit LineMatcher(const SimulationOptions& options)
      : camera_(options.camera),
        model_(*SimulatedModel(options)),
        truth_(SimulatedTruth(options)),
        bearings_(*UndistortionTable::Create(options.camera)) {}

  size_t num_lines() const { return model_.lines.size(); }

  std::optional<LineDistance> Match(const Event& event) const {
    constexpr int64_t kLaterUs = 200;
    constexpr double kGatePx = 5.0;
    if (event.t_us + kLaterUs > truth_.back().t_us) return std::nullopt;
    const RigidTransform pose = *Interpolate(truth_, event.t_us);
    const RigidTransform later = *Interpolate(truth_, event.t_us + kLaterUs);
    const Eigen::Vector2f b = bearings_.Bearing(event.x, event.y);
    const Eigen::Vector3d bearing(b.x(), b.y(), 1.0);
    LineDistance best;
    double best_px = kGatePx;
    for (size_t i = 0; i < model_.lines.size(); ++i) {
      const ModelLine& line = model_.lines[i];
      if (!FacesCamera(line, pose)) continue;
      const auto now = ProjectLine(camera_, pose, line.p1, line.p2);
      const auto then = ProjectLine(camera_, later, line.p1, line.p2);
      if (!now || !then || !IsBeside(*now, bearing)) continue;
      const double d = now->a.dot(bearing);
      if (std::abs(d) >= best_px) continue;
      best_px = std::abs(d);
      const double motion_px = d - then->a.dot(bearing);  // the line moves towards its positive side
      best = {static_cast<int>(i), motion_px > 0.0 ? d : -d, std::abs(motion_px) / (kLaterUs * 1e-6),
              event.polarity == 1};
    }
    if (best.line < 0) return std::nullopt;
    return best;
  }

 private:
  static bool FacesCamera(const ModelLine& line, const RigidTransform& pose) {
    const Eigen::Vector3d view = pose * (0.5 * (line.p1 + line.p2));
    return std::any_of(line.face_normals.begin(), line.face_normals.end(),
                       [&](const Eigen::Vector3d& normal) { return (pose.rotation * normal).dot(view) < 0.0; });
  }

  // The event lies between the end points and at least 3 px away from them, because corners belong to several lines.
  bool IsBeside(const ProjectedLine& line, const Eigen::Vector3d& bearing) const {
    const Eigen::Vector2d pixel = camera_.Project(bearing);
    const Eigen::Vector2d along = line.p2_px - line.p1_px;
    const double place_px = (pixel - line.p1_px).dot(along) / along.norm();
    return place_px > 3.0 && place_px < along.norm() - 3.0;
  }

  CameraModel camera_;
  ObjectModel model_;
  Trajectory truth_;
  UndistortionTable bearings_;
};

struct DistanceSummary {
  size_t num = 0;
  size_t unmatched = 0;
  double median_px = 0.0;
  double mean_px = 0.0;
  double mean_on_px = 0.0;
  double mean_off_px = 0.0;
  double mean_speed_px_per_s = 0.0;
};

DistanceSummary Summarize(const SimulationOptions& options) {
  const LineMatcher matcher(options);
  DistanceSummary summary;
  std::vector<double> distances;
  double sums[2] = {0.0, 0.0};
  size_t counts[2] = {0, 0};
  for (const Event& event : SimulatedEvents(options)) {
    const auto match = matcher.Match(event);
    if (!match) {
      ++summary.unmatched;
      continue;
    }
    distances.push_back(std::abs(match->px));
    sums[match->on] += match->px;
    ++counts[match->on];
    summary.mean_speed_px_per_s += match->speed_px_per_s;
  }
  EXPECT_GT(distances.size(), 1000u);
  summary.num = distances.size();
  summary.median_px = UpperMedian(distances);
  summary.mean_on_px = sums[1] / counts[1];
  summary.mean_off_px = sums[0] / counts[0];
  summary.mean_px = 0.5 * (summary.mean_on_px + summary.mean_off_px);  // equal weights for both polarities
  summary.mean_speed_px_per_s /= summary.num;
  return summary;
}

TEST(SimulatorTest, EventsLieOnTheProjectedLinesAtTheirOwnTime) {
  const DistanceSummary ideal = Summarize(IdealScene("cube", 300'000));
  RecordProperty("median_px", std::to_string(ideal.median_px));
  RecordProperty("mean_on_px", std::to_string(ideal.mean_on_px));
  RecordProperty("mean_off_px", std::to_string(ideal.mean_off_px));
  EXPECT_LT(ideal.median_px, 0.5);
  EXPECT_NEAR(ideal.mean_px, 0.0, 0.03);
  // The logarithm makes bright areas larger: ON events are ahead of the edge and OFF events behind it, by the same
  // distance.
  EXPECT_GT(ideal.mean_on_px, 0.02);
  EXPECT_LT(ideal.mean_on_px, 0.4);
  EXPECT_NEAR(ideal.mean_off_px, -ideal.mean_on_px, 0.06);
  EXPECT_LT(ideal.unmatched, ideal.num / 10);  // corners
}

TEST(SimulatorTest, FiniteBandwidthLagsByItsTimeConstant) {
  SimulationOptions options = IdealScene("cube", 300'000);
  const DistanceSummary ideal = Summarize(options);
  options.sensor.bandwidth_hz = 500.0;
  options.sensor.dark_bandwidth_ratio = 1.0;
  const DistanceSummary slow = Summarize(options);
  const double lag_px = slow.mean_speed_px_per_s / (2.0 * std::numbers::pi * 500.0);
  EXPECT_GT(lag_px, 0.04);  // the scene is fast enough for a significant lag
  EXPECT_NEAR(slow.mean_px - ideal.mean_px, -lag_px, 0.35 * lag_px);
}

TEST(SimulatorTest, TheStepHardlyMatters) {
  SimulationOptions options = IdealScene("cube", 100'000);
  const DistanceSummary usual = Summarize(options);
  options.max_step_px = 0.1;
  const DistanceSummary fine = Summarize(options);
  EXPECT_NEAR(usual.mean_on_px, fine.mean_on_px, 0.02);
  EXPECT_NEAR(usual.mean_off_px, fine.mean_off_px, 0.02);
  EXPECT_NEAR(static_cast<double>(usual.num), static_cast<double>(fine.num), 0.02 * fine.num);
}

TEST(SimulatorTest, EveryObjectProducesEventsOnMostOfItsVisibleLines) {
  const std::vector<std::string> names = SimulatedObjectNames();
  ASSERT_EQ(names.size(), 5u);
  // Visible at a time are 9 of 12 edges of a cube or cuboid, all six lines of the planar target, and at least the four
  // edges of the book's cover and its 13 painted lines. Two panels of the spacecraft with eight lines each and most of
  // its bus are visible.
  const std::vector<size_t> least = {9, 9, 6, 17, 34};
  for (size_t i = 0; i < names.size(); ++i) {
    const SimulationOptions options = IdealScene(names[i], 250'000);
    const LineMatcher matcher(options);
    std::vector<int> per_line(matcher.num_lines());
    size_t unmatched = 0;
    const std::vector<Event> events = SimulatedEvents(options);
    for (const Event& event : events) {
      if (const auto match = matcher.Match(event)) {
        ++per_line[match->line];
      } else {
        ++unmatched;
      }
    }
    EXPECT_GT(events.size(), 20'000u) << names[i];
    EXPECT_LT(unmatched, events.size() / 8) << names[i];
    const auto lively = std::count_if(per_line.begin(), per_line.end(), [](int n) { return n >= 30; });
    EXPECT_GE(static_cast<size_t>(lively), least[i]) << names[i] << ": " << ::testing::PrintToString(per_line);
  }
}

TEST(SimulatorTest, IsDeterministicBySeed) {
  SimulationOptions options = SmallScene("spacecraft", 60'000);
  options.sensor.noise_ratio = 0.1;
  options.scene.background.is_textured = true;
  const std::vector<Event> events = SimulatedEvents(options);
  EXPECT_EQ(events, SimulatedEvents(options));
  options.path_seed = 1;  // the previous seed
  EXPECT_EQ(events, SimulatedEvents(options));
  options.seed = 2;
  EXPECT_NE(events, SimulatedEvents(options));
}

TEST(SimulatorTest, ThePathSeedOnlyDeterminesTheMotion) {
  SimulationOptions options = SmallScene("cube", 30'000);
  const auto end_of = [](const SimulationOptions& o) { return SimulatedTruth(o).back().camera_from_object; };
  const Eigen::Vector3d end = end_of(options).translation_m;
  options.path_seed = 7;
  EXPECT_NE(end_of(options).translation_m, end);
  const std::vector<Event> events = SimulatedEvents(options);
  const Eigen::Vector3d other_end = end_of(options).translation_m;
  options.seed = 2;
  EXPECT_EQ(end_of(options).translation_m, other_end);
  EXPECT_NE(SimulatedEvents(options), events);
}

TEST(SimulatorTest, TimesAreOrderedAndInside) {
  SimulationOptions options = SmallScene("book", 60'000);
  options.sensor.noise_ratio = 0.2;
  SimulationReport report;
  const std::vector<Event> events = SimulatedEvents(options, &report);
  EXPECT_EQ(report.events, events.size());
  EXPECT_GT(report.rendered_frames, 20);
  const auto before = [](const Event& a, const Event& b) {
    return std::tie(a.t_us, a.y, a.polarity, a.x) < std::tie(b.t_us, b.y, b.polarity, b.x);
  };
  EXPECT_TRUE(std::is_sorted(events.begin(), events.end(), before));
  EXPECT_GE(events.front().t_us, options.t_begin_us);
  EXPECT_LT(events.back().t_us, options.t_begin_us + options.duration_us);
  EXPECT_NEAR(static_cast<double>(report.noise_events) / report.events, 0.2, 0.02);
  EXPECT_GT(report.max_speed_px_per_s, 10.0);
}

TEST(SimulatorTest, ImageMovesByNoMoreThanTheStep) {
  SimulationOptions options = IdealScene("cube", 100'000);
  SimulationReport usual, fine;
  SimulatedEvents(options, &usual);
  options.max_step_px = 0.1;
  SimulatedEvents(options, &fine);
  EXPECT_NEAR(static_cast<double>(fine.rendered_frames) / usual.rendered_frames, 4.0, 0.6);
}

TEST(SimulatorTest, LightOccluderAndShadingAddEvents) {
  const SimulationOptions plain = IdealScene("cube", 60'000);
  const size_t base = SimulatedEvents(plain).size();
  SimulationOptions flicker = plain;
  flicker.scene.light.flicker_depth = 0.5;
  EXPECT_GT(SimulatedEvents(flicker).size(), 3 * base);  // the faces produce events at 100 Hz
  SimulationOptions occluder = plain;
  occluder.scene.occluder.is_present = true;
  EXPECT_GT(SimulatedEvents(occluder).size(), base + 2000);
  SimulationOptions change = plain;
  change.scene.light.change_ratio = 5.0;
  change.scene.light.change_period_s = 0.2;
  EXPECT_GT(SimulatedEvents(change).size(), 2 * base);
  SimulationOptions shading = plain;
  shading.scene.light.diffuse_ratio = 0.9;
  EXPECT_NE(SimulatedEvents(shading).size(), base);
}

TEST(SimulatorTest, TruthHasEveryMillisecondAndTheEnd) {
  SimulationOptions options = SmallScene("cube", 10'500);
  const Trajectory truth = SimulatedTruth(options);
  ASSERT_EQ(truth.size(), 12u);
  EXPECT_EQ(truth[0].t_us, options.t_begin_us);
  EXPECT_EQ(truth[10].t_us, options.t_begin_us + 10'000);
  EXPECT_EQ(truth[11].t_us, options.t_begin_us + 10'500);
}

TEST(SimulatorTest, StopsWhenItsConsumerFails) {
  int calls = 0;
  const auto result = Simulate(SmallScene("cube", 400'000), [&](absl::Span<const Event>) {
    ++calls;
    return absl::ResourceExhaustedError("full");
  });
  EXPECT_EQ(result.status().code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(calls, 1);
}

TEST(SimulatorTest, ReportsProgress) {
  std::vector<double> ratios;
  const auto result = Simulate(
      SmallScene("cube", 20'000), [](absl::Span<const Event>) { return absl::OkStatus(); },
      [&](double ratio) { ratios.push_back(ratio); });
  ASSERT_TRUE(result.ok());
  ASSERT_GT(ratios.size(), 5u);
  EXPECT_TRUE(std::is_sorted(ratios.begin(), ratios.end()));
  EXPECT_EQ(ratios.back(), 1.0);
}

TEST(SimulationOptionsTest, NamesTheWrongField) {
  const auto message = [](const auto& change) {
    SimulationOptions options;
    change(options);
    const absl::Status status = options.Validate();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    EXPECT_FALSE(Simulate(options, [](absl::Span<const Event>) { return absl::OkStatus(); }).ok());
    EXPECT_TRUE(SimulatedTruth(options).empty());
    EXPECT_FALSE(SimulatedModel(options).ok());
    return std::string(status.message());
  };
  EXPECT_TRUE(SimulationOptions().Validate().ok());
  EXPECT_THAT(message([](auto& o) { o.t_begin_us = 1 << 24; }), HasSubstr("t_begin_us"));
  EXPECT_THAT(message([](auto& o) { o.t_begin_us = -1; }), HasSubstr("t_begin_us"));
  EXPECT_THAT(message([](auto& o) { o.duration_us = 0; }), HasSubstr("duration_us"));
  EXPECT_THAT(message([](auto& o) { o.max_step_px = 0.0; }), HasSubstr("max_step_px"));
  EXPECT_THAT(message([](auto& o) { o.camera.width_px = 4000; }), HasSubstr("camera"));
  EXPECT_THAT(message([](auto& o) { o.camera.fx_px = 0.0; }), HasSubstr("fx"));
  EXPECT_THAT(message([](auto& o) { o.scene.object_size_m = -1.0; }), HasSubstr("object_size_m"));
  EXPECT_THAT(message([](auto& o) { o.scene.object_size_m = 2.0; }), HasSubstr("does not fit in view"));
  EXPECT_THAT(message([](auto& o) { o.scene.lens_blur_px = 9.0; }), HasSubstr("lens_blur_px"));
  EXPECT_THAT(message([](auto& o) { o.scene.motion.extent_ratio = 2.0; }), HasSubstr("extent_ratio"));
  EXPECT_THAT(message([](auto& o) { o.scene.background.reflectance = 2.0; }), HasSubstr("reflectance"));
  EXPECT_THAT(message([](auto& o) { o.scene.light.flicker_depth = 1.0; }), HasSubstr("flicker_depth"));
  EXPECT_THAT(message([](auto& o) { o.scene.occluder.width_px = 0.0; }), HasSubstr("width_px"));
  EXPECT_THAT(message([](auto& o) { o.sensor.threshold_on = 0.0; }), HasSubstr("threshold_on"));
  EXPECT_THAT(message([](auto& o) { o.sensor.noise_ratio = 1.0; }), HasSubstr("noise_ratio"));
  EXPECT_THAT(message([](auto& o) { o.sensor.flood_hz = -1.0; }), HasSubstr("flood_hz"));
  EXPECT_THAT(message([](auto& o) { o.sensor.flood_s = 0.6; }), HasSubstr("flood_s"));
  EXPECT_THAT(message([](auto& o) { o.scene.occluder.swing_ratio = 0.0; }), HasSubstr("swing_ratio"));
  EXPECT_THAT(message([](auto& o) { o.scene.background.edge_reflectance = 2.0; }), HasSubstr("edge_reflectance"));
  EXPECT_THAT(message([](auto& o) { o.sensor.bandwidth_hz = std::numeric_limits<double>::infinity(); }),
              HasSubstr("bandwidth_hz"));
}

TEST(SimulationPresetTest, NamesAreListedAndFound) {
  for (const std::string& object : SimulatedObjectNames()) {
    for (const std::string& camera : SimulatedCameraNames()) {
      const auto options = SimulationPreset(object, camera);
      ASSERT_TRUE(options.ok()) << options.status();
      EXPECT_EQ(SimulatedObjectName(options->scene.object), object);
      EXPECT_TRUE(options->Validate().ok()) << options->Validate();
    }
  }
  const auto object = SimulationPreset("sphere");
  EXPECT_EQ(object.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(object.status().message()), HasSubstr("\"sphere\""));
  EXPECT_THAT(std::string(object.status().message()), HasSubstr("cube, cuboid, planar, book, spacecraft"));
  EXPECT_THAT(std::string(SimulationPreset("cube", "hd").status().message()), HasSubstr("evk4, vga"));
  EXPECT_THAT(std::string(SimulationPreset("cube", "evk4", -1.0).status().message()), HasSubstr("speed_scale"));
  EXPECT_EQ(SimulationPreset("cube", "evk4", 2.0)->scene.motion.speed_m_per_s,
            2.0 * SimulationPreset("cube")->scene.motion.speed_m_per_s);
}

}  // namespace
}  // namespace evpose
