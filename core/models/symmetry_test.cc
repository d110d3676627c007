// SPDX-License-Identifier: Apache-2.0
#include "core/models/symmetry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <functional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "core/models/cube_files_testing.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

size_t CountOf(const std::string& obj) { return MustParse(obj).symmetries.size(); }

std::string Vertex(const Eigen::Vector3d& v) { return absl::StrFormat("v %.9g %.9g %.9g\n", v.x(), v.y(), v.z()); }

std::string Box(const Eigen::Vector3d& size) {
  std::string obj;
  for (const auto& [x, y, z] :
       {std::array<int, 3>{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}}) {
    obj += Vertex(size.cwiseProduct(Eigen::Vector3d(x, y, z)));
  }
  return obj + kCubeFaces;
}

constexpr char kTetrahedron[] = "v 1 1 1\nv 1 -1 -1\nv -1 1 -1\nv -1 -1 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n";
constexpr char kSquare[] = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

// Expects that the symmetries begin with the identity, form a group of proper rotations and map each line onto one
// line.
void ExpectIsGroupOf(const ObjectModel& model, double tolerance_m) {
  ASSERT_FALSE(model.symmetries.empty());
  EXPECT_TRUE(model.symmetries[0].rotation.isIdentity(0.0));
  EXPECT_TRUE(model.symmetries[0].translation_m.isZero(0.0));
  const auto is_in = [&](const RigidTransform& transform) {
    return std::count_if(model.symmetries.begin(), model.symmetries.end(), [&](const RigidTransform& other) {
      return (other.rotation - transform.rotation).norm() * model.diameter_m < 2 * tolerance_m &&
             (other.translation_m - transform.translation_m).norm() < 2 * tolerance_m;
    });
  };
  for (const RigidTransform& a : model.symmetries) {
    EXPECT_NEAR(a.rotation.determinant(), 1.0, 1e-9);
    EXPECT_TRUE((a.rotation * a.rotation.transpose()).isIdentity(1e-9));
    EXPECT_EQ(is_in(a.Inverse()), 1);
    for (const RigidTransform& b : model.symmetries) EXPECT_EQ(is_in(a * b), 1);
    for (const ModelLine& line : model.lines) {
      const auto falls_on = [&](const ModelLine& other) {
        const Eigen::Vector3d p1 = a * line.p1, p2 = a * line.p2;
        return std::min(std::max((p1 - other.p1).norm(), (p2 - other.p2).norm()),
                        std::max((p1 - other.p2).norm(), (p2 - other.p1).norm())) <= tolerance_m;
      };
      EXPECT_EQ(std::count_if(model.lines.begin(), model.lines.end(), falls_on), 1);
    }
  }
}

// --- Numbers of symmetries

TEST(SymmetryTest, Solids) {
  for (const auto& [obj, count] : {std::pair<std::string, size_t>{Cube(), 24},
                                   {Box({1, 1, 2}), 8},
                                   {Box({1, 2, 3}), 4},
                                   {kTetrahedron, 12},
                                   {Prism(3), 6},
                                   {Prism(5), 10},
                                   {Prism(8), 16}}) {
    const ObjectModel model = MustParse(obj);
    EXPECT_THAT(model.symmetries, SizeIs(count)) << obj;
    ExpectIsGroupOf(model, 1e-6 * model.diameter_m);
  }
}

TEST(SymmetryTest, BoxOfNearlyEqualSides) {
  // Sides that differ by more than a thousandth of the diameter.
  EXPECT_EQ(CountOf(Box({1, 1, 1.005})), 8u);
  EXPECT_EQ(CountOf(Box({1, 1.005, 1.01})), 4u);
  EXPECT_EQ(CountOf(Box({1, 1, 1.0005})), 24u);
}

