// SPDX-License-Identifier: Apache-2.0
#include "core/models/continuous_symmetry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/models/cube_files_testing.h"
#include "core/models/lathe_testing.h"
#include "core/models/symmetry.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using Kind = ContinuousSymmetry::Kind;

const RigidTransform kPlacement = {ExpSo3({0.7, -0.4, 1.9}), {2.0, -1.0, 0.5}};

std::optional<ContinuousSymmetry> Find(const ObjectModel& model) { return FindContinuousSymmetry(model, nullptr); }

double Degrees(double rad) { return rad * kDegreesPerRadian; }

// Adds a straight painted line.
void Paint(const Eigen::Vector3d& p1, const Eigen::Vector3d& p2, ObjectModel& model) {
  model.lines.push_back({p1, p2, {}, EdgeKind::kPainted});
}

// --- Symmetric objects

struct RoundShape {
  std::string name;
  std::function<ObjectModel(int)> make;
  bool is_flippable;
  double centre_height_m;  // of a flippable one
};

std::vector<RoundShape> RoundShapes() {
  return {{"cylinder", [](int sides) { return lathe::Cylinder(sides); }, true, 0.0},
          {"disc", [](int sides) { return lathe::Cylinder(sides, 0.5, 0.02); }, true, 0.0},
          {"rod", [](int sides) { return lathe::Cylinder(sides, 0.05, 3.0); }, true, 0.0},
          {"capsule", lathe::Capsule, true, 0.0},
          {"torus", lathe::Torus, true, 0.0},
          {"cone", lathe::Cone, false, 0.0},
          {"bottle", lathe::Bottle, false, 0.0}};
}

TEST(ContinuousSymmetryTest, SurfacesOfRevolutionHaveTheirAxis) {
  for (const RoundShape& shape : RoundShapes()) {
    for (const int sides : {24, 36, 64, 120}) {
      for (const RigidTransform& placement : {RigidTransform(), kPlacement}) {
        SCOPED_TRACE(absl::StrCat(shape.name, " of ", sides, " sides"));
        ObjectModel model = shape.make(sides);
        lathe::Move(placement, model);
        std::vector<std::string> notices;
        const std::optional<ContinuousSymmetry> found = FindContinuousSymmetry(model, &notices);
        ASSERT_TRUE(found.has_value());
        EXPECT_THAT(notices, IsEmpty());
        EXPECT_EQ(found->kind, Kind::kAxis);
        EXPECT_EQ(found->is_flippable, shape.is_flippable);
        const Eigen::Vector3d axis = placement.rotation.col(2);
        EXPECT_LE(Degrees(std::asin(std::min(1.0, axis.cross(found->axis).norm()))), 0.3);
        EXPECT_LE(axis.cross(found->centre - placement.translation_m).norm(), 1e-3 * model.diameter_m);
        if (shape.is_flippable) {
          const Eigen::Vector3d centre = placement * Eigen::Vector3d(0, 0, shape.centre_height_m);
          EXPECT_LE((found->centre - centre).norm(), 1e-3 * model.diameter_m);
        }
      }
    }
  }
}

TEST(ContinuousSymmetryTest, ABallIsASphere) {
  for (const int sides : {24, 64, 120}) {
    ObjectModel model = lathe::Ball(sides);
    lathe::Move(kPlacement, model);
    const std::optional<ContinuousSymmetry> found = Find(model);
    ASSERT_TRUE(found.has_value());
    EXPECT_EQ(found->kind, Kind::kSphere);
    EXPECT_LE((found->centre - kPlacement.translation_m).norm(), 1e-3);
  }
}

TEST(ContinuousSymmetryTest, AnUnevenBallIsReportedAsNearlyASphere) {
  const auto uneven = [](double height) {
    std::vector<lathe::LathePiece> profile;
    lathe::AppendArc({0, 0}, 0.5, -M_PI / 2, M_PI / 2, 24, profile);
    return lathe::Lathe(profile, 48, [height](double angle, double z, double radius) {
      return radius * (1.0 + height * std::sin(3 * angle + 5 * z));
    });
  };
  std::vector<std::string> notices;
  EXPECT_FALSE(FindContinuousSymmetry(uneven(0.015), &notices).has_value());
  EXPECT_THAT(notices, ::testing::Contains(HasSubstr("nearly a sphere")));
  notices.clear();
  EXPECT_FALSE(FindContinuousSymmetry(uneven(0.1), &notices).has_value());
  EXPECT_THAT(notices, ::testing::Not(::testing::Contains(HasSubstr("nearly a sphere"))));
}

