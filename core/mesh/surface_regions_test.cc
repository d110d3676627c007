// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/surface_regions.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <tuple>

#include "core/mesh/facet_graph.h"

namespace evpose {
namespace {

using ::testing::SizeIs;

constexpr double kPi = std::numbers::pi;

// A surface of rotation about z: rings of `sides` points at each radius and height; a radius of 0 is a pole.
RawMesh Turned(const std::vector<Eigen::Vector2d>& profile, int sides) {
  RawMesh mesh;
  std::vector<uint32_t> first;
  for (const Eigen::Vector2d& point : profile) {
    first.push_back(static_cast<uint32_t>(mesh.points.size()));
    const int count = point.x() == 0.0 ? 1 : sides;
    for (int i = 0; i < count; ++i) {
      const double angle = 2 * kPi * i / sides;
      mesh.points.push_back({point.x() * std::cos(angle), point.x() * std::sin(angle), point.y()});
    }
  }
  for (size_t ring = 0; ring + 1 < profile.size(); ++ring) {
    for (int i = 0; i < sides; ++i) {
      const auto at = [&](size_t r, int k) {
        return profile[r].x() == 0.0 ? first[r] : first[r] + static_cast<uint32_t>(k % sides);
      };
      const uint32_t a = at(ring, i), b = at(ring, i + 1), c = at(ring + 1, i + 1), d = at(ring + 1, i);
      if (a != b) mesh.triangles.push_back({a, b, c});
      if (c != d) mesh.triangles.push_back({a, c, d});
    }
  }
  return mesh;
}

RawMesh ClosedCylinder(int sides, double radius = 1.0, double height = 2.0) {
  return Turned({{0, 0}, {radius, 0}, {radius, height}, {0, height}}, sides);
}

// A box with 2 x 2 triangles on each side, whose corner is the origin.
RawMesh BoxMesh(const Eigen::Vector3d& size) {
  RawMesh mesh;
  for (int i = 0; i < 8; ++i) {
    mesh.points.push_back(Eigen::Vector3d(i & 1, i >> 1 & 1, i >> 2 & 1).cwiseProduct(size));
  }
  for (const auto& [a, b, c, d] : std::initializer_list<std::array<uint32_t, 4>>{
           {0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {1, 3, 7, 5}, {3, 2, 6, 7}, {2, 0, 4, 6}}) {
    mesh.triangles.push_back({a, b, c});
    mesh.triangles.push_back({a, c, d});
  }
  return mesh;
}

// Appends another mesh, moved by `offset`.
void Append(const RawMesh& other, const Eigen::Vector3d& offset, RawMesh& mesh) {
  const auto first = static_cast<uint32_t>(mesh.points.size());
  for (const Eigen::Vector3d& point : other.points) mesh.points.push_back(point + offset);
  for (const auto& [a, b, c] : other.triangles) mesh.triangles.push_back({first + a, first + b, first + c});
}

double DiagonalOf(const RawMesh& mesh) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : mesh.points) box.extend(point);
  return box.diagonal().norm();
}

SurfaceEdges Find(const RawMesh& mesh, const CreaseOptions& options = {}) {
  return FindSurface(mesh, options, DiagonalOf(mesh));
}

size_t NumCreases(const RawMesh& mesh) {
  const SurfaceEdges found = Find(mesh);
  return std::count_if(found.edges.begin(), found.edges.end(),
                       [](const MeshEdge& edge) { return edge.kind == EdgeKind::kCrease; });
}

size_t CountOf(const SmoothSurface& surface, RegionShape shape) {
  return std::count_if(surface.regions.begin(), surface.regions.end(),
                       [&](const SurfaceRegion& region) { return region.shape == shape; });
}

TEST(SurfaceRegionsTest, CubeHasTwelveCreasesAndSixPlanes) {
  const RawMesh cube = BoxMesh({1, 1, 1});
  const SurfaceEdges found = Find(cube);
  ASSERT_THAT(found.edges, SizeIs(12));
  for (const MeshEdge& edge : found.edges) {
    EXPECT_EQ(edge.kind, EdgeKind::kCrease);
    EXPECT_NEAR(edge.turn_rad, kPi / 2, 1e-12);
    EXPECT_THAT(edge.triangles, SizeIs(2));
  }
  EXPECT_THAT(found.surface.regions, SizeIs(6));
  EXPECT_EQ(CountOf(found.surface, RegionShape::kPlane), 6u);
  for (size_t t = 0; t < cube.triangles.size(); ++t) {
    const SurfaceRegion& region = found.surface.regions[found.surface.region_of[t]];
    EXPECT_NEAR((cube.points[cube.triangles[t][0]] - region.point).dot(region.axis), 0.0, 1e-12);
    EXPECT_GT(found.surface.normals[t][2].cast<double>().dot(region.axis), 1.0 - 1e-6);
    EXPECT_GT((region.point - Eigen::Vector3d(0.5, 0.5, 0.5)).dot(region.axis), 0.49) << "outward";
  }
}

TEST(SurfaceRegionsTest, ThinPlatesAndSmallStepsKeepTheirCreases) {
  for (const double thickness : {0.1, 0.04, 0.03, 0.02, 0.01, 0.001}) {
    EXPECT_THAT(Find(BoxMesh({1, 1, thickness})).edges, SizeIs(12)) << thickness;
  }
  // A step in a sheet: two boundaries and two creases across it, and the boundaries along it.
  for (const double height : {0.1, 0.03, 0.02, 0.01, 0.002}) {
    RawMesh step;
    for (const auto& [x, z] :
         std::initializer_list<std::pair<double, double>>{{0, 0}, {1, 0}, {1, height}, {2, height}}) {
      step.points.push_back({x, 0, z});
      step.points.push_back({x, 1, z});
    }
    for (uint32_t i = 0; i < 6; i += 2) {
      step.triangles.push_back({i, i + 2, i + 3});
      step.triangles.push_back({i, i + 3, i + 1});
    }
    EXPECT_THAT(Find(step).edges, SizeIs(10)) << height;
  }
}

TEST(SurfaceRegionsTest, CylindersOfAnyTessellationHaveTwoRims) {
  for (const int sides : {16, 24, 48, 96, 256}) {
    const SurfaceEdges found = Find(ClosedCylinder(sides));
    EXPECT_THAT(found.edges, SizeIs(2 * sides)) << sides;
    EXPECT_EQ(CountOf(found.surface, RegionShape::kPlane), 2u) << sides;
    EXPECT_EQ(CountOf(found.surface, RegionShape::kFree), 1u) << sides;
  }
  // If it is as wide as the object, it is a prism.
  EXPECT_THAT(Find(ClosedCylinder(8)).edges, SizeIs(24));
}

TEST(SurfaceRegionsTest, ThinRodOfFewSidesIsRound) {
  RawMesh mesh = ClosedCylinder(10, 0.05, 2.0);  // turns by 36 degrees, but within 0.25 % of the round rod
  EXPECT_THAT(Find(mesh).edges, SizeIs(20));
}

TEST(SurfaceRegionsTest, NormalsOfACylinderAreRadial) {
  const RawMesh mesh = ClosedCylinder(24);
  const SmoothSurface surface = Find(mesh).surface;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (surface.regions[surface.region_of[t]].is_flat()) continue;
    for (int corner = 0; corner < 3; ++corner) {
      Eigen::Vector3d outward = mesh.points[mesh.triangles[t][corner]];
      outward.z() = 0.0;
      EXPECT_GT(surface.normals[t][corner].cast<double>().dot(outward.normalized()), 0.9999);
    }
  }
}

