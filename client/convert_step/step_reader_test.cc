// SPDX-License-Identifier: Apache-2.0
#include "client/convert_step/step_reader.h"

#include <BRepAdaptor_Curve.hxx>
#include <BRepAlgoAPI_Fuse.hxx>
#include <BRepFilletAPI_MakeFillet.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRepPrimAPI_MakeCone.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <BRepPrimAPI_MakeSphere.hxx>
#include <BRepPrimAPI_MakeTorus.hxx>
#include <Eigen/Geometry>
#include <TopExp_Explorer.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Shape.hxx>
#include <algorithm>
#include <cmath>
#include <map>

#include "client/convert_step/step_files_testing.h"
#include "client/model_intake/step_conversion.h"
#include "core/base/output_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/models/mesh_message.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

class StepReaderTest : public StepFilesTest {};

std::map<RegionShape, int> CountShapes(const RawMesh& mesh) {
  std::map<RegionShape, int> counts;
  for (const SurfaceRegion& region : mesh.exact_surface.regions) ++counts[region.shape];
  return counts;
}

// Expects that the triangles have outward winding, and that each corner normal differs from the normal of its triangle
// by less than 90 degrees.
void ExpectOutward(const RawMesh& mesh) {
  double volume = 0.0;
  for (size_t i = 0; i < mesh.triangles.size(); ++i) {
    const auto& [a, b, c] = mesh.triangles[i];
    const Eigen::Vector3d &p = mesh.points[a], &q = mesh.points[b], &r = mesh.points[c];
    volume += p.dot(q.cross(r)) / 6.0;
    const Eigen::Vector3d normal = (q - p).cross(r - p).normalized();
    for (const Eigen::Vector3f& corner : mesh.exact_surface.normals[i]) {
      EXPECT_NEAR(corner.norm(), 1.0f, 1e-5f);
      EXPECT_GT(corner.cast<double>().dot(normal), 0.8);
    }
  }
  EXPECT_GT(volume, 0.0);
}

TEST_F(StepReaderTest, ACylinderHasItsExactShapeInMetresInEveryUnit) {
  for (const char* unit : {"MM", "INCH", "M"}) {
    const auto mesh = ReadMesh(Write(BRepPrimAPI_MakeCylinder(10.0, 30.0).Shape(), unit));
    ASSERT_TRUE(mesh.ok()) << mesh.status();
    EXPECT_EQ(CountShapes(*mesh), (std::map<RegionShape, int>{{RegionShape::kPlane, 2}, {RegionShape::kCylinder, 1}}));
    for (const SurfaceRegion& region : mesh->exact_surface.regions) {
      if (region.shape != RegionShape::kCylinder) continue;
      EXPECT_NEAR(region.radius_m, 0.01, 1e-9);
      EXPECT_NEAR(std::abs(region.axis.z()), 1.0, 1e-12);
      EXPECT_LT(region.point.head<2>().norm(), 1e-9);
      EXPECT_TRUE(region.is_convex);
    }
    ExpectOutward(*mesh);
    Eigen::AlignedBox3d box;
    for (const Eigen::Vector3d& point : mesh->points) box.extend(point);
    EXPECT_NEAR(box.sizes().z(), 0.03, 1e-9);
  }
}

TEST_F(StepReaderTest, ConesSpheresAndFreeSurfacesHaveOutwardNormalsAlsoAtTheirPoles) {
  const auto cone = ReadMesh(Write(BRepPrimAPI_MakeCone(10.0, 0.0, 20.0).Shape()));
  ASSERT_TRUE(cone.ok()) << cone.status();
  ExpectOutward(*cone);
  for (const SurfaceRegion& region : cone->exact_surface.regions) {
    if (region.shape != RegionShape::kCone) continue;
    EXPECT_LT((region.point - Eigen::Vector3d(0, 0, 0.02)).norm(), 1e-9);
    EXPECT_NEAR(region.axis.z(), -1.0, 1e-12);
    EXPECT_NEAR(region.half_angle_rad, std::atan(0.5), 1e-9);
  }
  const auto sphere = ReadMesh(Write(BRepPrimAPI_MakeSphere(gp_Pnt(1, 2, 3), 10.0).Shape()));
  ASSERT_TRUE(sphere.ok()) << sphere.status();
  ExpectOutward(*sphere);
  ASSERT_EQ(CountShapes(*sphere), (std::map<RegionShape, int>{{RegionShape::kSphere, 1}}));
  EXPECT_LT((sphere->exact_surface.regions[0].point - Eigen::Vector3d(1e-3, 2e-3, 3e-3)).norm(), 1e-9);
  const auto torus = ReadMesh(Write(BRepPrimAPI_MakeTorus(10.0, 3.0).Shape()));
  ASSERT_TRUE(torus.ok()) << torus.status();
  ExpectOutward(*torus);
  EXPECT_EQ(CountShapes(*torus), (std::map<RegionShape, int>{{RegionShape::kFree, 1}}));
}