TEST(ContinuousSymmetryTest, ABallWithARingHasTheAxisOfTheRing) {
  for (const double height : {0.0, 0.3}) {
    ObjectModel model = lathe::Ball(64);
    EdgeCurve ring;
    const double radius = std::sqrt(0.25 - height * height);
    for (int i = 0; i <= 64; ++i) {
      const double angle = 2 * M_PI * (i % 64) / 64;
      ring.points.push_back({radius * std::cos(angle), radius * std::sin(angle), height});
    }
    ring.kind = EdgeKind::kPainted;
    model.curves.push_back(ring);
    lathe::Move(kPlacement, model);
    const std::optional<ContinuousSymmetry> found = Find(model);
    ASSERT_TRUE(found.has_value());
    EXPECT_EQ(found->kind, Kind::kAxis);
    EXPECT_LE(Degrees(std::asin(kPlacement.rotation.col(2).cross(found->axis).norm())), 0.3);
    EXPECT_EQ(found->is_flippable, height == 0.0);
  }
}

TEST(ContinuousSymmetryTest, APrismOfManySidesIsRoundByTolerance) {
  for (const int sides : {64, 100, 500}) {
    const std::optional<ContinuousSymmetry> found = Find(MustParse(Prism(sides)));
    ASSERT_TRUE(found.has_value()) << sides;
    EXPECT_EQ(found->kind, Kind::kAxis);
    EXPECT_TRUE(found->is_flippable);
    EXPECT_LE((found->centre - Eigen::Vector3d(0, 0, 0.5)).norm(), 1e-3);
  }
}

TEST(ContinuousSymmetryTest, NoDiscreteSymmetriesAreSearchedFor) {
  ObjectModel model = MustParse(Prism(64));
  model.continuous_symmetry = Find(model);
  ASSERT_TRUE(model.continuous_symmetry.has_value());
  EXPECT_THAT(FindSymmetries(model), IsEmpty());
}

// --- Objects without one

TEST(ContinuousSymmetryTest, PolygonalObjectsHaveNone) {
  const std::string plate =
      "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 .05\nv 1 0 .05\nv 1 1 .05\nv 0 1 .05\n" + std::string(kCubeFaces);
  for (const std::string& obj :
       {Cube(), Prism(3), Prism(6), Prism(8), plate, std::string("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")}) {
    std::vector<std::string> notices;
    EXPECT_FALSE(FindContinuousSymmetry(MustParse(obj), &notices).has_value()) << obj;
    EXPECT_THAT(notices, IsEmpty()) << obj;
  }
}

TEST(ContinuousSymmetryTest, AGearHasNone) {
  const auto teeth = [](double angle, double, double radius) {
    return radius > 0.29 && std::sin(12.0 * angle + 0.01) > 0.0 ? 0.33 : radius;
  };
  EXPECT_FALSE(Find(lathe::Lathe({lathe::StraightPiece({0, 0}, {0.3, 0}), lathe::StraightPiece({0.3, 0}, {0.3, 0.1}),
                                  lathe::StraightPiece({0.3, 0.1}, {0, 0.1})},
                                 240, teeth))
                   .has_value());
}

TEST(ContinuousSymmetryTest, AMugWithAHandleHasNone) {
  ObjectModel mug = lathe::Cylinder(64, 0.4, 1.0);
  ObjectModel handle = lathe::Torus(32);
  // Half of the ring is inside the mug.
  for (Eigen::Vector3d& vertex : handle.vertices) vertex *= 0.5;
  lathe::Move({ExpSo3({M_PI / 2, 0, 0}), {0.4, 0, 0}}, handle);
  const auto first = static_cast<uint32_t>(mug.vertices.size());
  mug.vertices.insert(mug.vertices.end(), handle.vertices.begin(), handle.vertices.end());
  for (const auto& [i, j, k] : handle.triangles) mug.triangles.push_back({first + i, first + j, first + k});
  mug.surface.normals.insert(mug.surface.normals.end(), handle.surface.normals.begin(), handle.surface.normals.end());
  EXPECT_FALSE(Find(mug).has_value());
}

// --- Nearly symmetric objects