TEST(SymmetryTest, Wires) {
  EXPECT_EQ(CountOf(absl::StrCat(kSquare, "l 1 2 3 4 1\n")), 8u);
  EXPECT_EQ(CountOf(absl::StrCat(kSquare, "l 1 2 3 4\n")), 2u);
  EXPECT_EQ(CountOf(absl::StrCat(kSquare, "l 1 2\nl 3 4\n")), 4u);
  EXPECT_EQ(CountOf(absl::StrCat(kSquare, "v 0 0 1\nl 1 2 3 4 1\nl 1 5\n")), 1u);
  EXPECT_EQ(CountOf(absl::StrCat(kCubeVertices, "l 1 2 3 4 1\nl 5 6 7 8 5\nl 1 5\nl 2 6\nl 3 7\nl 4 8\n")), 24u);
  // Three edges of different lengths at one corner: only a reflection maps two of them alone onto themselves.
  EXPECT_EQ(CountOf("v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nl 1 2\nl 1 3\nl 1 4\n"), 1u);
  EXPECT_EQ(CountOf("v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nl 1 3\n"), 2u);
}

TEST(SymmetryTest, LinesOnOneAxisAreLeftAlone) {
  const ObjectModel model = MustParse("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 3 0 0\nl 1 2\nl 3 4\n");
  EXPECT_THAT(model.symmetries, SizeIs(1));
}

TEST(SymmetryTest, ChiralObjectsHaveNoMirrorImage) {
  // A cube with a pinwheel stroke on each of two opposite faces: turned alike as seen from outside (a half turn swaps
  // them), or as mirror images of each other (nothing maps one onto the other).
  const std::string strokes = "v 0.2 0.3 0\nv 0.8 0.4 0\nv 0.2 0.7 1\nv 0.8 0.6 1\nv 0.2 0.3 1\nv 0.8 0.4 1\n";
  const std::string edges = "l 1 2 3 4 1\nl 5 6 7 8 5\nl 1 5\nl 2 6\nl 3 7\nl 4 8\n";
  EXPECT_EQ(CountOf(absl::StrCat(Cube(), strokes, edges, "l 9 10\nl 11 12\n")), 2u);
  EXPECT_EQ(CountOf(absl::StrCat(Cube(), strokes, edges, "l 9 10\nl 13 14\n")), 1u);
}

TEST(SymmetryTest, PaintBreaksSymmetry) {
  const std::string edges = "l 1 2 3 4 1\nl 5 6 7 8 5\nl 1 5\nl 2 6\nl 3 7\nl 4 8\n";
  EXPECT_EQ(CountOf(absl::StrCat(Cube(), edges)), 24u);
  EXPECT_EQ(CountOf(absl::StrCat(Cube(), "v 0.2 0.2 0\nv 0.8 0.8 0\n", edges, "l 9 10\n")), 2u);
  EXPECT_EQ(CountOf(absl::StrCat(Cube(), "v 0.2 0.3 0\nv 0.5 0.8 0\n", edges, "l 9 10\n")), 1u);
}

// --- Sheets

TEST(SymmetryTest, SheetSeenFromOneSideHasFour) { EXPECT_EQ(CountOf(absl::StrCat(kSquare, "f 1 2 3 4\n")), 4u); }

TEST(SymmetryTest, SheetSeenFromBothSidesTurnsOver) {
  EXPECT_EQ(CountOf(absl::StrCat(kSquare, "f 1 2 3\nf 1 3 4\nf 1 3 2\nf 1 4 3\n")), 8u);
}

TEST(SymmetryTest, PlateWithPaintOnOneSide) {
  const std::string plate = absl::StrCat(Box({1, 1, 0.1}), "v 0.2 0.2 0\nv 0.8 0.8 0\nl 1 2 3 4 1\nl 5 6 7 8 5\n",
                                         "l 1 5\nl 2 6\nl 3 7\nl 4 8\n");
  EXPECT_EQ(CountOf(plate), 8u);
  EXPECT_EQ(CountOf(absl::StrCat(plate, "l 9 10\n")), 2u);
}

// --- Faces

TEST(SymmetryTest, FacesCountWhereTheLinesAreTheSame) {
  // Wire cubes with some faces: the faces count, too.
  const std::string wires = absl::StrCat(kCubeVertices, "l 1 2 3 4 1\nl 5 6 7 8 5\nl 1 5\nl 2 6\nl 3 7\nl 4 8\n");
  EXPECT_EQ(CountOf(absl::StrCat(wires, "f 1 4 3 2\n")), 4u);
  EXPECT_EQ(CountOf(absl::StrCat(wires, "f 1 4 3 2\nf 5 6 7 8\n")), 8u);
  EXPECT_EQ(CountOf(absl::StrCat(wires, "f 1 4 3 2\nf 5 6 7\n")), 1u);
}