TEST(SurfaceRegionsTest, FilletsAreSmoothAndChamfersAreNot) {
  // A box profile with a quarter circle in four chords instead of its upper edge.
  std::vector<Eigen::Vector2d> profile = {{0, 0}, {1, 0}};
  for (int i = 0; i <= 4; ++i) {
    const double angle = i * kPi / 8;
    profile.push_back({0.9 + 0.1 * std::cos(angle), 0.9 + 0.1 * std::sin(angle)});
  }
  profile.push_back({0, 1});
  EXPECT_THAT(Find(Turned(profile, 64)).edges, SizeIs(64)) << "the lower rim only";
  for (const double width : {0.2, 0.1, 0.05, 0.04, 0.03, 0.02, 0.005}) {
    const RawMesh chamfer = Turned({{0, 0}, {1, 0}, {1, 1 - width}, {1 - width, 1}, {0, 1}}, 64);
    EXPECT_THAT(Find(chamfer).edges, SizeIs(3 * 64)) << width;
  }
}

TEST(SurfaceRegionsTest, NoisySphereHasNoCreases) {
  // Points are moved by up to 0.1 % of the diameter, so that many facets turn by more than 18 degrees.
  std::vector<Eigen::Vector2d> profile;
  constexpr int kRings = 240;
  for (int i = kRings / 4; i <= kRings * 3 / 4; ++i) {  // without the poles, where facets are narrow
    profile.push_back({std::sin(kPi * i / kRings), -std::cos(kPi * i / kRings)});
  }
  RawMesh sphere = Turned(profile, 2 * kRings);
  std::mt19937 random(5);
  for (Eigen::Vector3d& point : sphere.points) {
    point *= 1.0 + 0.004 * (static_cast<double>(random() % 1000) / 1000.0 - 0.5);
  }
  const FacetGraph graph(sphere);
  size_t num_sharp = 0;
  for (uint32_t side = 0; side < 3 * sphere.triangles.size(); ++side)
    num_sharp += std::abs(graph.turn_rad(side)) > 0.32;
  EXPECT_GT(num_sharp, 10'000u);
  EXPECT_LT(NumCreases(sphere), num_sharp / 100);
}

TEST(SurfaceRegionsTest, CreaseAngleIsTheLeastJump) {
  EXPECT_THAT(Find(ClosedCylinder(16), {.crease_angle_deg = 20.0}).edges, SizeIs(48));
  EXPECT_THAT(Find(BoxMesh({1, 1, 1}), {.crease_angle_deg = 95.0}).edges, SizeIs(0));
}

TEST(SurfaceRegionsTest, FacetsAsTheyAreHaveNoRegions) {
  const SurfaceEdges found = Find(ClosedCylinder(10, 0.05, 2.0), {.is_smooth = false});
  EXPECT_THAT(found.edges, SizeIs(30));
  EXPECT_TRUE(found.surface.empty());
}

// A roof whose ridge turns by the mean of two successive angles in each segment.
RawMesh Roof(const std::vector<double>& degrees) {
  RawMesh mesh;
  for (size_t i = 0; i < degrees.size(); ++i) {
    const double angle = degrees[i] / 2 * kPi / 180, x = 0.3 * static_cast<double>(i);
    mesh.points.push_back({x, -std::cos(angle), -std::sin(angle)});
    mesh.points.push_back({x, 0, 0});
    mesh.points.push_back({x, std::cos(angle), -std::sin(angle)});
  }
  for (uint32_t i = 0; i + 3 < mesh.points.size(); i += 3) {
    for (const uint32_t k : {i, i + 1}) {
      mesh.triangles.push_back({k, k + 3, k + 4});
      mesh.triangles.push_back({k, k + 4, k + 1});
    }
  }
  return mesh;
}

TEST(SurfaceRegionsTest, CreaseIsContinuedThroughWeakParts) {
  EXPECT_EQ(NumCreases(Roof({40, 40, 40, 40, 26, 26, 26, 40, 40, 40, 40})), 10u);
  EXPECT_EQ(NumCreases(Roof({26, 26, 26, 26, 26, 26, 26, 26})), 0u) << "nothing strong to continue";
}

// Squares of side 1 in the plane; with `height`, at random heights up to that.
RawMesh Sheet(uint32_t squares, double height) {
  RawMesh mesh;
  std::mt19937 random(2);
  for (uint32_t y = 0; y <= squares; ++y) {
    for (uint32_t x = 0; x <= squares; ++x) {
      mesh.points.emplace_back(x, y, height * static_cast<double>(random() % 1000) / 1000.0);
    }
  }
  for (uint32_t y = 0; y < squares; ++y) {
    for (uint32_t x = 0; x < squares; ++x) {
      const uint32_t a = y * (squares + 1) + x, b = a + squares + 1;
      mesh.triangles.push_back({a, a + 1, b + 1});
      mesh.triangles.push_back({a, b + 1, b});
    }
  }
  return mesh;
}

TEST(SurfaceRegionsTest, ShortCreaseThatEndsInNothingIsDropped) {
  // The file states a crease at some inner edges of a sheet, each 1.8 % of the diameter.
  constexpr size_t kSquares = 40;
  RawMesh sheet = Sheet(kSquares, 0.0);
  sheet.corner_normals.resize(sheet.triangles.size(),
                              {Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero()});
  const auto mark = [&](size_t x) {  // the edge between the rows 19 and 20
    sheet.corner_normals[2 * (19 * kSquares + x) + 1].fill(Eigen::Vector3f(0, -0.14f, 1).normalized());
    sheet.corner_normals[2 * (20 * kSquares + x)].fill(Eigen::Vector3f(0, 0.14f, 1).normalized());
  };
  mark(20);
  EXPECT_EQ(NumCreases(sheet), 0u);
  mark(21);
  EXPECT_EQ(NumCreases(sheet), 2u);
}

// Two sheets that meet at a fold of 20 degrees.
RawMesh Fold() {
  RawMesh fold;
  fold.points = {{0, -1, -0.18}, {1, -1, -0.18}, {0, 0, 0}, {1, 0, 0}, {0, 1, -0.18}, {1, 1, -0.18}};
  fold.triangles = {{0, 1, 3}, {0, 3, 2}, {2, 3, 5}, {2, 5, 4}};
  return fold;
}

// Normals of its corners with this y component, outward from the fold.
std::vector<std::array<Eigen::Vector3f, 3>> NormalsOfFold(float y) {
  const Eigen::Vector3f left = Eigen::Vector3f(0, -y, 1).normalized(), right = Eigen::Vector3f(0, y, 1).normalized();
  return {{left, left, left}, {left, left, left}, {right, right, right}, {right, right, right}};
}

TEST(SurfaceRegionsTest, NormalsOfTheFileDecide) {
  RawMesh cylinder = ClosedCylinder(48);
  const SurfaceEdges found = Find(cylinder);
  // The normals of a smooth cylinder confirm what the tests find.
  cylinder.corner_normals = found.surface.normals;
  EXPECT_THAT(Find(cylinder).edges, SizeIs(96));
  // A fold of 20 degrees between sheets whose normals are split, and not those of their facets, is a crease.
  RawMesh fold = Fold();
  EXPECT_THAT(Find(fold).edges, SizeIs(6)) << "boundaries";
  fold.corner_normals = NormalsOfFold(0.12f);
  EXPECT_THAT(Find(fold).edges, SizeIs(7));
  // One normal for each vertex of a box says nothing.
  RawMesh box = BoxMesh({1, 1, 1});
  for (const auto& triangle : box.triangles) {
    auto& normals = box.corner_normals.emplace_back();
    for (int corner = 0; corner < 3; ++corner) {
      normals[corner] = (box.points[triangle[corner]] - Eigen::Vector3d(0.5, 0.5, 0.5)).normalized().cast<float>();
    }
  }
  EXPECT_THAT(Find(box).edges, SizeIs(12));
}

TEST(SurfaceRegionsTest, ACreaseAngleOutsideTheUsualRangeAppliesToStatedNormals) {
  // The normals jump by 13.7 and by 6 degrees; y, crease angle, number of creases.
  using Case = std::tuple<float, double, size_t>;
  for (const auto& [y, angle_deg, num_creases] : {Case(0.12f, 30.0, 1), Case(0.12f, 10.0, 1), Case(0.12f, 31.0, 0),
                                                  Case(0.052f, 30.0, 0), Case(0.052f, 10.0, 0), Case(0.052f, 5.0, 1)}) {
    RawMesh fold = Fold();
    fold.exact_surface.regions.resize(2);
    fold.exact_surface.region_of = {0, 0, 1, 1};
    fold.exact_surface.normals = NormalsOfFold(y);
    const CreaseOptions options = {.crease_angle_deg = angle_deg};
    EXPECT_THAT(Find(fold, options).edges, SizeIs(6 + num_creases)) << y << " " << angle_deg;
    // What the file says of the edge itself holds for the usual range.
    fold.exact_edges = {{.shape = ExactEdge::Shape::kLine, .is_smooth = y < 0.1f, .points = {2, 3}}};
    EXPECT_THAT(Find(fold, options).edges, SizeIs(6 + num_creases)) << y << " " << angle_deg;
    if (y < 0.1f) continue;  // the turn of the facets decides where the normals do not jump
    RawMesh stated = Fold();
    stated.corner_normals = NormalsOfFold(y);
    EXPECT_THAT(Find(stated, options).edges, SizeIs(6 + num_creases)) << y << " " << angle_deg;
  }
}

TEST(SurfaceRegionsTest, ExactFacesAreRegionsAndMeetInCreasesOrSmoothly) {
  // A cylinder whose wall is two faces.
  RawMesh mesh = ClosedCylinder(32);
  SmoothSurface exact = Find(mesh).surface;
  const auto wall = std::find_if(exact.regions.begin(), exact.regions.end(),
                                 [](const SurfaceRegion& region) { return !region.is_flat(); });
  ASSERT_NE(wall, exact.regions.end());
  wall->shape = RegionShape::kCylinder;
  wall->radius_m = 1.0;
  const auto wall_index = static_cast<uint32_t>(wall - exact.regions.begin());
  exact.regions.push_back(*wall);
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (exact.region_of[t] == wall_index && mesh.points[mesh.triangles[t][0]].y() > 1e-9) exact.region_of[t] = 3;
  }
  mesh.exact_surface = exact;
  const SurfaceEdges found = Find(mesh);
  EXPECT_THAT(found.edges, SizeIs(64)) << "the rims; the faces of the wall meet smoothly";
  EXPECT_EQ(found.surface.region_of, exact.region_of);
  EXPECT_EQ(CountOf(found.surface, RegionShape::kCylinder), 2u);
}

