// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/region_shapes.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>

#include "core/mesh/surface_patch_testing.h"
#include "core/mesh/surface_regions.h"

namespace evpose {
namespace {

using ::testing::Each;
using ::testing::Field;
using ::testing::SizeIs;

constexpr double kDiameterM = 3.0;

SurfacePatch CylinderPatch(uint32_t sides, double radius_m, bool is_convex) {
  return GridPatch({.u = sides, .v = 2, .wraps_u = true}, [&](double u, double v) -> Eigen::Vector3d {
    return radius_m * OnCircle(is_convex ? u : -u) + 2.0 * v * Eigen::Vector3d::UnitZ();
  });
}

SurfacePatch FrustumPatch(uint32_t sides, double low_radius_m, double high_radius_m) {
  return GridPatch({.u = sides, .v = 3, .wraps_u = true}, [&](double u, double v) -> Eigen::Vector3d {
    return (low_radius_m + v * (high_radius_m - low_radius_m)) * OnCircle(u) + 2.0 * v * Eigen::Vector3d::UnitZ();
  });
}

// A band around the equator.
SurfacePatch SpherePatch(uint32_t sides, const Eigen::Vector3d& semi_axes, bool is_convex) {
  return GridPatch({.u = sides, .v = sides / 2, .wraps_u = true}, [&](double u, double v) -> Eigen::Vector3d {
    const double latitude = 2.5 * (v - 0.5);
    const Eigen::Vector3d point =
        std::cos(latitude) * OnCircle(is_convex ? u : -u) + std::sin(latitude) * Eigen::Vector3d::UnitZ();
    return semi_axes.cwiseProduct(point);
  });
}

// A profile that is swept along z: flat parts of the lengths, each followed by a quarter of a circle with `strips`.
SurfacePatch RoundedProfile(const std::vector<double>& lengths, double radius_m, int strips, bool is_closed) {
  std::vector<Eigen::Vector3d> profile = {Eigen::Vector3d::Zero()};
  double heading = 0.0;
  const auto direction = [](double angle) { return Eigen::Vector3d(std::cos(angle), std::sin(angle), 0.0); };
  for (size_t part = 0; part < lengths.size(); ++part) {
    profile.push_back(profile.back() + lengths[part] * direction(heading));
    if (part + 1 == lengths.size() && !is_closed) break;
    const Eigen::Vector3d centre = profile.back() + radius_m * direction(heading + M_PI_2);
    for (int i = 1; i <= strips; ++i) {
      profile.push_back(centre + radius_m * direction(heading - M_PI_2 + M_PI_2 * i / strips));
    }
    heading += M_PI_2;
  }
  if (is_closed) profile.pop_back();
  const uint32_t cells = static_cast<uint32_t>(profile.size()) - (is_closed ? 0 : 1);
  return GridPatch({.u = cells, .v = 4, .wraps_u = is_closed}, [&](double u, double v) -> Eigen::Vector3d {
    return profile[std::lround(u * cells)] + v * Eigen::Vector3d::UnitZ();
  });
}

// Largest difference between a corner normal and that of its region's shape.
double NormalError(const SurfacePatch& patch) {
  double largest = 0.0;
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    const SurfaceRegion& region = patch.surface.regions[patch.surface.region_of[t]];
    for (int corner = 0; corner < 3; ++corner) {
      const Eigen::Vector3d normal = NormalOfShape(region, patch.mesh.points[patch.mesh.triangles[t][corner]]);
      largest = std::max(largest, (normal - patch.surface.normals[t][corner].cast<double>()).norm());
    }
  }
  return largest;
}

// Largest difference between the normals that triangles have at a common vertex.
double NormalJump(const SurfacePatch& patch) {
  std::map<uint32_t, Eigen::Vector3f> first;
  double largest = 0.0;
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    for (int corner = 0; corner < 3; ++corner) {
      const Eigen::Vector3f& normal = patch.surface.normals[t][corner];
      const auto entry = first.try_emplace(patch.mesh.triangles[t][corner], normal).first;
      largest = std::max<double>(largest, (entry->second - normal).norm());
    }
  }
  return largest;
}