TEST_F(StepReaderTest, EdgesAreExactCirclesAndLinesWithoutSeams) {
  const auto mesh = ReadMesh(Write(BRepPrimAPI_MakeCylinder(10.0, 30.0).Shape()));
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  ASSERT_EQ(mesh->exact_edges.size(), 2u);
  for (const ExactEdge& edge : mesh->exact_edges) {
    EXPECT_EQ(edge.shape, ExactEdge::Shape::kCircle);
    EXPECT_FALSE(edge.is_smooth);
    EXPECT_EQ(edge.points.front(), edge.points.back());
    EXPECT_NEAR(edge.circle.radius_m, 0.01, 1e-12);
    EXPECT_LT(edge.circle.centre.head<2>().norm(), 1e-12);
  }
  const auto box = ReadMesh(Write(BRepPrimAPI_MakeBox(10.0, 20.0, 30.0).Shape()));
  ASSERT_TRUE(box.ok()) << box.status();
  EXPECT_EQ(box->exact_edges.size(), 12u);
  for (const ExactEdge& edge : box->exact_edges) EXPECT_EQ(edge.shape, ExactEdge::Shape::kLine);
}

TEST_F(StepReaderTest, FilletsHaveSmoothEdgesAndTheModelHasNone) {
  const TopoDS_Shape box = BRepPrimAPI_MakeBox(40.0, 20.0, 10.0).Shape();
  BRepFilletAPI_MakeFillet fillet(box);
  // The four edges along z.
  for (TopExp_Explorer edges(box, TopAbs_EDGE); edges.More(); edges.Next()) {
    const TopoDS_Edge edge = TopoDS::Edge(edges.Current());
    gp_Pnt begin, end;
    BRepAdaptor_Curve(edge).D0(0.0, begin);
    BRepAdaptor_Curve(edge).D0(1.0, end);
    if (std::abs(end.Z() - begin.Z()) > 0.5) fillet.Add(4.0, edge);
  }
  const auto mesh = ReadMesh(Write(fillet.Shape()));
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  std::map<std::pair<ExactEdge::Shape, bool>, int> counts;
  for (const ExactEdge& edge : mesh->exact_edges) ++counts[{edge.shape, edge.is_smooth}];
  EXPECT_EQ(counts, (std::map<std::pair<ExactEdge::Shape, bool>, int>{{{ExactEdge::Shape::kLine, false}, 8},
                                                                      {{ExactEdge::Shape::kLine, true}, 8},
                                                                      {{ExactEdge::Shape::kCircle, false}, 8}}));
  const auto model = Prepare(*mesh);
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_EQ(model->lines.size(), 8u);
  ASSERT_EQ(model->curves.size(), 8u);
  for (const EdgeCurve& curve : model->curves) {
    for (const Eigen::Vector3d& point : curve.points) {
      const Eigen::Vector2d corner(point.x() < 0.02 ? 0.004 : 0.036, point.y() < 0.01 ? 0.004 : 0.016);
      EXPECT_NEAR((point.head<2>() - corner).norm(), 0.004, 1e-8);
    }
  }
}

TEST_F(StepReaderTest, CurvesOtherThanCirclesAreSampled) {
  // Two cylinders of different radii meet in a curve that is no circle.
  const TopoDS_Shape along_z = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(0, 0, -30), gp_Dir(0, 0, 1)), 10.0, 60.0).Shape();
  const TopoDS_Shape along_x = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(0, 0, 0), gp_Dir(1, 0, 0)), 6.0, 40.0).Shape();
  const auto mesh = ReadMesh(Write(BRepAlgoAPI_Fuse(along_z, along_x).Shape()));
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  int num_free = 0;
  for (const ExactEdge& edge : mesh->exact_edges) {
    if (edge.shape != ExactEdge::Shape::kFree) continue;
    ++num_free;
    EXPECT_FALSE(edge.is_smooth);
    for (size_t i = 0; i < edge.points.size(); ++i) {
      const Eigen::Vector3d& point = mesh->points[edge.points[i]];
      EXPECT_NEAR(point.head<2>().norm(), 0.01, 1e-7);
      EXPECT_NEAR(point.tail<2>().norm(), 0.006, 1e-7);
      if (i == 0) continue;
      const Eigen::Vector3d middle = 0.5 * (point + mesh->points[edge.points[i - 1]]);
      EXPECT_NEAR(middle.tail<2>().norm(), 0.006, 1e-5);
    }
  }
  EXPECT_GE(num_free, 1);
}