// Where another face continues the one at whose end the edge is stated.
TEST(SurfaceRegionsTest, AStatedEdgeIsNoneIfTheFacesBesideItContinueEachOther) {
  RawMesh mesh = ClosedCylinder(32);
  mesh.exact_surface = Find(mesh).surface;
  for (const auto& [i, j, k] : mesh.triangles) {
    for (const auto& [from, to] : {std::array{i, j}, {j, k}, {k, i}})
      mesh.exact_edges.emplace_back().points = {from, to};
  }
  EXPECT_THAT(Find(mesh).edges, SizeIs(64)) << "the rims";
  for (ExactEdge& edge : mesh.exact_edges) edge.is_smooth = true;
  EXPECT_THAT(Find(mesh).edges, SizeIs(0));
}

TEST(SurfaceRegionsTest, CoveredEdgesAreNone) {
  RawMesh sheet = Sheet(1, 0.0);
  EXPECT_THAT(Find(sheet).edges, SizeIs(4));
  sheet.covered_edges = {{0, 1}, {1, 3}};
  EXPECT_THAT(Find(sheet).edges, SizeIs(2));
}

// Two boxes side by side, the second moved up by a step.
RawMesh Neighbours(double gap, double step) {
  RawMesh mesh = BoxMesh({1, 1, 1});
  Append(BoxMesh({1, 1, 1}), {1.0 + gap, 0.0, step}, mesh);
  return mesh;
}