// Whether each corner normal is within 60 degrees of its facet's normal.
bool PointsOutward(const SurfacePatch& patch) {
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    const auto& [i, j, k] = patch.mesh.triangles[t];
    const std::vector<Eigen::Vector3d>& p = patch.mesh.points;
    const Eigen::Vector3d facet = (p[j] - p[i]).cross(p[k] - p[i]).normalized();
    for (const Eigen::Vector3f& normal : patch.surface.normals[t]) {
      if (!(facet.dot(normal.cast<double>()) > 0.5)) return false;
    }
  }
  return true;
}

int CountShape(const SmoothSurface& surface, RegionShape shape) {
  return static_cast<int>(std::count_if(surface.regions.begin(), surface.regions.end(),
                                        [&](const SurfaceRegion& region) { return region.shape == shape; }));
}

double DistanceFromAxis(const SurfaceRegion& region, const Eigen::Vector3d& point) {
  return (point - region.point).cross(region.axis).norm();
}

struct CylinderCase {
  uint32_t sides;
  bool is_convex;
  double noise_m;
};

class CylinderTest : public ::testing::TestWithParam<CylinderCase> {};

TEST_P(CylinderTest, HasTheRadiusOfItsVerticesAndExactNormals) {
  const auto& [sides, is_convex, noise_m] = GetParam();
  SurfacePatch patch = CylinderPatch(sides, 0.7, is_convex);
  const Eigen::Isometry3d placement = ObliquePlacement();
  Place(placement, patch);
  if (noise_m > 0.0) AddNoise(noise_m, patch);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_THAT(patch.surface.regions, SizeIs(1));
  const SurfaceRegion& region = patch.surface.regions[0];
  ASSERT_EQ(region.shape, RegionShape::kCylinder);
  EXPECT_EQ(region.is_convex, is_convex);
  const double tolerance = 1e-9 + 2.0 * noise_m;
  EXPECT_NEAR(region.radius_m, 0.7, tolerance);
  EXPECT_LT(region.axis.cross(placement.linear().col(2)).norm(), tolerance);
  EXPECT_LT(DistanceFromAxis(region, placement.translation()), tolerance);
  EXPECT_LT(NormalError(patch), 1e-6);
  EXPECT_TRUE(PointsOutward(patch));
}

INSTANTIATE_TEST_SUITE_P(All, CylinderTest,
                         ::testing::Values(CylinderCase{8, true, 0.0}, CylinderCase{16, true, 0.0},
                                           CylinderCase{32, false, 0.0}, CylinderCase{64, true, 0.0},
                                           CylinderCase{256, true, 0.0}, CylinderCase{8, false, 1e-6},
                                           CylinderCase{32, true, 1e-6}, CylinderCase{256, false, 1e-6},
                                           CylinderCase{64, true, 1e-4}));

// The silhouette of 32 facets is 0.16 % too small on average; points of the facets must move to the cylinder.
TEST(RegionShapesTest, PointsOfFacetsAreProjectedToTheCylinder) {
  SurfacePatch patch = CylinderPatch(32, 0.7, true);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  const auto& [i, j, k] = patch.mesh.triangles[0];
  const Eigen::Vector3d middle = 0.5 * (patch.mesh.points[i] + patch.mesh.points[j]);
  EXPECT_LT(middle.head<2>().norm(), 0.997 * 0.7);
  EXPECT_NEAR(ProjectToShape(patch.surface.regions[0], middle).head<2>().norm(), 0.7, 1e-9);
}

TEST(RegionShapesTest, VerticesOffTheCylinderKeepItFree) {
  SurfacePatch patch = CylinderPatch(64, 0.7, true);
  AddNoise(0.01, patch);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  EXPECT_THAT(patch.surface.regions, Each(Field(&SurfaceRegion::shape, RegionShape::kFree)));
}