TEST_F(StepReaderTest, IgesFilesAreReadLikewise) {
  const std::string path = WriteIges(BRepPrimAPI_MakeBox(10.0, 20.0, 30.0).Shape(), IgesFaces::kOfSolids);
  const auto mesh = ReadMesh(path);
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  EXPECT_EQ(mesh->triangles.size(), 12u);
  ExpectOutward(*mesh);
}

TEST_F(StepReaderTest, BadFilesAndTooManyTrianglesAreErrors) {
  const std::string path = Write(BRepPrimAPI_MakeSphere(10.0).Shape());
  EXPECT_THAT(std::string(ReadStep(path, {.turn_rad = 0.0}).status().message()),
              testing::HasSubstr("StepOptions.turn_rad"));
  EXPECT_THAT(std::string(ReadStep(path, {.max_triangles = 10}).status().message()),
              testing::HasSubstr("more than 10 triangles"));
  const std::string bytes = ReadFile(path, 1u << 20).value();
  for (const size_t size : {size_t{0}, bytes.size() / 4}) {
    ASSERT_TRUE(WriteFile(path, bytes.substr(0, size)).ok());
    EXPECT_EQ(ReadStep(path).status().code(), absl::StatusCode::kInvalidArgument) << size;
  }
  EXPECT_EQ(ReadStep(directory_.File("none.step")).status().code(), absl::StatusCode::kNotFound);
}

TEST_F(StepReaderTest, TheProgramPrintsTheMeshOrItsError) {
  const std::string path = Write(BRepPrimAPI_MakeCylinder(10.0, 30.0).Shape());
  const auto printed = RunConverter(EVPOSE_CONVERT_STEP, path);
  ASSERT_TRUE(printed.ok()) << printed.status();
  EXPECT_TRUE(printed->mesh == server::EncodeMesh(ReadStep(path)->mesh));
  EXPECT_THAT(printed->notices, testing::IsEmpty());
  ASSERT_TRUE(WriteFile(path, "prose\n").ok());
  EXPECT_THAT(std::string(RunConverter(EVPOSE_CONVERT_STEP, path).status().message()),
              testing::StartsWith("cannot be read"));
}

// Largest distance of a curve, at its points and the middles of its segments, from a circle.
double DistanceFrom(const EdgeCircle& circle, const EdgeCurve& curve) {
  double largest_m = 0.0;
  const auto visit = [&](const Eigen::Vector3d& point) {
    const double height_m = circle.axis.dot(point - circle.centre);
    const double across_m = (point - circle.centre - height_m * circle.axis).norm();
    largest_m = std::max(largest_m, std::hypot(height_m, across_m - circle.radius_m));
  };
  for (size_t i = 0; i < curve.points.size(); ++i) {
    visit(curve.points[i]);
    if (i > 0) visit(0.5 * (curve.points[i - 1] + curve.points[i]));
  }
  return largest_m;
}

TEST_F(StepReaderTest, APublicPartIsRead) {
  const auto mesh = ReadMesh(FindTestData("cad/featuretype.STEP"));
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  EXPECT_GT(CountShapes(*mesh)[RegionShape::kCylinder], 10);
  ExpectOutward(*mesh);
  const auto model = Prepare(*mesh);
  ASSERT_TRUE(model.ok()) << model.status();
  // Each circle is a curve of the model, within the sagitta of the segments of curves.
  size_t num_circles = 0;
  for (const ExactEdge& edge : mesh->exact_edges) {
    if (edge.shape != ExactEdge::Shape::kCircle || edge.is_smooth) continue;
    ++num_circles;
    EXPECT_TRUE(std::any_of(model->curves.begin(), model->curves.end(), [&](const EdgeCurve& curve) {
      return DistanceFrom(edge.circle, curve) < 2e-5 * model->diameter_m;
    })) << edge.circle.centre.transpose();
  }
  EXPECT_GT(num_circles, 50u);
  EXPECT_GT(model->curves.size(), num_circles);
}

}  // namespace
}  // namespace evpose::client