TEST(SurfaceRegionsTest, EdgesAtANarrowGapBetweenFlushPartsAreNone) {
  const double diameter = DiagonalOf(Neighbours(0.0, 0.0));
  struct Case {
    double gap, step;
    size_t num_joint_edges;
  };
  // A gap has four edges of each box. A step ends the flush faces above and below, but not those beside it.
  for (const Case& c :
       {Case{5e-4, 0.0, 8}, Case{1.3e-3, 0.0, 8}, Case{5e-4, 2e-4, 8}, Case{5e-4, 1e-3, 4}, Case{1.7e-3, 0.0, 0}}) {
    const SurfaceEdges found = Find(Neighbours(c.gap * diameter, c.step * diameter));
    EXPECT_EQ(found.num_joint_edges, c.num_joint_edges) << c.gap << " " << c.step;
    EXPECT_THAT(found.edges, SizeIs(24 - c.num_joint_edges));
    EXPECT_THAT(found.surface.regions, SizeIs(12));
  }
  const SurfaceEdges as_is = Find(Neighbours(5e-4 * diameter, 0.0), {.is_smooth = false});
  EXPECT_EQ(as_is.num_joint_edges, 0u);
}

TEST(SurfaceRegionsTest, EdgesThatOtherPartsContinueInPartAreEdges) {
  // A part beside 70 % of the side of another, and three narrow ones.
  RawMesh one = BoxMesh({1, 10, 1});
  Append(BoxMesh({1, 7, 1}), {1.001, 1.5, 0.0}, one);
  RawMesh three = BoxMesh({1, 10, 1});
  for (const double y : {1.0, 4.5, 8.0}) Append(BoxMesh({1, 1, 1}), {1.001, y, 0.0}, three);
  // The two edges of each small part along the gap are continued by the large one, as are its ends that are flush.
  EXPECT_EQ(Find(one).num_joint_edges, 2u);
  EXPECT_EQ(Find(three).num_joint_edges, 6u);
}