TEST(RegionShapesTest, FrustumIsACone) {
  for (const double high_radius_m : {0.3, 0.95}) {
    for (const uint32_t sides : {12u, 48u}) {
      SurfacePatch patch = FrustumPatch(sides, 1.0, high_radius_m);
      const Eigen::Isometry3d placement = ObliquePlacement();
      Place(placement, patch);
      AddNoise(0.0, patch);
      FitShapes(patch.mesh, kDiameterM, patch.surface);
      ASSERT_THAT(patch.surface.regions, SizeIs(1));
      const SurfaceRegion& region = patch.surface.regions[0];
      ASSERT_EQ(region.shape, RegionShape::kCone) << high_radius_m << " " << sides;
      EXPECT_TRUE(region.is_convex);
      const double slope = (1.0 - high_radius_m) / 2.0;
      EXPECT_NEAR(region.half_angle_rad, std::atan(slope), 1e-6);
      EXPECT_GT(region.axis.dot(-placement.linear().col(2)), 1.0 - 1e-12);
      const Eigen::Vector3d apex = placement * Eigen::Vector3d(0.0, 0.0, 1.0 / slope);
      EXPECT_LT((region.point - apex).norm(), 2e-6 / (slope * slope));
      EXPECT_LT(NormalError(patch), 1e-6);
      EXPECT_TRUE(PointsOutward(patch));
    }
  }
}

TEST(RegionShapesTest, ConeWithApexHasTheNormalOfEachFacetThere) {
  SurfacePatch patch;
  constexpr uint32_t kSides = 24;
  patch.mesh.points.push_back({0.0, 0.0, 1.0});
  for (uint32_t i = 0; i < kSides; ++i) patch.mesh.points.push_back(OnCircle(static_cast<double>(i) / kSides));
  for (uint32_t i = 0; i < kSides; ++i) patch.mesh.triangles.push_back({0, 1 + i, 1 + (i + 1) % kSides});
  Place(ObliquePlacement(), patch);
  AddNoise(0.0, patch);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_EQ(patch.surface.regions[0].shape, RegionShape::kCone);
  EXPECT_NEAR(patch.surface.regions[0].half_angle_rad, M_PI_4, 1e-6);
  EXPECT_LT((patch.surface.regions[0].point - patch.mesh.points[0]).norm(), 1e-6);
  for (const auto& normals : patch.surface.normals) {
    const Eigen::Vector3f middle = (normals[1] + normals[2]).normalized();
    EXPECT_LT((normals[0] - middle).norm(), 0.01);
    EXPECT_NEAR(normals[0].norm(), 1.0, 1e-6);
  }
}

TEST(RegionShapesTest, SphereIsFoundFromBothSides) {
  for (const bool is_convex : {true, false}) {
    for (const uint32_t sides : {16u, 64u}) {
      SurfacePatch patch = SpherePatch(sides, Eigen::Vector3d::Constant(0.8), is_convex);
      const Eigen::Isometry3d placement = ObliquePlacement();
      Place(placement, patch);
      AddNoise(0.0, patch);
      FitShapes(patch.mesh, kDiameterM, patch.surface);
      ASSERT_THAT(patch.surface.regions, SizeIs(1));
      const SurfaceRegion& region = patch.surface.regions[0];
      ASSERT_EQ(region.shape, RegionShape::kSphere);
      EXPECT_EQ(region.is_convex, is_convex);
      EXPECT_NEAR(region.radius_m, 0.8, 1e-6);
      EXPECT_LT((region.point - placement.translation()).norm(), 1e-6);
      EXPECT_LT(NormalError(patch), 1e-6);
      EXPECT_TRUE(PointsOutward(patch));
    }
  }
}

TEST(RegionShapesTest, TorusAndEllipsoidStayFreeWithTheirNormals) {
  const SurfacePatch torus =
      GridPatch({.u = 48, .v = 24, .wraps_u = true, .wraps_v = true}, [](double u, double v) -> Eigen::Vector3d {
        const Eigen::Vector3d tube = OnCircle(v);
        return (1.0 + 0.3 * tube.x()) * OnCircle(u) + 0.3 * tube.y() * Eigen::Vector3d::UnitZ();
      });
  for (const SurfacePatch& before :
       {torus, SpherePatch(16, {1.0, 0.7, 0.5}, true), SpherePatch(128, {1.0, 0.7, 0.5}, true)}) {
    SurfacePatch patch = before;
    FitShapes(patch.mesh, kDiameterM, patch.surface);
    ASSERT_THAT(patch.surface.regions, SizeIs(1));
    EXPECT_EQ(patch.surface.regions[0].shape, RegionShape::kFree);
    EXPECT_EQ(patch.surface.normals, before.surface.normals);
  }
}

