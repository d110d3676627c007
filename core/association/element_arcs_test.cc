// SPDX-License-Identifier: Apache-2.0
#include "core/association/element_arcs.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/association/line_events.h"
#include "core/estimation/ideal_events_testing.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakePose;

// A circle in the plane z = 0 about the origin, or a part of it, as chords at the mean of their arcs.
class ElementArcsTest : public ::testing::Test {
 protected:
  static constexpr double kRadiusM = 0.2;  // 120 px at 1 m
  static constexpr int kCount = 50;        // chords of 15 px

  void MakeCircle(int count) {
    const double step = 2.0 * M_PI / kCount;
    const double mean_m = kRadiusM * (1.0 + 2.0 / 3.0 * (1.0 - std::cos(0.5 * step)));
    const double half_m = kRadiusM * std::sin(0.5 * step), middle_m = mean_m - kRadiusM * (1.0 - std::cos(0.5 * step));
    for (int i = 0; i < count; ++i) {
      const double angle = (i + 0.5) * step;
      const Eigen::Vector3d outward(std::cos(angle), std::sin(angle), 0.0);
      const Eigen::Vector3d along(-std::sin(angle), std::cos(angle), 0.0);
      Add(middle_m * outward - half_m * along, middle_m * outward + half_m * along);
    }
    if (count < kCount) return;
    lines_.front().previous = count - 1;
    lines_.back().next = 0;
  }
  // Appends an element that continues the last one.
  void Add(const Eigen::Vector3d& p1, const Eigen::Vector3d& p2) {
    EdgeElement& element = elements_.emplace_back();
    TrackedLine& line = lines_.emplace_back();
    line.p1 = element.p1 = p1;
    line.p2 = element.p2 = p2;
    line.is_element = true;
    line.previous = static_cast<int>(lines_.size()) - 2;
    if (lines_.size() > 1) lines_[lines_.size() - 2].next = static_cast<int>(lines_.size()) - 1;
  }
  void Join() { JoinArcs(camera_, state_.camera_from_object, options_, elements_, lines_); }
  Observation EventAt(double angle) const {
    const Eigen::Vector3d point =
        state_.camera_from_object * Eigen::Vector3d(kRadiusM * std::cos(angle), kRadiusM * std::sin(angle), 0.0);
    const Eigen::Vector2d pixel = camera_.Project(point);
    Observation event;
    event.bx = point.x() / point.z();
    event.by = point.y() / point.z();
    event.u_px = pixel.x();
    event.v_px = pixel.y();
    for (uint16_t k = 0; k < lines_.size() && event.num_lines < Observation::kMaxLines; ++k) {
      if (std::abs(images_[k].AlongPx(event.u_px, event.v_px) - 0.5 * images_[k].length_px) < images_[k].length_px &&
          std::abs(DistancePx(event, images_[k])) < 6.0) {
        event.lines[event.num_lines++] = k;
      }
    }
    return event;
  }
  void Project() { ProjectLines(camera_, state_, lines_, images_); }

  const CameraModel camera_ = MakeCamera(640, 480, 600.0);
  const EdgeElementOptions options_{};
  MotionState state_ = StateAt({0.3, -0.4, 0.2});
  std::vector<EdgeElement> elements_;
  std::vector<TrackedLine> lines_;
  std::vector<ImageLine> images_;

  static MotionState StateAt(const Eigen::Vector3d& turn) {
    MotionState state;
    state.camera_from_object = MakePose({0.01, 0.02, 1.0}, turn);
    return state;
  }
};

