// SPDX-License-Identifier: Apache-2.0
#include "core/association/visible_edges.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/tracker_options.h"

namespace evpose {
namespace {

using testing::MakeCamera;
using testing::MakeCube;
using testing::MakePose;

class VisibleEdgesTest : public ::testing::Test {
 protected:
  VisibleEdgesTest() : edges_(*cube_, TrackerOptions().visibility, {}), lines_(camera_, edges_) {}

  // A pose turned about the image's horizontal axis by this angle from the pose in which the lower face is seen
  // edge-on.
  static RigidTransform TurnedFromEdgeOn(double angle_rad) {
    return MakePose({0.0, 0.0, 1.0}, {std::asin(kHalfEdgeM) + angle_rad, 0.0, 0.0});
  }
  static double NarrowestPx(absl::Span<const TrackedLine> lines) {
    double narrowest_px = 1e9;
    for (const TrackedLine& line : lines) narrowest_px = std::min(narrowest_px, line.narrowest_face_px);
    return narrowest_px;
  }

  static constexpr double kHalfEdgeM = 0.1;
  static constexpr double kFocalPx = 1000.0;
  const std::shared_ptr<const ObjectModel> cube_ = MakeCube(2.0 * kHalfEdgeM);
  const CameraModel camera_ = MakeCamera(1280, 720, kFocalPx);
  const ModelEdges edges_;
  VisibleEdges lines_;
};

TEST_F(VisibleEdgesTest, TheWidthOfAFaceFollowsItsAngle) {
  for (const double angle_rad : {0.003, 0.01, -0.003, -0.01}) {
    // The bound: the camera's height above the face, divided by the squared distance of the lines (0.9 to 1.1 m), for a
    // face as wide as the cube's diagonal.
    const double height_m = std::abs(std::sin(std::asin(kHalfEdgeM) + angle_rad) - kHalfEdgeM);
    const double narrowest_px = NarrowestPx(lines_.At(TurnedFromEdgeOn(angle_rad)));
    EXPECT_GT(narrowest_px, kFocalPx * cube_->diameter_m * height_m / (1.15 * 1.15)) << angle_rad;
    EXPECT_LT(narrowest_px, kFocalPx * cube_->diameter_m * height_m / (0.85 * 0.85)) << angle_rad;
  }
}

TEST_F(VisibleEdgesTest, TheWidthOfAFaceIsUpdatedWithoutANewRayCast) {
  constexpr double kStepRad = 0.0005;  // below the rotation that causes a new ray cast
  const double before_px = NarrowestPx(lines_.At(TurnedFromEdgeOn(0.002)));
  const double after_px = NarrowestPx(lines_.At(TurnedFromEdgeOn(0.002 + kStepRad)));
  EXPECT_NEAR(after_px / before_px, 1.25, 0.01);
}

TEST_F(VisibleEdgesTest, ALineWithoutFacesHasNoNarrowOne) {
  ObjectModel wires = *cube_;
  wires.vertices.clear();
  wires.triangles.clear();
  for (ModelLine& line : wires.lines) line.face_normals.clear();
  const ModelEdges edges(wires, TrackerOptions().visibility, {});
  VisibleEdges lines(camera_, edges);
  const absl::Span<const TrackedLine> seen = lines.At(TurnedFromEdgeOn(0.0));
  ASSERT_EQ(seen.size(), wires.lines.size());
  for (const TrackedLine& line : seen) EXPECT_TRUE(std::isinf(line.narrowest_face_px));
}

}  // namespace
}  // namespace evpose