TEST(RegionShapesTest, FlatRegionIsAPlane) {
  SurfacePatch patch = GridPatch({.u = 5, .v = 5}, [](double u, double v) -> Eigen::Vector3d {
    return {u, v * v, 0.0};
  });
  const Eigen::Isometry3d placement = ObliquePlacement();
  Place(placement, patch);
  AddNoise(1e-6, patch);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_TRUE(patch.surface.regions[0].is_flat());
  EXPECT_GT(patch.surface.regions[0].axis.dot(placement.linear().col(2)), 1.0 - 1e-9);
  EXPECT_LT(NormalError(patch), 1e-6);
}

TEST(RegionShapesTest, FilletIsCutFromItsFaces) {
  for (const int strips : {4, 32}) {
    SurfacePatch patch = RoundedProfile({1.0, 0.8}, 0.1, strips, false);
    Place(ObliquePlacement(), patch);
    AddNoise(0.0, patch);
    FitShapes(patch.mesh, kDiameterM, patch.surface);
    ASSERT_THAT(patch.surface.regions, SizeIs(3)) << strips;
    EXPECT_EQ(CountShape(patch.surface, RegionShape::kPlane), 2);
    ASSERT_EQ(CountShape(patch.surface, RegionShape::kCylinder), 1);
    for (const SurfaceRegion& region : patch.surface.regions) {
      if (!region.is_flat()) {
        EXPECT_NEAR(region.radius_m, 0.1, 1e-5);
      }
    }
    // The flat parts have one normal; the fillet continues it.
    EXPECT_LT(NormalError(patch), 1e-3);
    EXPECT_LT(NormalJump(patch), 1e-6);
    EXPECT_TRUE(PointsOutward(patch));
  }
}

TEST(RegionShapesTest, WallOfARoundedPlateHasFourPlanesAndFourCylinders) {
  SurfacePatch patch = RoundedProfile({1.0, 0.6, 1.0, 0.6}, 0.2, 8, true);
  AddNoise(0.0, patch);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_THAT(patch.surface.regions, SizeIs(8));
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kPlane), 4);
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kCylinder), 4);
  EXPECT_LT(NormalJump(patch), 1e-6);
}

TEST(RegionShapesTest, RoundedRimStaysFreeAndContinuesTheNormalOfItsPlane) {
  constexpr int kStrips = 6;
  SurfacePatch patch =
      GridPatch({.u = kStrips + 1, .v = 96, .wraps_v = true}, [](double u, double v) -> Eigen::Vector3d {
        const double step = std::lround(u * (kStrips + 1)) - 1.0;  // -1 is the inner border of the flat ring
        const double angle = std::max(0.0, step) * M_PI_2 / kStrips;
        const double radius = step < 0.0 ? 0.4 : 1.0 + 0.1 * std::sin(angle);
        return radius * OnCircle(v) + 0.1 * (std::cos(angle) - 1.0) * Eigen::Vector3d::UnitZ();
      });
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_THAT(patch.surface.regions, SizeIs(2));
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kPlane), 1);
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kFree), 1);
  EXPECT_LT(NormalJump(patch), 1e-6);
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    for (int corner = 0; corner < 3; ++corner) {
      if (patch.mesh.points[patch.mesh.triangles[t][corner]].z() < -1e-9) continue;
      EXPECT_LT((patch.surface.normals[t][corner] - Eigen::Vector3f::UnitZ()).norm(), 1e-6);
    }
  }
}

// The surface of revolution of a profile of (radius, height) points, from the bottom up.
SurfacePatch Revolved(const std::vector<Eigen::Vector2d>& profile, uint32_t sides) {
  const uint32_t rows = static_cast<uint32_t>(profile.size()) - 1;
  return GridPatch({.u = sides, .v = rows, .wraps_u = true}, [&](double u, double v) -> Eigen::Vector3d {
    const Eigen::Vector2d& point = profile[std::lround(v * rows)];
    return point.x() * OnCircle(u) + point.y() * Eigen::Vector3d::UnitZ();
  });
}

// A straight wall of radius 0.5 and height 1 with rounded ends of radius `round_m`.
std::vector<Eigen::Vector2d> WallWithRoundedEnds(double round_m) {
  std::vector<Eigen::Vector2d> profile;
  for (const double end : {-1.0, 1.0}) {
    for (int i = 0; i <= 5; ++i) {
      const double angle = end * 0.25 * (end < 0.0 ? 5 - i : i);
      profile.push_back({0.5 + round_m * (std::cos(angle) - 1.0), 0.5 * end + round_m * std::sin(angle)});
    }
  }
  return profile;
}

