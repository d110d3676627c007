// SPDX-License-Identifier: Apache-2.0
#include "core/association/visible_edges.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/contours/contour_shapes_testing.h"
#include "core/contours/facet_outline_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/object/tracker_options.h"

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

// Sideways motion changes the visible parts by the border of the image, and by the direction of view.
TEST_F(VisibleEdgesTest, TheVisiblePartsFollowAMotionOutOfTheImage) {
  const auto length_px = [&](absl::Span<const TrackedLine> lines, const RigidTransform& pose) {
    double sum_px = 0.0;
    for (const TrackedLine& line : lines)
      sum_px += (camera_.Project(pose * line.p2) - camera_.Project(pose * line.p1)).norm();
    return sum_px;
  };
  double longest_px = 0.0, shortest_px = 1e9;
  for (int i = 0; i < 600; ++i) {
    const RigidTransform pose = MakePose({0.1 + 0.001 * i, 0.0, 1.0}, {0.5, 0.4, 0.1});
    VisibleEdges fresh(camera_, edges_);
    const double expected_px = length_px(fresh.At(pose), pose);
    const double px = length_px(lines_.At(pose), pose);
    // Up to nine lines cross the border of the image. The visible part of each is at most 2 px too long or too short.
    EXPECT_NEAR(px, expected_px, 9 * 2.5) << i;
    longest_px = std::max(longest_px, px);
    shortest_px = std::min(shortest_px, px);
  }
  EXPECT_LT(shortest_px, 0.5 * longest_px);
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

// The cube with a painted line beside one of its edges.
TEST_F(VisibleEdgesTest, OfLinesBesideEachOtherOnlyOneIsExpected) {
  const RigidTransform pose = MakePose({0.0, 0.0, 1.0}, {0.5, 0.6, 0.0});
  for (const double width_m : {0.0005, 0.02}) {
    ObjectModel painted = *cube_;
    ModelLine inner = painted.lines[0];
    inner.kind = EdgeKind::kPainted;
    const Eigen::Vector3d middle = 0.5 * (inner.p1 + inner.p2);
    const Eigen::Vector3d inwards = (inner.face_normals[0] * inner.face_normals[0].dot(middle) - middle).normalized();
    inner.p1 = 0.98 * (inner.p1 - middle) + middle + width_m * inwards;
    inner.p2 = 0.98 * (inner.p2 - middle) + middle + width_m * inwards;
    painted.lines.push_back(inner);
    const ModelEdges edges(painted, TrackerOptions().visibility, {});
    VisibleEdges lines(camera_, edges);
    // The camera is on a side from which the edge is visible.
    RigidTransform seen = pose;
    if ((seen.rotation * inner.face_normals[0]).z() > 0.0)
      seen.rotation *= Eigen::AngleAxisd(M_PI, middle.normalized()).toRotationMatrix();
    size_t num_steps = 0;
    for (const TrackedLine& line : lines.At(seen)) num_steps += line.prior_contrast == kStepContrast;
    EXPECT_EQ(num_steps, width_m < 0.001 ? 1u : 0u);
  }
}

// Returns a cube without its edges. It has `count` straight lines of different lengths, which radiate from the middle
// of one face.
ObjectModel ManyLines(int count) {
  ObjectModel model = *MakeCube(0.1);
  model.lines.clear();
  for (int i = 0; i < count; ++i) {
    const double angle = 2.0 * M_PI * i / count, length_m = 0.02 + 0.03 * ((i * 7) % count) / count;
    ModelLine line{{0.0, 0.0, -0.05}, {length_m * std::cos(angle), length_m * std::sin(angle), -0.05}, {}};
    line.p1 = 0.1 * line.p2 + 0.9 * line.p1;
    line.face_normals.push_back({0.0, 0.0, -1.0});
    model.lines.push_back(line);
  }
  return model;
}

TEST(VisibleEdges, ChoosesTheLongestLinesOfAModelWithMany) {
  const ObjectModel model = ManyLines(1000);
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  const ModelEdges edges(model, TrackerOptions().visibility, {});
  EXPECT_TRUE(edges.has_many_lines());
  EXPECT_EQ(edges.num_curves(), 1000);
  VisibleEdges visible(camera, edges);
  const RigidTransform pose = MakePose({0.0, 0.0, 0.5}, {0.1, 0.1, 0.0});
  const absl::Span<const TrackedLine> lines = visible.At(pose);
  EXPECT_EQ(lines.size(), ModelEdges::kMaxLines);
  double shortest_m = 1.0;
  for (const TrackedLine& line : lines) shortest_m = std::min(shortest_m, (line.p2 - line.p1).norm());
  EXPECT_GT(shortest_m, 0.9 * 0.045);
  for (const TrackedLine& line : lines) EXPECT_TRUE(line.is_element);
  // The choice stays for a small change of the view and is the same after the state was loaded.
  const std::vector<TrackedLine> before(lines.begin(), lines.end());
  StateWriter writer;
  visible.SaveState(writer);
  const std::string state = writer.Take();
  VisibleEdges loaded(camera, edges);
  StateReader reader(state);
  loaded.LoadState(reader);
  ASSERT_TRUE(reader.Finish().ok());
  const RigidTransform next = MakePose({0.001, 0.0, 0.503}, {0.11, 0.1, 0.0});
  const absl::Span<const TrackedLine> a = visible.At(next), b = loaded.At(next);
  ASSERT_EQ(a.size(), b.size());
  for (size_t k = 0; k < a.size(); ++k) {
    EXPECT_EQ(a[k].curve, b[k].curve);
    EXPECT_EQ(a[k].curve, before[k].curve);
    EXPECT_EQ(a[k].p2, b[k].p2);
  }
}

TEST(VisibleEdges, CurvesOfALargeModelShareNumbers) {
  const ObjectModel model = ManyLines(3000);
  const ModelEdges edges(model, TrackerOptions().visibility, {});
  EXPECT_EQ(edges.num_curves(), ModelEdges::kMaxCurves);
  EXPECT_EQ(edges.CurveOf(7), 7);
  EXPECT_LT(edges.CurveOf(2999), edges.num_curves());
}

// A facet is 14 px wide; without a new extraction the outline would leave its edge by 0.37 px within 1.5 degrees.
TEST(VisibleEdges, ContoursOfFacetsStayOnTheOutline) {
  const ObjectModel model = WithFacets(CylinderModel(0.07, 0.06, 32));
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  const ModelEdges edges(model, TrackerOptions().visibility, {});
  VisibleEdges visible(camera, edges);
  for (int i = 0; i < 200; ++i) {
    RigidTransform pose = MakePose({0.0, 0.0, 0.5}, {1.4, 0.1, 0.0});
    pose.rotation = pose.rotation * Eigen::AngleAxisd(0.002 * i, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    const std::vector<Eigen::Vector2d> outline = OutlineOfVertices(model, pose, camera);
    double length_m = 0.0;
    for (const TrackedLine& line : visible.At(pose)) {
      if (line.kind != EdgeKind::kContour) continue;
      length_m += (line.p2 - line.p1).norm();
      for (const Eigen::Vector3d& end : {line.p1, line.p2}) {
        EXPECT_LT(DistanceFrom(outline, camera.Project(pose * end)), 0.12) << i;
      }
    }
    EXPECT_NEAR(length_m, 2 * 0.14, 0.01) << i;
  }
}

class RoundEdgesTest : public ::testing::Test {
 protected:
  // Returns the pose whose rotation vector is (1 + angle_rad, 0.2, 0).
  static RigidTransform PoseAt(double angle_rad) { return MakePose({0.0, 0.0, 0.5}, {1.0 + angle_rad, 0.2, 0.0}); }
  static bool HasElement(absl::Span<const TrackedLine> lines) {
    return std::any_of(lines.begin(), lines.end(), [](const TrackedLine& line) { return line.is_element; });
  }

  const ObjectModel torus_ = TorusModel(0.06, 0.02, 64, 32);
  const CameraModel camera_ = MakeCamera(640, 480, 600.0);
  const ModelEdges edges_{torus_, TrackerOptions().visibility, {}};
};

TEST_F(RoundEdgesTest, ElementsAreChainsOnOneSideOfTheirCurve) {
  VisibleEdges visible(camera_, edges_);
  const absl::Span<const TrackedLine> lines = visible.At(PoseAt(0.0));
  ASSERT_GT(lines.size(), 15u);
  size_t joints = 0;
  const Eigen::Vector3d eye = PoseAt(0.0).Inverse().translation_m;
  for (size_t k = 0; k < lines.size(); ++k) {
    EXPECT_TRUE(lines[k].is_element);
    EXPECT_LT(lines[k].curve, edges_.num_curves());
    EXPECT_GE(lines[k].curve, lines[k > 0 ? k - 1 : 0].curve);
    if (lines[k].next < 0) continue;
    const TrackedLine& next = lines[static_cast<size_t>(lines[k].next)];
    EXPECT_EQ(next.previous, static_cast<int>(k));
    // The ends of the arcs are at -2/3 of their sagittas from those of the lines.
    const Eigen::Vector3d gap = (next.p1 - 2.0 / 3.0 * next.sagitta) - (lines[k].p2 - 2.0 / 3.0 * lines[k].sagitta);
    EXPECT_LT(gap.norm() * 600.0 / (next.p1 - eye).norm(), 1.5);
    ++joints;
  }
  EXPECT_GT(joints, lines.size() * 3 / 4);
}

TEST_F(RoundEdgesTest, ContoursSlideBetweenExtractions) {
  VisibleEdges visible(camera_, edges_);
  const absl::Span<const TrackedLine> first = visible.At(PoseAt(0.0));
  const std::vector<TrackedLine> before(first.begin(), first.end());
  const absl::Span<const TrackedLine> after = visible.At(PoseAt(0.02));  // 1.1 degrees
  ASSERT_EQ(after.size(), before.size());
  size_t moved = 0;
  for (size_t k = 0; k < after.size(); ++k) {
    EXPECT_EQ(after[k].curve, before[k].curve);
    moved += after[k].p1 != before[k].p1 ? 1 : 0;
  }
  EXPECT_GT(moved, after.size() / 2);
  // Back at the first view the elements are the first ones again, because they slide from where they were extracted.
  const absl::Span<const TrackedLine> again = visible.At(PoseAt(0.0));
  for (size_t k = 0; k < again.size(); ++k) EXPECT_LT((again[k].p1 - before[k].p1).norm(), 1e-4);
}

TEST_F(RoundEdgesTest, ALoadedStateHasTheSameElements) {
  VisibleEdges visible(camera_, edges_);
  for (int i = 0; i < 40; ++i) {
    visible.At(PoseAt(0.011 * i));
    StateWriter writer;
    visible.SaveState(writer);
    const std::string state = writer.Take();
    VisibleEdges loaded(camera_, edges_);
    StateReader reader(state);
    loaded.LoadState(reader);
    ASSERT_TRUE(reader.Finish().ok());
    VisibleEdges copy = visible;
    const absl::Span<const TrackedLine> a = copy.At(PoseAt(0.011 * i + 0.004));
    const absl::Span<const TrackedLine> b = loaded.At(PoseAt(0.011 * i + 0.004));
    ASSERT_EQ(a.size(), b.size());
    for (size_t k = 0; k < a.size(); ++k) {
      EXPECT_EQ(a[k].curve, b[k].curve);
      EXPECT_EQ(a[k].p1, b[k].p1);
      EXPECT_EQ(a[k].next, b[k].next);
    }
  }
}

TEST_F(RoundEdgesTest, TheNumberOfElementsHasABound) {
  const ObjectModel dense = TorusModel(0.06, 0.02, 256, 128);
  const ModelEdges few(dense, TrackerOptions().visibility, {.max_elements = 60});
  VisibleEdges visible(camera_, few);
  EXPECT_LE(visible.At(PoseAt(0.0)).size(), 60u);
  EXPECT_TRUE(HasElement(visible.At(PoseAt(0.0))));
}

TEST(VisibleEdges, AFlatCapSeenEdgeOnIsNarrow) {
  const ObjectModel cylinder = CylinderModel(0.05, 0.04, 64);
  const ModelEdges edges(cylinder, TrackerOptions().visibility, {});
  const auto narrowest_px = [&](double height_m) {
    // The camera looks at the axis from the side, that much above the plane of the upper cap.
    const Eigen::Vector3d eye(0.5, 0.0, 0.05 + height_m);
    double least_px = 1e9;
    for (size_t k = 0; k < cylinder.curves.size(); ++k) {
      const auto curve = static_cast<uint32_t>(cylinder.lines.size() + k);
      const Eigen::Vector3d rim = cylinder.curves[k].points.front();
      least_px = std::min(least_px, edges.NarrowestFacePx(curve, eye - rim, 600.0));
    }
    return least_px;
  };
  EXPECT_LT(narrowest_px(0.002), 1.0);
  EXPECT_GT(narrowest_px(0.1), 10.0);
  const auto contour = static_cast<uint32_t>(cylinder.lines.size() + cylinder.curves.size());
  EXPECT_TRUE(std::isinf(edges.NarrowestFacePx(contour, {0.5, 0.0, 0.0}, 600.0)));
}

// The camera looks at the upper cap from that angle above its plane.
RigidTransform AboveCap(double angle_rad) {
  const Eigen::Vector3d cap(0.0, 0.0, 0.05), right(0.0, 1.0, 0.0);
  const Eigen::Vector3d forward = -Eigen::Vector3d(std::cos(angle_rad), 0.0, std::sin(angle_rad));
  RigidTransform object_from_camera;
  object_from_camera.rotation << right, forward.cross(right), forward;
  object_from_camera.translation_m = cap - 0.5 * forward;
  return object_from_camera.Inverse();
}

TEST(VisibleEdges, TheRimOfAFaceThatTurnsIsExtractedAgain) {
  const ObjectModel cylinder = CylinderModel(0.05, 0.04, 64);
  const CameraModel camera = MakeCamera(640, 480, 600.0);
  const ModelEdges edges(cylinder, TrackerOptions().visibility, {});
  ASSERT_EQ(edges.face_planes().size(), 2u);
  VisibleEdges visible(camera, edges), fresh(camera, edges);
  // The far side of the rim appears at once, although the view has changed by 0.2 degrees only.
  const absl::Span<const TrackedLine> before = visible.At(AboveCap(-0.003));
  const std::vector<TrackedLine> near_side(before.begin(), before.end());
  const absl::Span<const TrackedLine> after = visible.At(AboveCap(0.001)), expected = fresh.At(AboveCap(0.001));
  ASSERT_EQ(after.size(), expected.size());
  for (size_t k = 0; k < after.size(); ++k) EXPECT_EQ(after[k].p1, expected[k].p1) << k;
  const auto farthest = [](absl::Span<const TrackedLine> lines) {
    double x_m = 1.0;  // the camera is at positive x
    for (const TrackedLine& line : lines) {
      if (line.kind == EdgeKind::kCrease && line.p1.z() > 0.04) x_m = std::min(x_m, line.p1.x());
    }
    return x_m;
  };
  EXPECT_GT(farthest(near_side), -0.01);
  EXPECT_LT(farthest(after), -0.03);
  // The caps of a cylinder that is 10 px wide are too small for a difference.
  std::vector<bool> facing;
  edges.FacingPlanes({0.5, 0.0, 0.2}, 60.0, facing);
  EXPECT_EQ(facing, std::vector<bool>({false, false}));
  edges.FacingPlanes({0.5, 0.0, 0.2}, 600.0, facing);
  EXPECT_EQ(std::count(facing.begin(), facing.end(), true), 1);
}

}  // namespace
}  // namespace evpose