TEST(ContinuousSymmetryTest, AKeywayBreaksTheSymmetry) {
  const auto keyway = [](double angle, double height, double radius) {
    return radius == 0.1 && angle > 1.0 && angle < 1.3 && height > 0.2 && height < 0.8 ? 0.08 : radius;
  };
  std::vector<lathe::LathePiece> profile = {lathe::StraightPiece({0, 0}, {0.1, 0})};
  for (int i = 0; i < 20; ++i) profile.push_back(lathe::StraightPiece({0.1, 0.05 * i}, {0.1, 0.05 * (i + 1)}));
  profile.push_back(lathe::StraightPiece({0.1, 1}, {0, 1}));
  EXPECT_TRUE(Find(lathe::Lathe(profile, 120)).has_value());
  ObjectModel shaft = lathe::Lathe(profile, 120, keyway);
  EXPECT_FALSE(Find(shaft).has_value()) << "by its surface alone";
  for (const double angle : {1.0, 1.3}) {
    shaft.lines.push_back(
        {{0.1 * std::cos(angle), 0.1 * std::sin(angle), 0.2}, {0.1 * std::cos(angle), 0.1 * std::sin(angle), 0.8}, {}});
  }
  EXPECT_FALSE(Find(shaft).has_value());
}

TEST(ContinuousSymmetryTest, APaintedLineBreaksTheSymmetryAndIsReported) {
  ObjectModel model = lathe::Cylinder(64);
  Paint({0.3, 0, -0.2}, {0.3, 0, 0.2}, model);
  std::vector<std::string> notices;
  EXPECT_FALSE(FindContinuousSymmetry(model, &notices).has_value());
  EXPECT_THAT(
      notices,
      ElementsAre(HasSubstr("nearly symmetric about the axis (0.000, 0.000, 1.000), but its lines contradict it")));
}

TEST(ContinuousSymmetryTest, ALineOnTheAxisDoesNot) {
  ObjectModel model = lathe::Cylinder(64);
  Paint({0, 0, 0.5}, {0, 0, 0.9}, model);
  const std::optional<ContinuousSymmetry> found = Find(model);
  ASSERT_TRUE(found.has_value());
  EXPECT_FALSE(found->is_flippable);
}

TEST(ContinuousSymmetryTest, AnIncompleteRingBreaksTheSymmetry) {
  ObjectModel model = lathe::Cylinder(64);
  ASSERT_TRUE(Find(model).has_value());
  std::vector<Eigen::Vector3d>& points = model.curves[0].points;
  points.resize(points.size() - 3);
  model.curves[0].face_normals.resize(points.size() - 1);
  EXPECT_FALSE(Find(model).has_value());
}

TEST(ContinuousSymmetryTest, ASmallDentWithoutLinesBreaksTheSymmetry) {
  const auto dent = [](double angle, double height, double radius) {
    return radius == 0.3 && std::abs(angle - 2.0) < 0.2 && height == 0.5 ? 0.28 : radius;
  };
  std::vector<lathe::LathePiece> profile = {lathe::StraightPiece({0, 0}, {0.3, 0})};
  for (int i = 0; i < 20; ++i) profile.push_back(lathe::StraightPiece({0.3, 0.05 * i}, {0.3, 0.05 * (i + 1)}));
  profile.push_back(lathe::StraightPiece({0.3, 1}, {0, 1}));
  ASSERT_TRUE(Find(lathe::Lathe(profile, 100)).has_value());
  std::vector<std::string> notices;
  EXPECT_FALSE(FindContinuousSymmetry(lathe::Lathe(profile, 100, dent), &notices).has_value());
  EXPECT_THAT(notices, ElementsAre(HasSubstr("its surface")));
}

TEST(ContinuousSymmetryTest, AModelWithoutASurfaceHasNone) {
  EXPECT_FALSE(Find(ObjectModel()).has_value());
  EXPECT_FALSE(Find(MustParse("v 0 0 0\nv 1 0 0\nv 1 1 0\nl 1 2 3 1\n")).has_value());
}

// --- Single rotations of surfaces without edges (FindSurfaceGroup)

// A ball whose mesh is turned relative to the axes of the coordinates. The test objects are deformed copies of it. No
// rotation maps their vertices onto vertices.
ObjectModel ObliqueBall(int sides) {
  ObjectModel model = lathe::Ball(sides);
  lathe::Move({ExpSo3({0.9, 0.4, -0.3}), Eigen::Vector3d::Zero()}, model);
  return model;
}

