// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/rivals.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "core/contours/contour_shapes_testing.h"
#include "core/models/continuous_symmetry.h"
#include "core/models/symmetry.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using Eigen::Vector3d;
using testing::MakePose;

const Vector3d kFacePoint(0.01, 0.02, 0.05);
const Vector3d kFaceNormal(0.0, 0.0, 1.0);

// The normal of the face is inclined by this angle out of the plane that is perpendicular to the view, and turns at
// this rate; the face moves in the image.
MotionState InclinedFace(double angle_rad, double rate_rad_per_s) {
  MotionState state;
  Eigen::Matrix3d upright;
  upright << 1, 0, 0, 0, 0, 1, 0, -1, 0;  // the object's z axis is the image's vertical
  state.camera_from_object.rotation = ExpSo3({angle_rad, 0, 0}) * upright;
  state.camera_from_object.translation_m = Vector3d(0, 0, 0.6) - state.camera_from_object.rotation * kFacePoint;
  state.twist << 0.1, 0.2, 0.3, rate_rad_per_s, 0.3, 0.2;
  state.covariance.setIdentity();
  return state;
}

MotionState Mirror(const MotionState& state) {
  return MirroredState(state, kFacePoint, kFaceNormal, kCamera.fx_px, InitialPoseOptions());
}

Vector3d NormalOf(const MotionState& state) { return state.camera_from_object.rotation * kFaceNormal; }

TEST(RivalsTest, TheMirroredNormalIsReflectedAtThePlaneOfTheImage) {
  const MotionState state = InclinedFace(0.1, 0.5);
  const MotionState mirrored = Mirror(state);
  const Vector3d normal = NormalOf(state);
  EXPECT_LT((NormalOf(mirrored) - Vector3d(normal.x(), normal.y(), -normal.z())).norm(), 1e-12);
  EXPECT_LT((mirrored.camera_from_object * kFacePoint - Vector3d(0, 0, 0.6)).norm(), 1e-12);
  EXPECT_NEAR(mirrored.camera_from_object.rotation.determinant(), 1.0, 1e-12);
  // Mirrored twice it is the same pose.
  EXPECT_LT((Mirror(mirrored).camera_from_object.rotation - state.camera_from_object.rotation).norm(), 1e-12);
}

TEST(RivalsTest, TheMirroredStateMovesAsTheMirrorImageDoes) {
  // The mirrored pose of a later state is the later state of the mirrored pose.
  constexpr double kStepS = 1e-5;
  const MotionState state = InclinedFace(0.1, 0.5);
  MotionState later = state;
  later.camera_from_object = Perturb(state.camera_from_object, kStepS * state.twist);
  const MotionState mirrored = Mirror(state);
  const Vector6d moved = Difference(Mirror(later).camera_from_object, mirrored.camera_from_object) / kStepS;
  // The turn about the normal itself is that of the state.
  const Vector3d turn = Vector3d(moved.tail<3>()) - mirrored.twist.tail<3>();
  EXPECT_LT(turn.cross(NormalOf(mirrored)).norm(), 1e-3);
  EXPECT_NEAR(mirrored.twist.tail<3>().dot(NormalOf(mirrored)), state.twist.tail<3>().dot(NormalOf(state)), 1e-12);
}

TEST(RivalsTest, TheMirroredTwistIsUncertainAboutTheHinge) {
  const MotionState mirrored = Mirror(InclinedFace(0.0, 2.0));
  EXPECT_GT(mirrored.covariance(9, 9), 4.0 + 9.0);
  EXPECT_DOUBLE_EQ(mirrored.covariance(6, 6), 4.0);
  EXPECT_LT(mirrored.covariance(3, 3), 0.001);
}

TEST(RivalsTest, AMovedStateMovesAsTheObjectDoes) {
  const MotionState state = InclinedFace(0.3, 1.0);
  const RigidTransform motion = MakePose({0.02, 0.01, -0.03}, {0.0, 0.0, 3.0});
  const MotionState moved = MovedState(state, motion, kCamera.fx_px, InitialPoseOptions());
  constexpr double kStepS = 1e-6;
  const RigidTransform later = Perturb(state.camera_from_object, kStepS * state.twist) * motion;
  EXPECT_LT((Difference(later, moved.camera_from_object) / kStepS - moved.twist).norm(), 1e-5);
}