// Mean normals would tilt at the ends of the wall, and a patch through them would bulge like a barrel.
TEST(RegionShapesTest, WallBetweenFilletsIsACylinder) {
  SurfacePatch patch = Revolved(WallWithRoundedEnds(0.1), 32);
  Place(ObliquePlacement(), patch);
  AddNoise(0.0, patch);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_THAT(patch.surface.regions, SizeIs(3));
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kCylinder), 1);
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kFree), 2);
  EXPECT_LT(NormalJump(patch), 1e-5);
  EXPECT_TRUE(PointsOutward(patch));
}

TEST(RegionShapesTest, CapsuleIsACylinderAndTwoSpheres) {
  SurfacePatch patch = Revolved(WallWithRoundedEnds(0.5), 32);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_THAT(patch.surface.regions, SizeIs(3));
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kCylinder), 1);
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kSphere), 2);
  EXPECT_LT(NormalJump(patch), 1e-6);
}

// Each of its rings is a part of a cone.
TEST(RegionShapesTest, VaseOfTallRingsStaysFree) {
  std::vector<Eigen::Vector2d> profile;
  for (int i = 0; i <= 8; ++i) profile.push_back({0.6 + 0.2 * std::sin(0.7 * i), 0.25 * i});
  SurfacePatch patch = Revolved(profile, 32);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_THAT(patch.surface.regions, SizeIs(1));
  EXPECT_EQ(patch.surface.regions[0].shape, RegionShape::kFree);
}

// The normals of a strip of one facet would jump at both of its borders.
TEST(RegionShapesTest, FilletOfOneStripStaysFreeWithContinuousNormals) {
  SurfacePatch patch = RoundedProfile({1.0, 0.8}, 0.1, 1, false);
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  ASSERT_THAT(patch.surface.regions, SizeIs(3));
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kPlane), 2);
  EXPECT_EQ(CountShape(patch.surface, RegionShape::kFree), 1);
  EXPECT_LT(NormalJump(patch), 1e-6);
}

TEST(RegionShapesTest, KnownShapeStays) {
  SurfacePatch patch = CylinderPatch(16, 0.7, true);
  patch.surface.regions[0].shape = RegionShape::kCylinder;
  patch.surface.regions[0].radius_m = 0.71;
  const SmoothSurface before = patch.surface;
  FitShapes(patch.mesh, kDiameterM, patch.surface);
  EXPECT_EQ(patch.surface.regions[0].radius_m, 0.71);
  EXPECT_EQ(patch.surface.normals, before.normals);
}

TEST(RegionShapesTest, ProjectionsLieOnTheShapeAlongItsNormal) {
  SurfaceRegion region;
  region.point = {0.1, 0.2, 0.3};
  region.axis = Eigen::Vector3d(1.0, -2.0, 2.0) / 3.0;
  region.radius_m = 0.5;
  region.half_angle_rad = 0.4;
  region.is_convex = false;
  const Eigen::Vector3d point = region.point + Eigen::Vector3d(0.9, -0.4, 1.0);
  for (const RegionShape shape :
       {RegionShape::kPlane, RegionShape::kCylinder, RegionShape::kCone, RegionShape::kSphere}) {
    region.shape = shape;
    const Eigen::Vector3d on = ProjectToShape(region, point), normal = NormalOfShape(region, point);
    EXPECT_LT((ProjectToShape(region, on) - on).norm(), 1e-12);
    EXPECT_LT((NormalOfShape(region, on) - normal).norm(), 1e-12);
    EXPECT_NEAR(normal.norm(), 1.0, 1e-12);
    EXPECT_LT((point - on).cross(normal).norm(), 1e-12);
    EXPECT_GT((point - on).norm(), 0.1);
  }
  region.shape = RegionShape::kFree;
  EXPECT_EQ(ProjectToShape(region, point), point);
  for (const RegionShape shape : {RegionShape::kCylinder, RegionShape::kCone, RegionShape::kSphere}) {
    region.shape = shape;
    EXPECT_EQ(ProjectToShape(region, region.point), region.point);
    EXPECT_TRUE(NormalOfShape(region, region.point).isZero());
  }
}

