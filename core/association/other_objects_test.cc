// SPDX-License-Identifier: Apache-2.0

// Effects of other objects of a stream: shared events and hidden lines.
#include "core/association/other_objects.h"

#include <gtest/gtest.h>

#include "core/association/observation_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakeCube;
using testing::MakePose;

const CameraModel kCamera = MakeCamera(640, 480, 600.0);

MotionState StateAt(const RigidTransform& pose, double vx_m_per_s = 0.0) {
  MotionState state;
  state.camera_from_object = pose;
  state.twist[0] = vx_m_per_s;
  state.covariance = 1e-10 * Matrix12d::Identity();
  return state;
}

std::vector<TrackedLine> LinesOf(const ObjectModel& model, const VisibilityTester& tester, const RigidTransform& pose) {
  std::vector<TrackedLine> lines;
  for (const VisibleSegment& segment : tester.VisibleSegments(kCamera, pose)) {
    const ModelLine& line = model.lines[segment.line];
    lines.push_back(
        {segment.line, line.p1 + segment.begin * (line.p2 - line.p1), line.p1 + segment.end * (line.p2 - line.p1)});
  }
  return lines;
}

Observation At(const Eigen::Vector2d& pixel) { return testing::ObservationAt(kCamera, pixel); }

double TotalLength(const std::vector<TrackedLine>& lines, const RigidTransform& pose) {
  double length_px = 0.0;
  for (const TrackedLine& line : lines) {
    length_px += (kCamera.Project(pose * line.p2) - kCamera.Project(pose * line.p1)).norm();
  }
  return length_px;
}

class OtherObjectsTest : public ::testing::Test {
 protected:
  // A cube of 15 cm seen face on: its front face spans 210 to 430 px across at 0.485 m.
  void AddCube(const RigidTransform& pose, double vx_m_per_s = 0.0) {
    other_objects_.Add(StateAt(pose, vx_m_per_s), LinesOf(*cube_, tester_, pose), tester_, BoundingSphereOf(*cube_),
                       0.8);
    other_objects_.Build();
  }

  const std::shared_ptr<const ObjectModel> cube_ = MakeCube(0.15);
  const VisibilityTester tester_{*cube_, VisibilityOptions()};
  const RigidTransform front_ = MakePose({0.0, 0.0, 0.56}, {0.0, 0.0, 0.0});
  OtherObjects other_objects_{kCamera};
};

TEST_F(OtherObjectsTest, DensityFollowsTheNormalSpeedOfALine) {
  AddCube(front_, 0.1);
  const Eigen::Vector2d corner = kCamera.Project(front_ * Eigen::Vector3d(0.075, 0.075, -0.075));
  const Observation on_upright = At(corner - Eigen::Vector2d(0.0, 50.0));
  const Observation on_level = At(corner - Eigen::Vector2d(50.0, 0.0));
  const double speed_px_per_s = 0.1 * 600.0 / 0.485;
  EXPECT_NEAR(other_objects_.DensityAt(on_upright), speed_px_per_s * 0.3989 / 0.8, 0.02 * speed_px_per_s);
  EXPECT_LT(other_objects_.DensityAt(on_level), 0.02 * other_objects_.DensityAt(on_upright))
      << "a line that slides along itself makes no events";
  EXPECT_EQ(other_objects_.DensityAt(At(corner - Eigen::Vector2d(20.0, 50.0))), 0.0);
  EXPECT_TRUE(other_objects_.Explains(on_upright));
  EXPECT_FALSE(other_objects_.Explains(At(corner - Eigen::Vector2d(20.0, 50.0))));
  EXPECT_FALSE(other_objects_.Explains(At(corner + Eigen::Vector2d(0.0, 5.0)))) << "beyond the line's end";
}

TEST_F(OtherObjectsTest, ClearRemovesAllObjects) {
  AddCube(front_, 0.1);
  EXPECT_FALSE(other_objects_.empty());
  other_objects_.Clear();
  other_objects_.Build();
  EXPECT_TRUE(other_objects_.empty());
  const Eigen::Vector2d corner = kCamera.Project(front_ * Eigen::Vector3d(0.075, 0.075, -0.075));
  EXPECT_EQ(other_objects_.DensityAt(At(corner - Eigen::Vector2d(0.0, 50.0))), 0.0);
}