class TurnedFaceTest : public ::testing::Test {
 protected:
  // The camera is that far above the plane of the upper cap, by angle.
  std::optional<size_t> Update(double angle_rad) { return Update(angle_rad, detector_); }
  static std::optional<size_t> Update(double angle_rad, TurnedFaceDetector& detector) {
    constexpr double kDistanceM = 0.6;
    const Vector3d cap(0.0, 0.0, kHalfHeightM);
    const Vector3d eye = cap + kDistanceM * Vector3d(std::cos(angle_rad), 0.0, std::sin(angle_rad));
    RigidTransform object_from_camera;
    const Vector3d forward = (cap - eye).normalized(), right = Vector3d(0, 1, 0);
    object_from_camera.rotation << right, forward.cross(right), forward;
    object_from_camera.translation_m = eye;
    return detector.Update(object_from_camera.Inverse(), kCamera.fx_px);
  }

  static constexpr double kHalfHeightM = 0.05;
  const ObjectModel cylinder_ = CylinderModel(kHalfHeightM, 0.04, 64);
  const ModelEdges edges_{cylinder_, TrackerOptions().visibility, {}};
  TurnedFaceDetector detector_{edges_, 0.012};
};

TEST_F(TurnedFaceTest, ARivalIsDueOnceWhenAFaceHasPassedTheEdgeOnView) {
  ASSERT_EQ(edges_.face_planes().size(), 2u);
  EXPECT_FALSE(Update(0.3)) << "not yet edge-on";
  EXPECT_FALSE(Update(0.03));
  EXPECT_FALSE(Update(0.008)) << "not near enough";
  EXPECT_FALSE(Update(0.03)) << "and away again";
  EXPECT_FALSE(Update(0.002));
  EXPECT_FALSE(Update(-0.008)) << "passed, but not yet inclined";
  const std::optional<size_t> due = Update(-0.02);
  ASSERT_TRUE(due.has_value());
  EXPECT_GT(edges_.face_planes()[*due].normal.z(), 0.9);
  EXPECT_FALSE(Update(-0.03)) << "once";
}

TEST_F(TurnedFaceTest, ARivalIsDueWhenTheFaceTurnsBack) {
  EXPECT_FALSE(Update(0.03));
  EXPECT_FALSE(Update(0.001));
  EXPECT_TRUE(Update(0.03));
}

TEST_F(TurnedFaceTest, ARivalIsDueAfterAJump) {
  EXPECT_FALSE(Update(0.03));
  EXPECT_TRUE(Update(-0.03));
  detector_.Reset();
  EXPECT_FALSE(Update(0.03)) << "another pose";
}

TEST_F(TurnedFaceTest, TheStateCanBeSaved) {
  Update(0.001);
  StateWriter writer;
  detector_.SaveState(writer);
  const std::string state = writer.Take();
  TurnedFaceDetector loaded(edges_, 0.012);
  StateReader reader(state);
  loaded.LoadState(reader);
  ASSERT_TRUE(reader.Finish().ok());
  EXPECT_TRUE(Update(0.03, loaded));
}

TEST(RivalGeneratorTest, ACubeHasNone) {
  const std::shared_ptr<const ObjectModel> cube = Cube();
  const RivalGenerator generator(*cube);
  EXPECT_TRUE(generator.RivalsOf(InclinedFace(0.3, 0.0), kCamera.fx_px, InitialPoseOptions(), 0.02).empty());
}

TEST(RivalGeneratorTest, APlateHasItsFlip) {
  ObjectModel plate = PlateWithHoles(0.04, 0.02, 0.005, 64, {-0.09, 0.0, 0.09});
  plate.symmetries = FindSymmetries(plate);
  const RivalGenerator generator(plate);
  const MotionState state = InclinedFace(0.5, 0.0);
  const std::vector<MotionState> rivals = generator.RivalsOf(state, kCamera.fx_px, InitialPoseOptions(), 0.02);
  ASSERT_FALSE(rivals.empty());
  ASSERT_LE(rivals.size(), static_cast<size_t>(RivalGenerator::kMaxRivals));
  const auto differ = [&](const MotionState& a, const MotionState& b) {
    const RigidTransform nearest = NearestEquivalent(a.camera_from_object, plate, b.camera_from_object);
    return RotationAngle(nearest.rotation, b.camera_from_object.rotation);
  };
  for (size_t i = 0; i < rivals.size(); ++i) {
    EXPECT_GE(differ(rivals[i], state), 0.02) << i;
    for (size_t j = 0; j < i; ++j) EXPECT_GE(differ(rivals[i], rivals[j]), 0.02) << i << ", " << j;
  }
}