double SmoothPointError(double angle) {
  const Eigen::Vector3d a = Eigen::Vector3d::UnitX();
  const Eigen::Vector3d b(std::cos(angle), std::sin(angle), 0.0), c(std::cos(angle), 0.0, std::sin(angle));
  double largest = 0.0;
  for (int i = 0; i <= 8; ++i) {
    for (int j = 0; i + j <= 8; ++j) {
      const Eigen::Vector3d barycentric = Eigen::Vector3d(i, j, 8 - i - j) / 8.0;
      largest = std::max(largest, std::abs(SmoothPoint({a, b, c}, {a, b, c}, barycentric).norm() - 1.0));
    }
  }
  return largest;
}

TEST(RegionShapesTest, SmoothPointIsOfFourthOrderOnASphere) {
  const double chord_error = 1.0 - std::cos(0.1);  // of the middle of an edge of 0.2 rad
  EXPECT_LT(SmoothPointError(0.2), 0.05 * chord_error);
  EXPECT_NEAR(SmoothPointError(0.2) / SmoothPointError(0.1), 16.0, 1.0);
}

// A cube with the side `size`, centred at the origin, with a chamfer at each edge and a triangle at each corner. `cut`
// is the distance between a border of a chamfer and the edge that it replaces.
RawMesh ChamferedCube(double size, double cut) {
  RawMesh mesh;
  const double half = 0.5 * size, inner = half - cut;
  // Point 8 axis + i is the corner of the face across `axis`; bits of i: signs of x, y and z.
  for (int axis = 0; axis < 3; ++axis) {
    for (int i = 0; i < 8; ++i) {
      Eigen::Vector3d point;
      for (int k = 0; k < 3; ++k) point[k] = ((i >> k & 1) != 0 ? 1.0 : -1.0) * (k == axis ? half : inner);
      mesh.points.push_back(point);
    }
  }
  const auto add = [&mesh](uint32_t a, uint32_t b, uint32_t c) {
    const Eigen::Vector3d &p = mesh.points[a], &q = mesh.points[b], &r = mesh.points[c];
    const bool is_outward = (q - p).cross(r - p).dot(p + q + r) > 0.0;
    mesh.triangles.push_back({a, is_outward ? b : c, is_outward ? c : b});
  };
  const auto add_quad = [&add](uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
    add(a, b, c);
    add(a, c, d);
  };
  for (uint32_t axis = 0; axis < 3; ++axis) {
    const uint32_t u = 1u << (axis + 1) % 3, v = 1u << (axis + 2) % 3, w = 1u << axis;
    for (const uint32_t side : {0u, w}) {
      const uint32_t first = 8 * axis + side;
      add_quad(first, first + u, first + u + v, first + v);
    }
    // The chamfers along `axis`, between the faces across the other two.
    for (const uint32_t i : {0u, u, v, u + v}) {
      const uint32_t a = 8 * ((axis + 1) % 3) + i, b = 8 * ((axis + 2) % 3) + i;
      add_quad(a, a + w, b + w, b);
    }
  }
  for (uint32_t i = 0; i < 8; ++i) add(i, 8 + i, 16 + i);
  return mesh;
}

TEST(FitShapesTest, ChamfersWithCutCornersStayFlat) {
  const RawMesh mesh = ChamferedCube(1.0, 0.02);
  const double diameter_m = std::sqrt(3.0);
  SurfaceEdges found = FindSurface(mesh, {}, diameter_m);
  FitShapes(mesh, diameter_m, found.surface);
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    std::array<Eigen::Vector3d, 3> corners, normals;
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    for (size_t i = 0; i < 3; ++i) {
      corners[i] = mesh.points[mesh.triangles[t][i]];
      normals[i] = found.surface.normals[t][i].cast<double>();
      middle += corners[i] / 3.0;
    }
    const Eigen::Vector3d point = SmoothPoint(corners, normals, Eigen::Vector3d::Constant(1.0 / 3.0));
    EXPECT_LT((point - middle).norm(), 0.002 * diameter_m) << "triangle " << t;
  }
}

}  // namespace
}  // namespace evpose