// A ball of three different radii.
ObjectModel Ellipsoid(int sides) {
  const Eigen::Array3d radii(1.0, 0.8, 0.6);
  ObjectModel model = ObliqueBall(sides);
  for (Eigen::Vector3d& vertex : model.vertices) vertex = vertex.array() * radii;
  for (auto& corners : model.surface.normals) {
    for (Eigen::Vector3f& normal : corners) normal = (normal.array() / radii.cast<float>()).matrix().normalized();
  }
  return model;
}

// Stretches a model away from z, by a function of the angle about z and of the height.
ObjectModel Stretched(ObjectModel model, const std::function<double(double, double)>& factor) {
  for (Eigen::Vector3d& vertex : model.vertices) {
    vertex.head<2>() *= factor(std::atan2(vertex.y(), vertex.x()), vertex.z());
  }
  return model;
}

// A ball with three lobes about z; those of the lower half are smaller by `taper`.
ObjectModel Lobes(int sides, double taper) {
  return Stretched(ObliqueBall(sides), [taper](double angle, double height) {
    return 1.0 + 0.1 * (1.0 + taper * height) * std::cos(3.0 * angle);
  });
}

TEST(SurfaceSymmetryTest, SurfacesWithoutEdgesHaveTheirRotations) {
  struct Case {
    ObjectModel model;
    size_t count;
    double least_angle_deg;
  };
  for (const int sides : {24, 50}) {
    for (const RigidTransform& placement : {RigidTransform(), kPlacement}) {
      for (Case& c : std::vector<Case>{
               {Ellipsoid(sides), 4, 180.0}, {Lobes(sides, 0.0), 6, 120.0}, {Lobes(sides, 0.5), 3, 120.0}}) {
        SCOPED_TRACE(absl::StrCat(sides, " sides, ", c.count, " rotations"));
        lathe::Move(placement, c.model);
        ASSERT_FALSE(Find(c.model).has_value());
        const std::vector<RigidTransform> symmetries = FindSymmetries(c.model);
        ASSERT_EQ(symmetries.size(), c.count);
        for (size_t i = 1; i < symmetries.size(); ++i) {
          const double angle_rad = RotationAngle(symmetries[i].rotation, Eigen::Matrix3d::Identity());
          EXPECT_GE(Degrees(angle_rad), c.least_angle_deg - 1e-3);
          EXPECT_LE((symmetries[i] * placement.translation_m - placement.translation_m).norm(), 0.05);
          for (const RigidTransform& other : symmetries) {
            const RigidTransform product = symmetries[i] * other;
            EXPECT_TRUE(std::any_of(symmetries.begin(), symmetries.end(), [&](const RigidTransform& any) {
              return Degrees(RotationAngle(any.rotation, product.rotation)) < 0.5;
            }));
          }
        }
      }
    }
  }
}

TEST(SurfaceSymmetryTest, ALobeThatDiffersLeavesAHalfTurnAboutItself) {
  // One lobe is longer; then the longest part is between two lobes.
  for (const auto& [angle_rad, count] : {std::pair<double, size_t>{0.0, 2}, {M_PI / 6, 1}}) {
    const ObjectModel model = Stretched(ObliqueBall(50), [longest = angle_rad](double angle, double) {
      return 1.0 + 0.2 * std::cos(3.0 * angle) + 0.1 * std::cos(angle - longest);
    });
    EXPECT_EQ(FindSymmetries(model).size(), count);
  }
}

TEST(SurfaceSymmetryTest, LobesOnAShallowOvalAreOnlyThoseOfTheOval) {
  // A turn by one of 16 lobes moves the oval by less than the tolerance, one by a quarter of a turn by more.
  const ObjectModel model = Stretched(lathe::Ball(128), [](double angle, double) {
    return (1.0 + 0.008 * std::cos(2.0 * angle)) * (1.0 + 0.1 * std::cos(16.0 * angle));
  });
  ASSERT_FALSE(Find(model).has_value());
  EXPECT_EQ(FindSymmetries(model).size(), 4u);
}

TEST(SurfaceSymmetryTest, TheWorkIsBoundedAndTheResultDoesNotDependOnThePlacement) {
  // The intervals of angles at which half turns are accepted are wide.
  const ObjectModel model =
      Stretched(lathe::Ball(90), [](double angle, double) { return 1.0 + 0.02 * std::cos(3.0 * angle); });
  ASSERT_FALSE(Find(model).has_value());
  for (const RigidTransform& placement : {RigidTransform(), kPlacement}) {
    ObjectModel moved = model;
    lathe::Move(placement, moved);
    SymmetryWork work;
    EXPECT_EQ(FindSymmetries(moved, 1e-3, nullptr, &work).size(), 6u);
    EXPECT_LE(work.surface_samples, 1'000'000);
    EXPECT_GT(work.surface_samples, 0);
  }
}