TEST(RivalGeneratorTest, ASquareBarHasItsQuarterTurn) {
  for (const double height_m : {0.04, 0.06}) {
    ObjectModel bar;
    const Vector3d corners[] = {{-0.02, -0.5 * height_m, 0.0},
                                {0.02, -0.5 * height_m, 0.0},
                                {0.02, 0.5 * height_m, 0.0},
                                {-0.02, 0.5 * height_m, 0.0}};
    const Vector3d along(0.0, 0.0, 0.1), groove(0.005, 0.0, 0.0);
    for (int i = 0; i < 4; ++i) {
      for (const Vector3d& end : {Vector3d(Vector3d::Zero()), along}) {
        bar.lines.push_back({corners[i] + end, corners[(i + 1) % 4] + end, {}, EdgeKind::kCrease});
      }
      bar.lines.push_back({corners[i], corners[i] + along, {}, EdgeKind::kCrease});
    }
    bar.lines.push_back({corners[0] + groove, corners[0] + groove + along, {}, EdgeKind::kPainted});
    const MotionState state = InclinedFace(0.5, 0.0);
    const std::vector<MotionState> rivals =
        RivalGenerator(bar).RivalsOf(state, kCamera.fx_px, InitialPoseOptions(), 0.02);
    const auto is_quarter = [&](const MotionState& rival) {
      const double angle = RotationAngle(rival.camera_from_object.rotation, state.camera_from_object.rotation);
      return std::abs(angle - 0.5 * std::numbers::pi) < 1e-9;
    };
    EXPECT_EQ(std::count_if(rivals.begin(), rivals.end(), is_quarter) >= 2, height_m == 0.04) << height_m;
  }
}

TEST(RivalGeneratorTest, TheHalfTurnOfPaintedLinesIsAboutTheirCentre) {
  // A rectangle drawn beside the only face of the model, which is a triangle.
  ObjectModel drawing;
  const Vector3d corners[] = {{0.01, 0.02, 0.0}, {0.07, 0.02, 0.0}, {0.07, 0.06, 0.0}, {0.01, 0.06, 0.0}};
  drawing.vertices = {{-0.2, -0.1, 0.0}, {-0.1, -0.1, 0.0}, {-0.15, -0.05, 0.0}};
  drawing.triangles = {{0, 1, 2}};
  for (int i = 0; i < 4; ++i) drawing.lines.push_back({corners[i], corners[(i + 1) % 4], {}, EdgeKind::kPainted});
  const MotionState state = InclinedFace(0.5, 0.0);
  const std::vector<MotionState> rivals =
      RivalGenerator(drawing).RivalsOf(state, kCamera.fx_px, InitialPoseOptions(), 0.02);
  const auto turns = [&](const MotionState& rival) {
    return (rival.camera_from_object * corners[0] - state.camera_from_object * corners[2]).norm() < 1e-9 &&
           (rival.camera_from_object * corners[1] - state.camera_from_object * corners[3]).norm() < 1e-9;
  };
  EXPECT_EQ(std::count_if(rivals.begin(), rivals.end(), turns), 1);
}

TEST(RivalGeneratorTest, ATiltedRivalIsTurnedAboutAnAxisAcrossTheRay) {
  constexpr double kTiltRad = 0.17;
  ObjectModel plate = PlateWithHoles(0.04, 0.02, 0.005, 64, {-0.09, 0.0, 0.09});
  const RivalGenerator generator(plate);
  const MotionState state = InclinedFace(0.5, 1.0);
  const std::vector<MotionState> rivals =
      generator.TiltedRivalsOf(state, kTiltRad, kCamera.fx_px, InitialPoseOptions(), 0.02);
  ASSERT_EQ(rivals.size(), 4u);
  const Vector3d centre = state.camera_from_object * generator.centroid();
  Vector3d sum = Vector3d::Zero();
  for (const MotionState& rival : rivals) {
    const Vector3d turn = LogSo3(rival.camera_from_object.rotation * state.camera_from_object.rotation.transpose());
    EXPECT_NEAR(turn.norm(), kTiltRad, 1e-12);
    EXPECT_NEAR(turn.dot(centre.normalized()), 0.0, 1e-12);
    EXPECT_LT((rival.camera_from_object * generator.centroid() - centre).norm(), 1e-12);
    sum += turn;
  }
  EXPECT_LT(sum.norm(), 1e-12);
}