TEST(SymmetryTest, FaceApartFromAllLines) {
  // Two plates in a wire cube, without lines of their own.
  const std::string wires = absl::StrCat(kCubeVertices, "l 1 2 3 4 1\nl 5 6 7 8 5\nl 1 5\nl 2 6\nl 3 7\nl 4 8\n");
  const std::string plates =
      "v 0.4 0.4 0.2\nv 0.6 0.4 0.2\nv 0.6 0.6 0.2\nv 0.4 0.6 0.2\n"
      "v 0.4 0.4 0.8\nv 0.6 0.4 0.8\nv 0.6 0.6 0.8\nv 0.4 0.6 0.8\n";
  EXPECT_EQ(CountOf(absl::StrCat(wires, plates, "f 9 12 11 10\nf 13 14 15 16\n")), 8u);
  EXPECT_EQ(CountOf(absl::StrCat(wires, plates, "f 9 12 11 10\n")), 4u);
  // The normals of both point up: no rotation swaps the plates.
  EXPECT_EQ(CountOf(absl::StrCat(wires, plates, "f 9 10 11 12\nf 13 14 15 16\n")), 4u);
}

TEST(SymmetryTest, HoleInAFace) {
  // A square frame of four trapezoids with a small window, in the middle or not; the lines are the outer edges alone.
  const auto frame = [](double x) {
    std::string obj = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    for (const auto& [dx, dy] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}) {
      obj += Vertex({x + 0.01 * dx, 0.5 + 0.01 * dy, 0});
    }
    return obj + "f 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\nl 1 2 3 4 1\n";
  };
  EXPECT_EQ(CountOf(frame(0.5)), 4u);
  EXPECT_EQ(CountOf(frame(0.3)), 1u);
}

TEST(SymmetryTest, TriangulationDoesNotMatter) {
  // One face by each diagonal, one by a fan about a point inside, one by slivers from a point on an edge.
  const std::string cube =
      absl::StrCat(kCubeVertices, "v 0.3 0.4 0\nv 0.3 1 1\n", "f 1 9 2\nf 2 9 3\nf 3 9 4\nf 4 9 1\n",
                   "f 5 6 7\nf 5 7 10\nf 5 10 8\n", "f 1 2 5\nf 2 6 5\n", "f 2 3 7\nf 2 7 6\n",
                   "f 3 4 10\nf 4 8 10\nf 3 10 7\n", "f 4 1 5\nf 4 5 8\n");
  const ObjectModel model = MustParse(cube);
  EXPECT_THAT(model.lines, SizeIs(12));
  EXPECT_THAT(model.symmetries, SizeIs(24));
}

TEST(SymmetryTest, AnEdgeInTwoPartsIsTheEdge) {
  const std::string halves = absl::StrCat(kSquare, "v 0.3 0 0\nv 0.6 0 0\n");
  EXPECT_EQ(CountOf(absl::StrCat(halves, "l 1 5 2 3 4 1\n")), 8u);
  EXPECT_EQ(CountOf(absl::StrCat(halves, "l 1 5\nl 6 2 3 4 1\n")), 1u);  // a gap is none
}

// --- The same object elsewhere, and not quite

ObjectModel Moved(ObjectModel model, const RigidTransform& motion, double scale) {
  const auto move = [&](Eigen::Vector3d& point) { point = motion * (scale * point); };
  for (Eigen::Vector3d& vertex : model.vertices) move(vertex);
  for (ModelLine& line : model.lines) {
    move(line.p1);
    move(line.p2);
    for (Eigen::Vector3d& normal : line.face_normals) normal = motion.rotation * normal;
  }
  model.diameter_m *= scale;
  return model;
}