TEST_F(OtherObjectsTest, HidesLinesBehindAndNotBefore) {
  AddCube(front_);
  for (const double z_m : {0.3, 1.2}) {
    const RigidTransform pose = MakePose({0.0, 0.0, z_m}, {0.1, 0.1, 0.0});
    ObjectModel small = *MakeCube(0.02);
    std::vector<TrackedLine> lines = LinesOf(small, VisibilityTester(small, VisibilityOptions()), pose);
    const size_t count = lines.size();
    ASSERT_GT(count, 0u);
    other_objects_.RemoveHidden(pose, lines);
    EXPECT_EQ(lines.size(), z_m < 0.5 ? count : 0u) << z_m;
  }
}

TEST_F(OtherObjectsTest, CutsALineWhereItIsHidden) {
  AddCube(front_);
  // A horizontal line behind the cube, from 100 to 540 px: it is visible on both sides of the silhouette.
  const RigidTransform pose = MakePose({0.0, 0.0, 1.2}, {0.0, 0.0, 0.0});
  std::vector<TrackedLine> lines = {{7, {-0.44, 0.0, 0.0}, {0.44, 0.0, 0.0}}};
  lines[0].narrowest_face_px = 3.0;
  lines[0].kind = EdgeKind::kPainted;
  lines[0].prior_contrast = 0.4f;
  std::vector<TrackedLine> element = lines;
  element[0].is_element = true;
  other_objects_.RemoveHidden(pose, lines);
  ASSERT_EQ(lines.size(), 2u);
  // A long element is cut like a line.
  other_objects_.RemoveHidden(pose, element);
  ASSERT_EQ(element.size(), 2u);
  EXPECT_TRUE(element[1].is_element);
  EXPECT_EQ(element[1].p1, lines[1].p1);
  const double edge_px = 0.075 * 600.0 / 0.485;
  EXPECT_NEAR(kCamera.Project(pose * lines[0].p2).x(), kCamera.cx_px - edge_px, 1.0);
  EXPECT_NEAR(kCamera.Project(pose * lines[1].p1).x(), kCamera.cx_px + edge_px, 1.0);
  EXPECT_EQ(lines[0].p1.x(), -0.44);
  EXPECT_EQ(lines[1].p2.x(), 0.44);
  for (const TrackedLine& part : lines) {
    EXPECT_EQ(part.curve, 7);
    EXPECT_EQ(part.narrowest_face_px, 3.0);
    EXPECT_EQ(part.kind, EdgeKind::kPainted);
    EXPECT_EQ(part.prior_contrast, 0.4f);
    EXPECT_EQ(part.previous, -1);
    EXPECT_EQ(part.next, -1);
  }
}

TEST_F(OtherObjectsTest, ElementsStayJoinedWhereSomeAreHidden) {
  AddCube(front_);
  // A row of elements behind the cube, from 100 to 540 px, 11 px each.
  const RigidTransform pose = MakePose({0.0, 0.0, 1.2}, {0.0, 0.0, 0.0});
  std::vector<TrackedLine> lines(40);
  for (int k = 0; k < 40; ++k) {
    lines[k].p1 = {-0.44 + 0.022 * k, 0.0, 0.0};
    lines[k].p2 = {-0.44 + 0.022 * (k + 1), 0.0, 0.0};
    lines[k].is_element = true;
    lines[k].previous = k - 1;
    lines[k].next = k + 1 < 40 ? k + 1 : -1;
  }
  EXPECT_TRUE(other_objects_.RemoveHidden(pose, lines));
  ASSERT_GT(lines.size(), 10u);
  ASSERT_LT(lines.size(), 30u);
  int ends = 0;
  for (size_t k = 0; k < lines.size(); ++k) {
    if (lines[k].next < 0) {
      ++ends;
      continue;
    }
    const TrackedLine& next = lines[static_cast<size_t>(lines[k].next)];
    EXPECT_EQ(next.p1, lines[k].p2);
    EXPECT_EQ(next.previous, static_cast<int>(k));
  }
  EXPECT_EQ(ends, 2) << "one on the right, and one where the cube begins";
}