TEST(RivalGeneratorTest, TiltsThatASymmetryUndoesAreLeftOut) {
  ObjectModel ball = SphereModel(0.05, 12, true);
  ball.continuous_symmetry = ContinuousSymmetry{ContinuousSymmetry::Kind::kSphere};
  const MotionState state = InclinedFace(0.5, 1.0);
  EXPECT_TRUE(RivalGenerator(ball).TiltedRivalsOf(state, 0.17, kCamera.fx_px, InitialPoseOptions(), 0.02).empty());
}

class TiltTestTriggerTest : public ::testing::Test {
 protected:
  // Whether tilted rivals are due when the object is turned by this angle about the vertical axis of the image.
  bool UpdateTurned(double turn_rad, double roll_rad = 0.0, double distance_m = 0.6, double residual_px = 0.5) {
    const Vector3d ray = Vector3d(0.1, 0.0, 1.0).normalized();
    RigidTransform pose;
    pose.rotation = ExpSo3(roll_rad * ray) * ExpSo3({0.0, turn_rad, 0.0});
    pose.translation_m = distance_m * ray - pose.rotation * kFacePoint;
    return trigger_.Update(pose, kFacePoint, residual_px);
  }
  // The number of windows with this turn and residual until tilted rivals are due; at most 100.
  int WindowsUntilDue(double turn_rad, double residual_px) {
    for (int i = 1; i <= 100; ++i) {
      if (UpdateTurned(turn_rad, 0.0, 0.6, residual_px)) return i;
    }
    return 100;
  }
  TiltTestTrigger trigger_{0.1, 1.3};
};

TEST_F(TiltTestTriggerTest, TiltedRivalsAreDueWhenTheViewHasTurned) {
  EXPECT_TRUE(UpdateTurned(0.0)) << "a new pose";
  EXPECT_FALSE(UpdateTurned(0.09));
  EXPECT_TRUE(UpdateTurned(0.11));
  EXPECT_FALSE(UpdateTurned(0.02)) << "0.09 from the latest test";
  EXPECT_TRUE(UpdateTurned(0.0));
  EXPECT_FALSE(UpdateTurned(0.0, 1.0)) << "the object is turned in the image only";
  EXPECT_FALSE(UpdateTurned(0.0, 0.0, 0.9)) << "the same ray";
  trigger_.Reset();
  EXPECT_TRUE(UpdateTurned(0.0)) << "another pose";
}

TEST_F(TiltTestTriggerTest, TiltedRivalsAreDueEarlierWhenTheResidualHasGrown) {
  ASSERT_EQ(WindowsUntilDue(0.0, 0.5), 1) << "a new pose";
  EXPECT_EQ(WindowsUntilDue(0.04, 0.6), 100);
  EXPECT_EQ(WindowsUntilDue(0.0, 0.8), 100) << "the object has not turned";
  EXPECT_EQ(WindowsUntilDue(0.0, 0.5), 100);
  const int windows = WindowsUntilDue(0.04, 0.8);
  EXPECT_GT(windows, 2) << "single windows do not count";
  EXPECT_LT(windows, 20);
  EXPECT_EQ(WindowsUntilDue(0.08, 0.7), 100) << "it is compared with that of the latest test";
}

TEST_F(TiltTestTriggerTest, TheStateCanBeSaved) {
  ASSERT_TRUE(UpdateTurned(0.3));
  StateWriter writer;
  trigger_.SaveState(writer);
  const std::string state = writer.Take();
  trigger_.Reset();
  StateReader reader(state);
  trigger_.LoadState(reader);
  ASSERT_TRUE(reader.Finish().ok());
  EXPECT_FALSE(UpdateTurned(0.35));
  EXPECT_TRUE(UpdateTurned(0.41));
}

}  // namespace
}  // namespace evpose