TEST(SymmetryTest, MovedAndScaledCopiesHaveTheConjugateGroup) {
  const RigidTransform motion{ExpSo3({0.3, -1.1, 2.0}), {5.0, -2.0, 0.7}};
  for (const double scale : {1e-3, 1.0, 250.0}) {
    for (const std::string& obj : {Cube(), Box({1, 2, 3}), std::string(kTetrahedron), Prism(7)}) {
      const ObjectModel model = MustParse(obj);
      ObjectModel moved = Moved(model, motion, scale);
      moved.symmetries = FindSymmetries(moved);
      ASSERT_EQ(moved.symmetries.size(), model.symmetries.size());
      ExpectIsGroupOf(moved, 1e-6 * moved.diameter_m);
      for (const RigidTransform& symmetry : model.symmetries) {
        const RigidTransform scaled{symmetry.rotation, scale * symmetry.translation_m};
        const RigidTransform conjugate = motion * scaled * motion.Inverse();
        const auto is_it = [&](const RigidTransform& other) {
          return (other.rotation - conjugate.rotation).norm() < 1e-6 &&
                 (other.translation_m - conjugate.translation_m).norm() < 1e-5 * scale + 1e-5;
        };
        EXPECT_EQ(std::count_if(moved.symmetries.begin(), moved.symmetries.end(), is_it), 1);
      }
    }
  }
}

// Moves each end of a line independently, as in a measured model.
ObjectModel Shaken(ObjectModel model, double amplitude_m, uint64_t seed) {
  Random random(seed);
  const auto shake = [&](Eigen::Vector3d& point) {
    for (int axis = 0; axis < 3; ++axis) point[axis] += amplitude_m * (2.0 * random.Uniform() - 1.0);
  };
  for (Eigen::Vector3d& vertex : model.vertices) shake(vertex);
  for (ModelLine& line : model.lines) {
    shake(line.p1);
    shake(line.p2);
  }
  return model;
}

TEST(SymmetryTest, NoiseBelowTheTolerance) {
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    for (const auto& [obj, count] :
         {std::pair<std::string, size_t>{Cube(), 24}, {Box({1, 2, 3}), 4}, {kTetrahedron, 12}, {Prism(10), 20}}) {
      ObjectModel model = MustParse(obj);
      model = Shaken(model, 0.25e-3 * model.diameter_m, seed);
      model.symmetries = FindSymmetries(model);
      EXPECT_EQ(model.symmetries.size(), count) << model.lines.size() << " lines, seed " << seed;
      ExpectIsGroupOf(model, 2e-3 * model.diameter_m);
    }
  }
}

TEST(SymmetryTest, NoiseAboveTheToleranceLeavesNone) {
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    ObjectModel model = MustParse(Box({1, 2, 3}));
    model = Shaken(model, 4e-3 * model.diameter_m, seed);
    EXPECT_EQ(FindSymmetries(model).size(), 1u) << "seed " << seed;
    EXPECT_EQ(FindSymmetries(model, 1.6e-2).size(), 4u) << "seed " << seed;
  }
}

// --- Large ones

// A model with its discrete symmetries alone.
ObjectModel WithDiscreteSymmetries(ObjectModel model) {
  model.continuous_symmetry.reset();
  model.symmetries = FindSymmetries(model, 1e-3, &model.notices);
  return model;
}

TEST(SymmetryTest, PrismOfManySides) {
  const ObjectModel model = WithDiscreteSymmetries(MustParse(Prism(500), ModelFormat::kObj, AsIs()));
  EXPECT_THAT(model.lines, SizeIs(1000));
  EXPECT_THAT(model.symmetries, SizeIs(1000));
  EXPECT_THAT(model.notices, IsEmpty());
  // Far into the group, no error has added up.
  for (const RigidTransform& symmetry : model.symmetries) {
    const double turns = RotationAngle(symmetry.rotation, Eigen::Matrix3d::Identity()) / (2 * M_PI) * 500;
    EXPECT_NEAR(turns, std::round(turns), 1e-4);
  }
}

TEST(SymmetryTest, OneMarkOnAPrismOfManySides) {
  const std::string prism = Prism(200);
  std::string obj = absl::StrCat(prism, "v 0.5 0.1 1\nv 0.6 0.3 1\nl 401 402\nl ");
  for (int i = 0; i <= 200; ++i) absl::StrAppend(&obj, 2 * (i % 200) + 1, " ");
  obj += "\nl ";
  for (int i = 0; i <= 200; ++i) absl::StrAppend(&obj, 2 * (i % 200) + 2, " ");
  EXPECT_THAT(MustParse(obj + "\n", ModelFormat::kObj, AsIs()).symmetries, SizeIs(1));
}

