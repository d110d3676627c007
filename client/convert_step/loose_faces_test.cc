// SPDX-License-Identifier: Apache-2.0

// Files whose faces are turned, not joined or not complete.
#include <BRepAlgoAPI_Cut.hxx>
#include <BRepBuilderAPI_MakeEdge.hxx>
#include <BRepFilletAPI_MakeFillet.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <BRep_Builder.hxx>
#include <BRep_Tool.hxx>
#include <Eigen/Geometry>
#include <TopExp_Explorer.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Compound.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Vertex.hxx>
#include <algorithm>
#include <functional>
#include <map>
#include <regex>
#include <string>
#include <utility>
#include <vector>

#include "client/convert_step/step_files_testing.h"
#include "core/base/output_file.h"
#include "gmock/gmock.h"

namespace evpose::client {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

TopoDS_Compound Compound(const std::vector<TopoDS_Shape>& shapes) {
  const BRep_Builder builder;
  TopoDS_Compound compound;
  builder.MakeCompound(compound);
  for (const TopoDS_Shape& shape : shapes) builder.Add(compound, shape);
  return compound;
}

TopoDS_Shape Box(double x_mm = 0.0) { return BRepPrimAPI_MakeBox(gp_Pnt(x_mm, 0, 0), 10.0, 20.0, 30.0).Shape(); }

// Rounded at all edges.
TopoDS_Shape RoundedBox() {
  const TopoDS_Shape box = Box();
  BRepFilletAPI_MakeFillet fillet(box);
  for (TopExp_Explorer edges(box, TopAbs_EDGE); edges.More(); edges.Next()) {
    fillet.Add(2.0, TopoDS::Edge(edges.Current()));
  }
  return fillet.Shape();
}

TopoDS_Shape Pipe() {
  return BRepAlgoAPI_Cut(BRepPrimAPI_MakeCylinder(10.0, 30.0).Shape(), BRepPrimAPI_MakeCylinder(7.0, 30.0).Shape());
}

// The faces of a shape, without the solid; `is_turned` chooses those whose inner side is stated as the outer one.
TopoDS_Shape LooseFaces(const TopoDS_Shape& shape, const std::function<bool(size_t)>& is_turned) {
  std::vector<TopoDS_Shape> faces;
  for (TopExp_Explorer face(shape, TopAbs_FACE); face.More(); face.Next()) {
    faces.push_back(is_turned(faces.size()) ? face.Current().Reversed() : face.Current());
  }
  return Compound(faces);
}

class LooseFacesTest : public StepFilesTest {
 protected:
  ObjectModel Model(const std::string& path) {
    const auto mesh = ReadMesh(path);
    EXPECT_TRUE(mesh.ok()) << mesh.status();
    auto model = mesh.ok() ? Prepare(*mesh) : mesh.status();
    EXPECT_TRUE(model.ok()) << model.status();
    return model.ok() ? *std::move(model) : ObjectModel();
  }