TEST(SurfaceRegionsTest, EdgesOfAPartThatStandsOnAnotherAreEdges) {
  RawMesh mesh = BoxMesh({4, 4, 1});
  Append(BoxMesh({1, 1, 1}), {1.5, 1.5, 1.0 + 1e-3}, mesh);
  const SurfaceEdges found = Find(mesh);
  EXPECT_EQ(found.num_joint_edges, 0u);
  EXPECT_THAT(found.edges, SizeIs(24));
}

TEST(SurfaceRegionsTest, SurfacesThatMeetInOneEdge) {
  // Three sheets at one edge: it is a crease of three triangles.
  RawMesh mesh;
  mesh.points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}};
  mesh.triangles = {{0, 1, 2}, {1, 0, 3}, {0, 1, 4}};
  const SurfaceEdges found = Find(mesh);
  ASSERT_THAT(found.edges, SizeIs(7));
  EXPECT_THAT(found.edges[0].triangles, SizeIs(3));
  EXPECT_EQ(std::count_if(found.edges.begin(), found.edges.end(),
                          [](const MeshEdge& edge) { return edge.kind == EdgeKind::kBoundary; }),
            6);
}

// Half a tube of 24 sides with a floor, without thickness: each side has two regions.
TEST(SurfaceRegionsTest, BothSidesOfASheetAreSmooth) {
  RawMesh mesh;
  for (int i = 0; i <= 24; ++i) {
    for (const double y : {0.0, 1.0}) mesh.points.push_back({std::cos(kPi * i / 24), y, std::sin(kPi * i / 24)});
  }
  for (uint32_t i = 0; i <= 24; ++i) {
    const uint32_t from = 2 * i, to = i < 24 ? from + 2 : 0;
    mesh.triangles.push_back({from, from + 1, to});
    mesh.triangles.push_back({to, from + 1, to + 1});
  }
  const std::vector<std::array<uint32_t, 3>> first_side = mesh.triangles;
  for (const auto& [i, j, k] : first_side) mesh.triangles.push_back({i, k, j});
  const SurfaceEdges found = Find(mesh);
  EXPECT_THAT(found.surface.regions, SizeIs(4));
  EXPECT_EQ(CountOf(found.surface, RegionShape::kPlane), 2u);
  // The rims of 24 edges and the two sides of the floor, and its two joints with the tube.
  EXPECT_THAT(found.edges, SizeIs(2 * 24 + 2 + 2));
}