TEST(SymmetryTest, ASmallFaceInsideAPrismOfManySidesCounts) {
  // A turn by one side moves the face by less than the tolerance.
  constexpr int kSides = 480;
  std::string obj = Prism(kSides) + "v 0.01 0 0.4\nv 0.02 0.01 0.4\nv 0.01 0.02 0.41\nf -3 -2 -1\nl ";
  for (int i = 0; i <= kSides; ++i) absl::StrAppend(&obj, 2 * (i % kSides) + 1, " ");
  obj += "\nl ";
  for (int i = 0; i <= kSides; ++i) absl::StrAppend(&obj, 2 * (i % kSides) + 2, " ");
  ObjectModel model = MustParse(obj);
  model.continuous_symmetry.reset();
  SymmetryWork work;
  EXPECT_THAT(FindSymmetries(model, 1e-3, nullptr, &work), SizeIs(1));
  // A sample of the face contradicts most rotations at once.
  EXPECT_LT(work.surface_samples, 200'000);
}

TEST(SymmetryTest, TooManyLinesAreReported) {
  ObjectModel model = MustParse(Cube());
  while (model.lines.size() < 10000) model.lines.push_back(model.lines[model.lines.size() % 12]);
  std::vector<std::string> notices;
  EXPECT_THAT(FindSymmetries(model, 1e-3, &notices), SizeIs(1));
  EXPECT_THAT(notices, testing::ElementsAre(HasSubstr("more than 8192 lines")));
}

TEST(SymmetryTest, ComparisonsOfRotationsGrowWithTheGroup) {
  const auto comparisons_of = [](int sides) {
    ObjectModel prism = MustParse(Prism(sides), ModelFormat::kObj, AsIs());
    prism.continuous_symmetry.reset();
    SymmetryWork work;
    EXPECT_THAT(FindSymmetries(prism, 1e-4, nullptr, &work), SizeIs(2 * sides));
    EXPECT_GT(work.rotation_comparisons, 0);
    return static_cast<double>(work.rotation_comparisons);
  };
  EXPECT_LT(comparisons_of(400) / comparisons_of(100), 10.0) << "16 if all pairs were compared";
}

// Rotations by a side agree with the prism within the tolerance, and the small triangle in it has no symmetry.
TEST(SymmetryTest, TheWorkIsBounded) {
  std::string obj = Prism(500) + "v 0.01 0 0.4\nv 0.02 0.01 0.4\nv 0.01 0.02 0.41\nf -3 -2 -1\nl ";
  for (int i = 0; i <= 500; ++i) absl::StrAppend(&obj, 2 * (i % 500) + 1, " ");
  obj += "\nl ";
  for (int i = 0; i <= 500; ++i) absl::StrAppend(&obj, 2 * (i % 500) + 2, " ");
  SymmetryWork work;
  (void)FindSymmetries(MustParse(obj, ModelFormat::kObj, AsIs()), 1e-3, nullptr, &work);
  EXPECT_LE(work.line_comparisons, 5'000'001);
  EXPECT_LE(work.rotation_comparisons, 20'010'000);
  EXPECT_LE(work.surface_samples, 1'000'000);
}

TEST(SymmetryTest, EmptyModelHasTheIdentity) { EXPECT_THAT(FindSymmetries(ObjectModel()), SizeIs(1)); }

// --- The nearest of equivalent poses

TEST(NearestEquivalentTest, IsTheOneNearestToTheReference) {
  const ObjectModel cube = MustParse(Cube());
  const RigidTransform pose{ExpSo3({0.4, -0.2, 0.9}), {0.1, 0.2, 3.0}};
  for (const RigidTransform& symmetry : cube.symmetries) {
    const RigidTransform other = pose * symmetry;
    const RigidTransform nearest = NearestEquivalent(other, cube.symmetries, pose);
    EXPECT_LT((nearest.rotation - pose.rotation).norm(), 1e-6);
    EXPECT_LT((nearest.translation_m - pose.translation_m).norm(), 1e-6);
    // The centre of the cube is in the same place.
    EXPECT_LT((nearest * Eigen::Vector3d(0.5, 0.5, 0.5) - other * Eigen::Vector3d(0.5, 0.5, 0.5)).norm(), 1e-6);
  }
}

TEST(NearestEquivalentTest, OfEquallyNearOnesTheFirst) {
  const ObjectModel cube = MustParse(Cube());
  // After an eighth of a turn, the quarter turns to both sides are equally near.
  const RigidTransform pose{ExpSo3({0, 0, M_PI / 4}), Eigen::Vector3d::Zero()};
  const RigidTransform nearest = NearestEquivalent(pose, cube.symmetries, RigidTransform());
  EXPECT_NEAR(RotationAngle(nearest.rotation, Eigen::Matrix3d::Identity()), M_PI / 4, 1e-6);
  EXPECT_TRUE(nearest.rotation.isApprox(pose.rotation, 1e-12));  // the identity is the first
}

TEST(NearestEquivalentTest, WithoutSymmetriesThePoseItself) {
  const RigidTransform pose{ExpSo3({0.4, -0.2, 0.9}), {0.1, 0.2, 3.0}};
  EXPECT_EQ(NearestEquivalent(pose, absl::Span<const RigidTransform>(), RigidTransform()).rotation, pose.rotation);
}

// A closed or open curve of 120 segments in a plane z = const; point_at(t) for t from 0 to 1.
EdgeCurve FlatCurve(double z, bool is_ring, const std::function<Eigen::Vector2d(double)>& point_at) {
  constexpr int kSegments = 120;
  EdgeCurve curve;
  for (int i = 0; i <= kSegments; ++i) {
    const Eigen::Vector2d p = point_at(static_cast<double>(is_ring ? i % kSegments : i) / kSegments);
    curve.points.emplace_back(p.x(), p.y(), z);
  }
  curve.face_normals.resize(kSegments);
  return curve;
}

Eigen::Vector2d AtAngle(double radius, double turn) {
  return radius * Eigen::Vector2d(std::cos(2.0 * M_PI * turn), std::sin(2.0 * M_PI * turn));
}

EdgeCurve EllipseCurve(const Eigen::Vector2d& centre, double z, double a, double b) {
  // The first point is no axis of the ellipse.
  return FlatCurve(z, true, [=](double t) {
    const Eigen::Vector2d p = AtAngle(1.0, t + 0.07);
    return Eigen::Vector2d(centre + Eigen::Vector2d(a * p.x(), b * p.y()));
  });
}

// The rims of a flange: holes on a circle, in two planes, and its outer rims.
ObjectModel FlangeOfRings(int holes, double lower_radius) {
  ObjectModel model;
  model.diameter_m = 2.0;
  for (const double z : {-0.1, 0.1}) {
    model.curves.push_back(EllipseCurve({0, 0}, z, z < 0 ? lower_radius : 1.0, z < 0 ? lower_radius : 1.0));
    for (int i = 0; i < holes; ++i) {
      model.curves.push_back(EllipseCurve(AtAngle(0.7, static_cast<double>(i) / holes), z, 0.1, 0.1));
    }
  }
  return model;
}

TEST(SymmetryTest, RimsOfHolesDetermineTheSymmetriesOfAFlange) {
  for (const int holes : {3, 4, 6, 7}) {
    EXPECT_THAT(FindSymmetries(FlangeOfRings(holes, 0.9)), SizeIs(holes));
    EXPECT_THAT(FindSymmetries(FlangeOfRings(holes, 1.0)), SizeIs(2 * holes)) << "with half turns";
  }
  ObjectModel flange = FlangeOfRings(6, 0.9);
  flange.curves.push_back(EllipseCurve(AtAngle(0.4, 0.0), 0.1, 0.05, 0.05));
  EXPECT_THAT(FindSymmetries(flange), SizeIs(1)) << "one more hole";
  ObjectModel other = FlangeOfRings(6, 0.9);
  other.curves.back() = EllipseCurve(AtAngle(0.7, 5.0 / 6.0), 0.1, 0.11, 0.11);
  EXPECT_THAT(FindSymmetries(other), SizeIs(1)) << "one larger hole";
}

TEST(SymmetryTest, RingThatIsNoCircleIsMappedOntoItself) {
  ObjectModel flange = FlangeOfRings(4, 0.9);
  flange.curves.push_back(EllipseCurve({0, 0}, 0.1, 0.4, 0.3));
  EXPECT_THAT(FindSymmetries(flange), SizeIs(2));
  flange.curves.back() = EllipseCurve({0, 0}, 0.1, 0.3, 0.3);
  EXPECT_THAT(FindSymmetries(flange), SizeIs(4));
}

TEST(SymmetryTest, CurvesWithEndsTakePart) {
  ObjectModel spirals;
  spirals.diameter_m = 2.0;
  for (int i = 0; i < 5; ++i) {
    spirals.curves.push_back(
        FlatCurve(0.0, false, [i](double t) { return AtAngle(0.2 + 0.8 * t, 0.2 * i + 0.15 * t); }));
  }
  EXPECT_THAT(FindSymmetries(spirals), SizeIs(5)) << "a half turn changes the sense of the spirals";
  spirals.curves[2].points.resize(90);
  EXPECT_THAT(FindSymmetries(spirals), SizeIs(1));
}

// --- Models whose rings have one axis

// A closed body of revolution with `lobes` lobes, whose angle grows by `twist_rad` from the bottom to the top.
std::string Fluted(int lobes, double top_radius, double twist_rad, int sides) {
  std::string obj;
  constexpr int kRows = 12;
  for (int row = 0; row <= kRows; ++row) {
    const double u = static_cast<double>(row) / kRows;
    for (int i = 0; i < sides; ++i) {
      const double angle = 2 * M_PI * i / sides;
      const double radius = (1.0 + (top_radius - 1.0) * u) * (1.0 + 0.06 * std::cos(lobes * angle + twist_rad * u));
      obj += Vertex({radius * std::cos(angle), radius * std::sin(angle), 3.0 * u});
    }
  }
  for (int row = 0; row < kRows; ++row) {
    for (int i = 0; i < sides; ++i) {
      const int a = row * sides + i + 1, b = row * sides + (i + 1) % sides + 1;
      absl::StrAppendFormat(&obj, "f %d %d %d %d\n", a, b, b + sides, a + sides);
    }
  }
  obj += Vertex({0, 0, 0}) + Vertex({0, 0, 3});
  const int bottom = (kRows + 1) * sides + 1, top = bottom + 1;
  for (int i = 0; i < sides; ++i) {
    const int next = (i + 1) % sides;
    absl::StrAppendFormat(&obj, "f %d %d %d\nf %d %d %d\n", bottom, next + 1, i + 1, top, kRows * sides + i + 1,
                          kRows * sides + next + 1);
  }
  return obj;
}

TEST(SymmetryTest, LobesOfRingsGiveTheRotationsAboutTheirAxis) {
  for (const size_t lobes : {2, 3, 5, 8}) {
    for (const int facets_per_lobe : {20, 60}) {
      const int count = static_cast<int>(lobes), sides = count * facets_per_lobe;
      EXPECT_EQ(CountOf(Fluted(count, 0.7, 0.0, sides)), lobes) << sides;
      EXPECT_EQ(CountOf(Fluted(count, 0.7, 1.1, sides)), lobes) << sides;
      // The half turns across the axis, too.
      EXPECT_EQ(CountOf(Fluted(count, 1.0, 0.0, sides)), 2 * lobes) << sides;
      EXPECT_EQ(CountOf(Fluted(count, 1.0, 0.7, sides)), 2 * lobes) << sides;
    }
  }
  ExpectIsGroupOf(MustParse(Fluted(5, 1.0, 0.7, 100)), 2e-3);
}

TEST(SymmetryTest, LobesOfAnotherNumberOfFacetsGiveThemToo) { EXPECT_EQ(CountOf(Fluted(6, 0.7, 0.5, 125)), 6u); }

}  // namespace
}  // namespace evpose