TEST_F(ElementArcsTest, ACircleBecomesFewArcsThatFollowIt) {
  MakeCircle(kCount);
  Join();
  EXPECT_LE(lines_.size(), kCount * 3 / 5u);
  EXPECT_EQ(lines_.size(), elements_.size());
  for (size_t k = 0; k < lines_.size(); ++k) {
    ASSERT_GE(lines_[k].next, 0);
    EXPECT_EQ(lines_[static_cast<size_t>(lines_[k].next)].previous, static_cast<int>(k));
  }
  Project();
  int at_joint = 0;
  for (double angle = 0.0; angle < 2.0 * M_PI; angle += 0.0101) {
    const Observation event = EventAt(angle);
    const NearLines near = FindNearLines(event, images_.data(), 6.0, 0.0);
    if (near.count != 1) {
      ++at_joint;
      continue;
    }
    EXPECT_NEAR(near.distance_px[0], 0.0, 0.05) << angle;
    LineEvents sorted;
    sorted.Sort({&event, 1}, images_.size(), images_);
    for (const LineGroup& group : sorted.groups()) {
      if (group.line != near.line[0]) continue;
      EXPECT_NEAR(GroupLine(group, images_[group.line]).DistancePx(group.events[0])[0], near.distance_px[0], 1e-3);
    }
  }
  EXPECT_LE(at_joint, 5) << "the ends of successive arcs meet within a few hundredths of a pixel";
}

TEST_F(ElementArcsTest, ATurnOfACircleAboutItsAxisMovesNoArc) {
  MakeCircle(kCount);
  Join();
  const Eigen::Vector3d axis = state_.camera_from_object.rotation.col(2);
  state_.twist.tail<3>() = axis;  // 1 rad/s: 120 px/s along the circle
  Project();
  double largest = 0.0;
  for (const ImageLine& line : images_) {
    if (line.sagitta_px == 0.0) continue;  // the rest of the circle is one short chord
    for (const double fraction : {0.1, 0.5, 0.9}) {
      EXPECT_NEAR(NormalSpeedPxPerS(camera_, line, fraction), 0.0, 1.5);
    }
    largest = std::max(largest, line.length_px);
  }
  EXPECT_GT(largest, 25.0) << "without the curvature the ends of a chord would move by 10 px/s";
}

TEST_F(ElementArcsTest, TheJacobianIsTheDerivativeOfTheDistance) {
  MakeCircle(kCount);
  Join();
  Project();
  const std::vector<ImageLine> before = images_;
  for (int parameter = 0; parameter < 6; ++parameter) {
    MotionState moved = state_;
    Vector12d change = Vector12d::Zero();
    change[parameter] = 1e-4;
    moved = Plus(moved, change);
    ProjectLines(camera_, moved, lines_, images_);
    for (double angle = 0.0; angle < 2.0 * M_PI; angle += 0.1) {
      const Observation event = EventAt(angle);
      const int line = FindNearLines(event, before.data(), 6.0, 0.0).line[0];
      const double expected = before[line].jacobian.col(parameter).dot(Eigen::Vector3d(event.bx, event.by, 1.0));
      const double change_px = DistancePx(event, images_[line]) - DistancePx(event, before[line]);
      EXPECT_NEAR(change_px / 1e-4, expected, 12.0) << parameter << " " << angle;  // of 600
    }
  }
}

TEST_F(ElementArcsTest, CornersAndOtherCurvesEndAnArc) {
  state_ = StateAt({0.0, 0.0, 0.0});
  Add({0.0, 0.0, 0.0}, {0.03, 0.0, 0.0});
  Add({0.03, 0.0, 0.0}, {0.06, 0.0, 0.0});      // straight
  Add({0.06, 0.0, 0.0}, {0.088, 0.0095, 0.0});  // 18 degrees
  Add({0.088, 0.0095, 0.0}, {0.1, 0.0135, 0.0});
  elements_.back().curve = 1;
  lines_.back().curve = 1;
  Join();
  ASSERT_EQ(lines_.size(), 3u);
  EXPECT_LT((lines_[0].p2 - Eigen::Vector3d(0.06, 0.0, 0.0)).norm(), 1e-9);
  EXPECT_LT(lines_[0].sagitta.norm(), 1e-9);
  EXPECT_EQ(lines_[0].next, 1);
  EXPECT_EQ(lines_[1].previous, 0);
  EXPECT_EQ(lines_[2].previous, 1);
}

}  // namespace
}  // namespace evpose