TEST(SurfaceRegionsTest, WorkIsBoundedOnAMeshOfSharpFacets) {
  // A rough sheet: all its inner edges are candidates, and its paths cross many triangles.
  constexpr uint32_t kSquares = 150;
  const RawMesh mesh = Sheet(kSquares, 2.0);
  const FacetGraph graph(mesh);
  int64_t work = 1'000'000;
  for (uint32_t side = 0; side < 3 * mesh.triangles.size(); ++side) {
    WalkAcross(graph, side, 1e9, work, [](const PathStep&) { return true; });
  }
  EXPECT_EQ(work, 0);
  int steps = 0;
  work = 1000;
  WalkAcross(graph, 3 * (kSquares * kSquares), 1e9, work, [&steps](const PathStep&) { return ++steps > 0; });
  EXPECT_LE(steps, 96);
  EXPECT_EQ(work, 1000 - steps);
}

TEST(SurfaceRegionsTest, JointsAreSearchedForAmongALimitedNumberOfEdges) {
  RawMesh boxes;
  for (int i = 0; i < 8400; ++i) Append(BoxMesh({1, 1, 1}), {2.0 * (i % 100), 2.0 * (i / 100), 0.0}, boxes);
  const SurfaceEdges found = Find(boxes);
  EXPECT_THAT(found.edges, SizeIs(12 * 8400));
  EXPECT_FALSE(found.are_joints_searched);
  EXPECT_TRUE(Find(BoxMesh({1, 1, 1})).are_joints_searched);
}

TEST(SurfaceRegionsTest, PathCrossesTheUnfoldedSurface) {
  // Around a cylinder of 12 sides, perpendicular to its axis: 12 sides and 12 diagonals.
  const RawMesh mesh = Turned({{1, 0}, {1, 1}}, 12);
  const FacetGraph graph(mesh);
  uint32_t upright = FacetGraph::kNone;
  for (uint32_t side = 0; side < 3 * mesh.triangles.size(); ++side) {
    if (std::abs(graph.Along(side).z()) > 0.999 && graph.opposite(side) != FacetGraph::kNone) upright = side;
  }
  ASSERT_NE(upright, FacetGraph::kNone);
  double length = 0.0;
  int steps = 0;
  int64_t work = 1000;
  WalkAcross(graph, upright, 12 * 2 * std::sin(kPi / 12) - 1e-6, work, [&](const PathStep& step) {
    EXPECT_NEAR(step.from_m, length, 1e-9);
    length = step.to_m;
    ++steps;
    return true;
  });
  EXPECT_EQ(steps, 24);
  EXPECT_NEAR(length, 12 * 2 * std::sin(kPi / 12), 1e-9) << "back at the start";
}

}  // namespace
}  // namespace evpose