// --- Equivalent poses

const ContinuousSymmetry kAxis = {Kind::kAxis, {0.1, -0.2, 0.3}, Eigen::Vector3d(1, 2, -2).normalized(), false};

TEST(EquivalentPoseTest, TheNearestIsThatOfATrialOfAllAngles) {
  const RigidTransform pose = {ExpSo3({0.4, 1.2, -0.6}), {0.1, 0.2, 3.0}};
  const RigidTransform reference = {ExpSo3({-0.3, 0.9, 0.2}), {0.1, 0.2, 3.0}};
  for (const bool is_flippable : {false, true}) {
    ContinuousSymmetry symmetry = kAxis;
    symmetry.is_flippable = is_flippable;
    const RigidTransform nearest = NearestEquivalent(pose, symmetry, reference);
    const double angle = RotationAngle(nearest.rotation, reference.rotation);
    double least = 10.0;
    const Eigen::Vector3d across = symmetry.axis.unitOrthogonal();
    for (int flip = 0; flip <= (is_flippable ? 1 : 0); ++flip) {
      for (int i = 0; i < 3600; ++i) {
        const Eigen::Matrix3d spin = ExpSo3(flip * M_PI * across) * ExpSo3(i * M_PI / 1800 * symmetry.axis);
        least = std::min(least, RotationAngle(pose.rotation * spin, reference.rotation));
      }
    }
    EXPECT_NEAR(angle, least, 1e-5);
    EXPECT_LT((nearest * symmetry.centre - pose * symmetry.centre).norm(), 1e-12);
    const double axes = std::abs((nearest.rotation * symmetry.axis).dot(pose.rotation * symmetry.axis));
    EXPECT_NEAR(axes, 1.0, 1e-12);
  }
}

TEST(EquivalentPoseTest, OfASphereTheRotationIsTheReference) {
  const ContinuousSymmetry ball = {Kind::kSphere, {0.1, -0.2, 0.3}, Eigen::Vector3d::Zero(), false};
  const RigidTransform pose = {ExpSo3({0.4, 1.2, -0.6}), {0.1, 0.2, 3.0}};
  const RigidTransform reference = {ExpSo3({-0.3, 0.9, 0.2}), {0, 0, 1}};
  const RigidTransform nearest = NearestEquivalent(pose, ball, reference);
  EXPECT_LT((nearest.rotation - reference.rotation).norm(), 1e-12);
  EXPECT_LT((nearest * ball.centre - pose * ball.centre).norm(), 1e-12);
}

TEST(EquivalentPoseTest, OppositeAxesKeepThePose) {
  const RigidTransform reference = {ExpSo3(M_PI * kAxis.axis.unitOrthogonal()), {0, 0, 1}};
  const RigidTransform nearest = NearestWithoutFlip(RigidTransform(), kAxis, reference);
  EXPECT_TRUE(nearest.rotation.isIdentity(1e-12));
}

TEST(EquivalentPoseTest, FreeDirectionsAreThoseOfTheGroup) {
  const RigidTransform pose = {ExpSo3({0.4, 1.2, -0.6}), {0.1, 0.2, 3.0}};
  const double angle = 1e-6;
  const FreeDirections free = FreeDirectionsAt(kAxis, pose);
  ASSERT_EQ(free.cols(), 1);
  const Vector6d moved = Difference(pose * AboutCentre(kAxis, ExpSo3(angle * kAxis.axis)), pose) / angle;
  EXPECT_LT((moved - free.col(0)).norm(), 1e-5);
  const ContinuousSymmetry ball = {Kind::kSphere, kAxis.centre, Eigen::Vector3d::Zero(), false};
  const FreeDirections sphere = FreeDirectionsAt(ball, pose);
  ASSERT_EQ(sphere.cols(), 3);
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d axis = pose.rotation.transpose() * Eigen::Vector3d::Unit(i);
    const Vector6d turned = Difference(pose * AboutCentre(ball, ExpSo3(angle * axis)), pose) / angle;
    EXPECT_LT((turned - sphere.col(i)).norm(), 1e-5);
  }
}

}  // namespace
}  // namespace evpose