TEST_F(OtherObjectsTest, ALongElementIsJoinedOnlyWhereItIsNotCut) {
  AddCube(front_);
  // Three long elements of one line; the one in the middle is behind the cube.
  const RigidTransform pose = MakePose({0.0, 0.0, 1.2}, {0.0, 0.0, 0.0});
  const double ends[] = {-0.9, -0.15, 0.1, 0.9};
  for (const double y : {0.0, 0.4}) {
    std::vector<TrackedLine> lines(3);
    for (int k = 0; k < 3; ++k) {
      lines[k].p1 = {ends[k], y, 0.0};
      lines[k].p2 = {ends[k + 1], y, 0.0};
      lines[k].is_element = true;
      lines[k].previous = k - 1;
      lines[k].next = k < 2 ? k + 1 : -1;
    }
    const bool is_hidden = y == 0.0;
    EXPECT_EQ(other_objects_.RemoveHidden(pose, lines), is_hidden);
    EXPECT_EQ(lines.size(), is_hidden ? 2u : 3u);
    for (size_t k = 0; k + 1 < lines.size(); ++k) {
      EXPECT_EQ(lines[k].next, is_hidden ? -1 : static_cast<int>(k) + 1) << y;
      EXPECT_EQ(lines[k + 1].previous, is_hidden ? -1 : static_cast<int>(k)) << y;
    }
  }
}

TEST_F(OtherObjectsTest, ADistantObjectHidesNothing) {
  AddCube(front_);
  const RigidTransform pose = MakePose({0.45, 0.0, 1.2}, {0.1, 0.2, 0.0});
  std::vector<TrackedLine> lines = LinesOf(*cube_, tester_, pose);
  const double before_px = TotalLength(lines, pose);
  other_objects_.RemoveHidden(pose, lines);
  EXPECT_EQ(TotalLength(lines, pose), before_px);
}

TEST(OwnShare, IsLargerForTheNearerLine) {
  EXPECT_EQ(OwnShare(0.0, 0.0), 1.0);
  EXPECT_EQ(OwnShare(8.0, 0.0), 1.0);
  EXPECT_NEAR(OwnShare(0.0, 0.3989 / 0.8), 0.5, 0.02);  // a line of the other object in the same place
  EXPECT_LT(OwnShare(5.0, 0.3989 / 0.8), 0.05);         // on the line of the other object
  EXPECT_GT(OwnShare(0.0, 0.3989 / 0.8 * 0.01), 0.97);  // the other line has a hundredth of the own rate
}

TEST(BoundingSphere, HoldsTheObject) {
  const BoundingSphere sphere = BoundingSphereOf(*MakeCube(0.2));
  EXPECT_LT(sphere.centre.norm(), 1e-12);
  EXPECT_NEAR(sphere.radius_m, 0.1 * std::sqrt(3.0), 1e-12);
}

TEST(MayOverlap, NeverMissesAnOverlap) {
  Random random(3);
  int num_overlaps = 0, num_reported = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    const auto place = [&] {
      return BoundingSphere{{random.Uniform(-0.6, 0.6), random.Uniform(-0.5, 0.5), random.Uniform(0.5, 1.5)},
                            random.Uniform(0.02, 0.2)};
    };
    const BoundingSphere a = place(), b = place();
    // The exact test compares the angle between the centres with the sum of the spheres' angular radii.
    const double angle = std::acos(a.centre.normalized().dot(b.centre.normalized()));
    const bool is_overlap = angle < std::asin(a.radius_m / a.centre.norm()) + std::asin(b.radius_m / b.centre.norm());
    const bool is_reported = MayOverlap(kCamera, a, b, 0.0);
    EXPECT_TRUE(is_reported || !is_overlap) << trial;
    num_overlaps += is_overlap;
    num_reported += is_reported;
  }
  EXPECT_GT(num_overlaps, 300);
  EXPECT_LT(num_reported, 3 * num_overlaps) << "too many pairs are reported as overlapping";
}

}  // namespace
}  // namespace evpose