  // The notices of a file after `pattern` was replaced in its text, once.
  std::vector<std::string> NoticesAfter(const std::string& path, const std::string& pattern, const std::string& by) {
    const std::string text = ReadFile(path, 1u << 20).value();
    const std::string changed =
        std::regex_replace(text, std::regex(pattern), by, std::regex_constants::format_first_only);
    EXPECT_NE(changed, text);
    EXPECT_TRUE(WriteFile(path, changed).ok());
    const auto model = ReadStep(path);
    EXPECT_TRUE(model.ok()) << model.status();
    return model.ok() ? model->notices : std::vector<std::string>();
  }
};

// The kinds of the regions, and the number of edges.
struct Summary {
  std::map<std::pair<RegionShape, bool>, int> regions;
  size_t lines = 0, curves = 0;
  bool operator==(const Summary&) const = default;
};

Summary Summarize(const ObjectModel& model) {
  Summary summary{{}, model.lines.size(), model.curves.size()};
  for (const SurfaceRegion& region : model.surface.regions) ++summary.regions[{region.shape, region.is_convex}];
  return summary;
}

void ExpectOutwardNormals(const ObjectModel& model) {
  ASSERT_EQ(model.surface.normals.size(), model.triangles.size());
  double volume = 0.0;
  for (size_t t = 0; t < model.triangles.size(); ++t) {
    const auto& [i, j, k] = model.triangles[t];
    const Eigen::Vector3d &a = model.vertices[i], &b = model.vertices[j], &c = model.vertices[k];
    const Eigen::Vector3d normal = (b - a).cross(c - a).normalized();
    volume += a.dot(b.cross(c)) / 6.0;
    for (const Eigen::Vector3f& exact : model.surface.normals[t]) ASSERT_GT(exact.cast<double>().dot(normal), 0.8);
  }
  EXPECT_GT(volume, 0.0);
}

TEST_F(LooseFacesTest, TurnedAndLooseFacesGiveTheModelOfTheSolid) {
  const std::pair<const char*, TopoDS_Shape> shapes[] = {
      {"cylinder", BRepPrimAPI_MakeCylinder(10.0, 30.0).Shape()}, {"rounded box", RoundedBox()}, {"pipe", Pipe()}};
  for (const auto& [name, shape] : shapes) {
    SCOPED_TRACE(name);
    const Summary solid = Summarize(Model(Write(shape)));
    const auto expect_solid = [&](const std::string& path, const char* what) {
      SCOPED_TRACE(what);
      const ObjectModel model = Model(path);
      EXPECT_TRUE(Summarize(model) == solid) << model.lines.size() << " lines, " << model.curves.size() << " curves";
      ExpectOutwardNormals(model);
    };
    expect_solid(WriteIges(shape, IgesFaces::kLoose), "IGES");
    expect_solid(WriteIges(shape, IgesFaces::kOfSolids), "IGES, solids");
    expect_solid(Write(LooseFaces(shape, [](size_t) { return false; })), "faces");
    expect_solid(Write(LooseFaces(shape, [](size_t) { return true; })), "turned faces");
    expect_solid(Write(LooseFaces(shape, [](size_t i) { return i % 2 == 0; })), "every second face turned");
    expect_solid(Write(TopExp_Explorer(shape, TopAbs_SHELL).Current().Reversed()), "turned shell");
  }
}

TEST_F(LooseFacesTest, JoinedEdgesAreReportedAndSolidsStayAsTheyAre) {
  EXPECT_THAT(ReadStep(WriteIges(RoundedBox(), IgesFaces::kLoose))->notices,
              ElementsAre(AllOf(HasSubstr("joined at 48 edges"), HasSubstr("mm"))));
  EXPECT_THAT(ReadStep(Write(Compound({Box(), Box(30.0)})))->notices, IsEmpty());
}

TEST_F(LooseFacesTest, PartsThatTouchHaveNoEdgeWhereTheyContinueEachOther) {
  EXPECT_EQ(Model(Write(Compound({Box(), Box(10.0)}))).lines.size(), 12u);
}

TEST_F(LooseFacesTest, WhatIsLostIsReported) {
  EXPECT_THAT(NoticesAfter(Write(Box()), "PLANE\\('',#\\d+\\)", "DIRECTION('',(0.,0.,1.))"),
              ElementsAre(HasSubstr("of the file cannot be read, and faces may be missing"),
                          AllOf(HasSubstr("1 element of the file cannot be converted"),
                                HasSubstr("the first error is \"Surface has not been created\""))));
  EXPECT_THAT(NoticesAfter(Write(Box()), "EDGE_LOOP\\('',\\((#\\d+,#\\d+),[^)]*\\)", "EDGE_LOOP('',($1)"),
              ElementsAre(AllOf(HasSubstr("1 face cannot be triangulated as a whole"),
                                HasSubstr("near (0, 10, 15) mm: repair it in the CAD program"))));
  EXPECT_THAT(NoticesAfter(Write(Compound({Box(), BRepBuilderAPI_MakeEdge(gp_Pnt(0, 0, 40), gp_Pnt(1, 0, 40)).Edge()})),
                           "FILE_NAME", "FILE_NAME "),
              ElementsAre("1 curve or point outside faces left out"));
}

TEST_F(LooseFacesTest, AMissingUnitIsReported) {
  EXPECT_THAT(NoticesAfter(Write(Box()), "(GLOBAL_UNIT_ASSIGNED_CONTEXT\\s*\\(\\()#\\d+,", "$1"),
              ElementsAre(HasSubstr("states no unit of length: millimetres are assumed")));
}

TEST_F(LooseFacesTest, AnObjectThatCannotBeConvertedIsReported) {
  STEPControl_Writer writer;
  for (const double x_mm : {0.0, 50.0}) EXPECT_EQ(writer.Transfer(Box(x_mm), STEPControl_AsIs), IFSelect_RetDone);
  const std::string path = directory_.File("two.step");
  ASSERT_EQ(writer.Write(path.c_str()), IFSelect_RetDone);
  EXPECT_THAT(NoticesAfter(path, "MANIFOLD_SOLID_BREP", "NO_SOLID"),
              ElementsAre(HasSubstr("cannot be read"), HasSubstr("1 of 2 objects cannot be converted")));
}

TEST_F(LooseFacesTest, AFileWithoutFacesHasARemedy) {
  const std::string curve = Write(BRepBuilderAPI_MakeEdge(gp_Pnt(0, 0, 0), gp_Pnt(1, 0, 0)).Edge());
  EXPECT_THAT(std::string(ReadStep(curve).status().message()),
              HasSubstr("has no face: export the object as solids or surfaces"));
}

// The tolerance of a vertex may be larger than that of a circle which ends there.
TEST_F(LooseFacesTest, AnArcWhoseEndIsNotOnItsCircleIsAFreeCurve) {
  const TopoDS_Shape box = Box();
  BRepFilletAPI_MakeFillet fillet(box);
  fillet.Add(1.0, TopoDS::Edge(TopExp_Explorer(box, TopAbs_EDGE).Current()));
  const TopoDS_Shape shape = fillet.Shape();
  const std::string precise = Write(shape);
  const auto num_arcs = [](const RawMesh& mesh) {
    return std::count_if(mesh.exact_edges.begin(), mesh.exact_edges.end(),
                         [](const ExactEdge& edge) { return edge.shape == ExactEdge::Shape::kCircle; });
  };
  EXPECT_EQ(num_arcs(*ReadMesh(precise)), 2);
  for (TopExp_Explorer at(shape, TopAbs_VERTEX); at.More(); at.Next()) {
    const TopoDS_Vertex vertex = TopoDS::Vertex(at.Current());
    const gp_Pnt point = BRep_Tool::Pnt(vertex);
    BRep_Builder().UpdateVertex(vertex, point.Translated(gp_Vec(0.0, 0.02, 0.02)), 0.05);
  }
  const auto mesh = ReadMesh(Write(shape));
  ASSERT_TRUE(mesh.ok()) << mesh.status();
  EXPECT_EQ(num_arcs(*mesh), 0);
  const auto model = Prepare(*mesh);
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_EQ(model->curves.size(), 2u);
}

}  // namespace
}  // namespace evpose::client
